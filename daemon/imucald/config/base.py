"""Common types of all parts of the configuration."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta, Struct

STANDARD_ID_MAX = 0x7FF
EXTENDED_ID_MAX = 0x1FFF_FFFF


class Settings(Struct, frozen=True, forbid_unknown_fields=True):
    """Base class of all settings. Unknown keys are mistakes. Settings cannot be changed after they
    are read."""


CanId = Annotated[int, Meta(ge=0, le=EXTENDED_ID_MAX)]
SourceAddress = Annotated[int, Meta(ge=0, le=253)]
"""Address of a sender on a J1939 bus. 254 means no address, 255 means all."""
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=0.5)]
"""Relative uncertainty (fraction)."""
Angle = Annotated[float, Meta(ge=-180, le=180)]
"""An angle [deg]."""
MIN_SPEED_DELAY, MAX_SPEED_DELAY = -0.5, 1.8
"""Limits of the speed delay relative to the accelerometer [s], for the configuration and for the
search. A speed of 1 Hz that is averaged over its cycle and waits for its frame is delayed by one
second. A filter in the receiver adds up to one second. The accelerometer is delayed only by a
low-pass filter and its own cycle, so the lower limit is small."""
SpeedDelay = Annotated[float, Meta(ge=MIN_SPEED_DELAY, le=MAX_SPEED_DELAY)]
"""Delay of the speed [s], within the limits above."""


PerAxis = Positive | Annotated[tuple[Positive, ...], Meta(min_length=3, max_length=3)]
"""One number for all axes, or one for each of x, y, z. (A union with a tuple of fixed length
crashes msgspec 0.22 when garbage is collected.)"""


def per_axis(value: float | tuple[float, ...]) -> tuple[float, float, float]:
    """Return a setting as three numbers, for x, y, z.

    A single number is used for all three axes.
    """
    x, y, z = value if isinstance(value, tuple) else (value, value, value)
    return x, y, z


class Radians:
    """Descriptor for an angle (or rate) that the file states in degrees. Reading the attribute
    returns radians."""

    def __init__(self, key: str) -> None:
        self._key = key

    def __get__(self, settings: Struct, owner: type[Struct]) -> float:
        return math.radians(getattr(settings, self._key))


class RadiansPerAxis(Radians):
    """Descriptor like `Radians`, for a key with one number or one number per axis. Reading returns
    three numbers."""

    def __get__(  # type: ignore[override]
        self, settings: Struct, owner: type[Struct]
    ) -> tuple[float, float, float]:
        x, y, z = per_axis(getattr(settings, self._key))
        return math.radians(x), math.radians(y), math.radians(z)


class RadiansOrNone(Radians):
    """Descriptor like `Radians`, for an optional key. Reading returns None if the key is absent."""

    def __get__(self, settings: Struct, owner: type[Struct]) -> float | None:  # type: ignore[override]
        degrees = getattr(settings, self._key)
        return None if degrees is None else math.radians(degrees)


class Part:
    """Descriptor for a share that the file states in percent. Reading the attribute returns a
    fraction of 1."""

    def __init__(self, key: str) -> None:
        self._key = key

    def __get__(self, settings: Struct, owner: type[Struct]) -> float:
        return float(getattr(settings, self._key)) / 100.0
