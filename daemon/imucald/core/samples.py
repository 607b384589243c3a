"""Time-stamped physical samples: the common data format inside the package."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

GRAVITY = 9.80665
"""Standard gravity [m/s^2] (ISO 80000-3)."""

SI_UNITS: Mapping[str, str] = {
    "acceleration": "m/s^2",
    "angular_rate": "rad/s",
    "angle": "rad",
    "speed": "m/s",
    "magnetic_field": "T",
    "temperature": "degC",
    "flag": "",
}
"""Unit of each dimension."""


class Quantity(NamedTuple):
    """Meaning of a channel's samples. key: its key in the configuration's `signals`.

    width: numbers per sample.
    """

    channel: str
    key: str
    dimension: str
    width: int = 1

    @property
    def unit(self) -> str:
        """SI unit; empty for a flag."""
        return SI_UNITS[self.dimension]


QUANTITIES: Mapping[str, Quantity] = {
    row.channel: row
    for row in (
        # Specific force in sensor axes (+9.81 on an axis up at rest); angular rate, right-handed.
        Quantity("accel", "accelerometer", "acceleration", 3),
        Quantity("gyro", "gyroscope", "angular_rate", 3),
        Quantity("mag", "magnetometer", "magnetic_field", 3),
        Quantity("speed", "speed", "speed"),  # not negative; direction comes from `reverse`
        # Front left, front right, rear left, rear right.
        Quantity("wheel_speeds", "wheel_speeds", "speed", 4),
        # Signals of the vehicle (ISO 8855): positive to the left, and forward.
        Quantity("steering", "steering_wheel_angle", "angle"),
        Quantity("yaw_rate", "yaw_rate", "angular_rate"),
        Quantity("lateral_accel", "lateral_acceleration", "acceleration"),
        Quantity("longitudinal_accel", "longitudinal_acceleration", "acceleration"),
        Quantity("reverse", "reverse", "flag"),  # 1 in reverse gear, else 0
        Quantity("brake", "brake", "flag"),  # 1 when it is applied, else 0
        Quantity("temperature", "temperature", "temperature"),  # of the sensor
        Quantity("heading", "heading", "angle"),  # clockwise from north
    )
}
"""Every quantity, by channel, in the order for people.

A sample is one number or `width` numbers in `unit`: arrays (N,) or (N, width). Each quantity with a
setting of its `key` in `config/signals.py` is read from the bus.
"""

INERTIAL = tuple(
    row.channel for row in QUANTITIES.values() if row.dimension in ("acceleration", "angular_rate")
)
"""Channels of accelerations and rates: the noise of the sensor changes their values from sample to
sample.
"""


def width_of(channel: str) -> int:
    """Return the number of values in a sample; a channel of a parallel sensor has three."""
    return QUANTITIES[channel].width if channel in QUANTITIES else 3


class Series(Struct, frozen=True):
    """Samples of one channel, in time order.

    t: (N,) seconds, never decreasing. values: (N,) or (N, width), SI units, finite.
    """

    t: NDArray[np.float64]
    values: NDArray[np.float64]


Samples = Mapping[str, Series]
"""Channel name to its samples; a channel that a log lacks is absent."""
