"""What all parts of the configuration are made of."""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta, Struct

STANDARD_ID_MAX = 0x7FF
EXTENDED_ID_MAX = 0x1FFF_FFFF


class Settings(Struct, frozen=True, forbid_unknown_fields=True):
    """Unknown keys are mistakes; nothing changes once it is read."""


CanId = Annotated[int, Meta(ge=0, le=EXTENDED_ID_MAX)]
SourceAddress = Annotated[int, Meta(ge=0, le=253)]
"""Of a sender on a J1939 bus; 254 is none, 255 all."""
Positive = Annotated[float, Meta(gt=0)]
NotNegative = Annotated[float, Meta(ge=0)]
Share = Annotated[float, Meta(ge=0, le=0.5)]
"""Relative uncertainty."""
Angle = Annotated[float, Meta(ge=-180, le=180)]
"""[deg]"""
MIN_SPEED_DELAY, MAX_SPEED_DELAY = -0.5, 1.8
"""Of speed behind the accelerometer [s]: what can be configured, and where it is sought. A speed
of 1 Hz that is averaged over its cycle and waits for a frame is a second late, receivers filter
for as long again; the accelerometer is late against it by a low-pass and its own cycle at most."""
SpeedDelay = Annotated[float, Meta(ge=MIN_SPEED_DELAY, le=MAX_SPEED_DELAY)]
"""[s]"""


PerAxis = Positive | Annotated[tuple[Positive, ...], Meta(min_length=3, max_length=3)]
"""One number for all axes, or one for each of x, y, z. (A union with a tuple of fixed length
crashes msgspec 0.22 when garbage is collected.)"""


def per_axis(value: float | tuple[float, ...]) -> tuple[float, float, float]:
    """The numbers of x, y, z."""
    x, y, z = value if isinstance(value, tuple) else (value, value, value)
    return x, y, z


class Radians:
    """An angle (or rate) that the file gives in degrees, in radians for those who read it."""

    def __init__(self, key: str) -> None:
        self._key = key

    def __get__(self, settings: Struct, owner: type[Struct]) -> float:
        return math.radians(getattr(settings, self._key))


class RadiansPerAxis(Radians):
    """The same of a key that may have a number per axis; always three."""

    def __get__(  # type: ignore[override]
        self, settings: Struct, owner: type[Struct]
    ) -> tuple[float, float, float]:
        x, y, z = per_axis(getattr(settings, self._key))
        return math.radians(x), math.radians(y), math.radians(z)


class RadiansOrNone(Radians):
    """The same of a key that may be absent."""

    def __get__(self, settings: Struct, owner: type[Struct]) -> float | None:  # type: ignore[override]
        degrees = getattr(settings, self._key)
        return None if degrees is None else math.radians(degrees)


class Part:
    """A share that the file gives in percent, as a part of one for those who read it."""

    def __init__(self, key: str) -> None:
        self._key = key

    def __get__(self, settings: Struct, owner: type[Struct]) -> float:
        return float(getattr(settings, self._key)) / 100.0
