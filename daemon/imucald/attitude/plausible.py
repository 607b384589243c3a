"""What no sensor of a vehicle or a person can have measured: it is not learnt from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

LARGEST: Mapping[str, float] = {
    "gyro": 100.0,
    "accel": 1000.0,
    "mag": 0.01,
    "speed": 500.0,
    "heading": 100.0,
    "reverse": 1.0,
}
"""Largest size by channel, SI: 5,700 deg/s, 100 g, a hundred times the earth's field."""


def is_plausible(channel: str, values: Sequence[float]) -> bool:
    """Whether every number of a sample is finite and of a size that can be."""
    limit = LARGEST[channel]
    return all(-limit <= value <= limit for value in values)
