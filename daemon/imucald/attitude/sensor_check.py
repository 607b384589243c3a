"""The sensor check of method C: constant errors of the sensors, measured at rest.

A rest in any position shows the gyroscope's zero error. Such a rest shows the accelerometer's error
along gravity only. If the sensor is known to be level, a rest shows the whole error of the
accelerometer.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from msgspec import ValidationError, convert

from imucald.core.rotations import Matrix3, Vector, matrix_times
from imucald.core.samples import GRAVITY

LARGEST_RATE = math.radians(6.0)
"""Constant error above which a gyroscope counts as broken [rad/s]."""
LARGEST_FORCE = 3.0
"""Constant error above which an accelerometer counts as broken [m/s^2]."""
DIGITS = 10
"""Number of decimal places of a saved check. The last decimal place is finer than the error of any
sensor."""


class CheckResult(NamedTuple):
    """Result of a sensor check, in any common axes: constant errors [rad/s], [m/s^2]."""

    rate: Vector
    force: Vector

    @property
    def is_believable(self) -> bool:
        """True if the errors are those of working sensors. Larger errors, or NaN, come from a
        broken sensor."""
        return all(
            abs(c) <= limit
            for values, limit in ((self.rate, LARGEST_RATE), (self.force, LARGEST_FORCE))
            for c in values
        )

    def turned(self, R_new_from_old: Matrix3) -> CheckResult:
        """Return the result in other axes."""
        return CheckResult(
            matrix_times(R_new_from_old, self.rate), matrix_times(R_new_from_old, self.force)
        )

    def less(self, rate: Vector, force: Vector) -> CheckResult:
        """Return the errors that remain when `rate` and `force` are also subtracted from the
        samples."""
        (p, q, r), (a, b, c) = self
        return CheckResult(
            (p - rate[0], q - rate[1], r - rate[2]), (a - force[0], b - force[1], c - force[2])
        )

    def as_saved(self) -> dict[str, list[float]]:
        """Return the result in the form of a saved state.

        The numbers are rounded, so that they are the same after a rotation to other axes and back.
        """
        rate, force = ([round(c, DIGITS) for c in values] for values in self)
        return {"rate": rate, "force": force}

    @classmethod
    def from_saved(cls, data: object) -> CheckResult | None:
        """Return the check from a saved state; None if it is not the check of a working sensor."""
        try:
            saved = convert(data, dict[str, Vector])
            found = cls(saved["rate"], saved["force"])
        except (ValidationError, KeyError):
            return None
        return found if found.is_believable else None


def rest_errors(mean_rate: Vector, mean_force: Vector, is_level: bool) -> CheckResult:
    """Return bs and ds of the publication from the means of a rest [rad/s, m/s^2]. The vertical
    axis is z.

    is_level: ds is the mean force minus gravity on z. Otherwise, only the part of ds along the
    measured vertical is used, because the other part of the mean force comes from a slope as well
    as from errors. The input may be any value from the bus, so the caller must check
    `is_believable`.
    """
    x, y, z = mean_force
    if is_level:
        return CheckResult(mean_rate, (x, y, z - GRAVITY))
    size = math.sqrt(x * x + y * y + z * z)
    if size == 0.0:  # without a vertical, gravity cannot be subtracted
        return CheckResult(mean_rate, (0.0, 0.0, -GRAVITY))
    k = (size - GRAVITY) / size
    return CheckResult(mean_rate, (x * k, y * k, z * k))
