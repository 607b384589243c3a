"""Find the unit, or the scale of raw counts, with which a signal fits its reference."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from imucald.config_check.relation import Relation
from imucald.core.errors import ConfigError
from imucald.inputs.units import find_unit

COMMON_UNITS = {
    "acceleration": ("m/s^2", "g", "mg"),
    "angular_rate": ("deg/s", "rad/s"),
    "angle": ("deg", "rad"),
    "speed": ("km/h", "m/s", "mph", "kn"),
    "magnetic_field": ("uT", "mG", "Gs"),
}
"""Common units, the most frequent first. A unit that is not in this list is accepted only if the
database states the unit."""


GAIN_TOLERANCE = 1.25
"""Largest factor by which squat, slope and tyres change a gain. Measured and simulated vehicles
have gains of 0.8 to 1.2."""
GAINS = 1.0 / GAIN_TOLERANCE, GAIN_TOLERANCE
"""Range of the gain of a signal in the right unit."""

SAME_MOTION = 0.5
"""Smallest share of common variance at which a signal and its reference are the same quantity. With
a smaller share, the signal may only be a cause or an effect of the reference."""
RELATED = 0.25
"""Smallest share of common variance if the stated unit also fits. With this share, half of the
amplitude comes from the reference."""

USUAL_COUNTS = {
    "acceleration": ("g", (16384, 8192, 4096, 2048, 1024, 512, 256, 1000, 100)),
    "angular_rate": (
        "deg/s",
        (131, 65.5, 32.8, 16.4, 114.3, 57.1, 28.6, 14.3, 100, 64, 50, 20, 10),
    ),
}
"""Counts per unit in the measuring ranges of common sensors (MPU-6050, LSM6, BMI, ...), the most
frequent first."""


def in_counts(dimension: str, low: float, high: float) -> UnitChoice:
    """Return a unit of raw counts whose SI value is in [low, high]: a common scale if possible,
    otherwise the geometric mean of the limits."""
    name, usual = USUAL_COUNTS[dimension]
    one = find_unit(name, dimension).factor
    fitting = [n for n in usual if low <= one / n <= high]
    counts, *others = fitting or [float(f"{one / math.sqrt(low * high):.3g}")]
    names = tuple(f"{name}/{n:.6g}" for n in others)
    return UnitChoice(f"{name}/{counts:.6g}", one / counts, False, names, is_counts=True)


@dataclass(frozen=True)
class UnitChoice:
    """A unit and whether the database states it.

    others: other units that also fit. is_counts: True for raw counts whose scale was found from the
    data.
    """

    name: str
    factor: float
    is_stated: bool
    others: tuple[str, ...] = ()
    is_counts: bool = False

    @property
    def is_sure(self) -> bool:
        """True if no other unit fits."""
        return self.is_stated or not self.others

    @property
    def doubt(self) -> str:
        """Text of the reason why the unit is not sure; empty if it is sure."""
        if self.is_sure:
            return ""
        return f"the database states no unit; {', '.join(self.others)} would also fit"


def factor_of(text: str, dimension: str) -> float | None:
    """Return the SI value of 1 in a unit; None if the text is not a unit of this dimension."""
    try:
        return find_unit(text, dimension).factor if text.strip() else None
    except ConfigError:
        return None


def choose_unit(
    stated: str, dimension: str, low: float, high: float, names: Sequence[str] = ()
) -> UnitChoice | None:
    """Return the unit whose SI value is in [low, high]. The stated unit is returned if its value is
    in this range."""
    factor = factor_of(stated, dimension)
    if factor is not None and low <= factor <= high:
        return UnitChoice(stated, factor, True)
    middle = math.log(math.sqrt(low * high))
    fitting = []
    for name in names or COMMON_UNITS[dimension]:
        size = find_unit(name, dimension).factor
        if low <= size <= high:
            fitting.append((abs(math.log(size) - middle), name, size))
    if not fitting:
        return None
    fitting.sort()
    _, name, size = fitting[0]
    return UnitChoice(name, size, False, tuple(other for _, other, _ in fitting[1:]))


def stated_unit(text: str, dimension: str) -> UnitChoice | None:
    """Return the unit that a database states; None if the text is not a unit of this dimension."""
    factor = factor_of(text, dimension)
    return None if factor is None else UnitChoice(text, factor, True)


def unit_for(
    stated: str, dimension: str, found: Relation, gains: tuple[float, float] = GAINS
) -> UnitChoice | None:
    """Return the unit in which a signal has a plausible gain (signal divided by its SI reference),
    or None."""
    if not found.low > 0.0:
        return None
    return choose_unit(stated, dimension, gains[0] / found.high, gains[1] / found.low)
