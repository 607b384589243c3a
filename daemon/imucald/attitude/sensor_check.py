"""The sensor check of method C: constant errors that a rest shows.

One position shows the gyroscope's zero error. The check shows the accelerometer's error along
gravity, and the whole error only if the sensor is known to be level.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from imucald.core.rotations import Matrix3, Vector, matrix_times
from imucald.core.samples import GRAVITY

LARGEST_RATE = math.radians(6.0)
"""A gyroscope with a larger constant error is broken [rad/s]."""
LARGEST_FORCE = 3.0
"""An accelerometer with a larger constant error is broken [m/s^2]."""
DIGITS = 10
"""Decimal places of a saved check: finer than any sensor."""


class CheckResult(NamedTuple):
    """Result of a sensor check, in any common axes: constant errors [rad/s], [m/s^2]."""

    rate: Vector
    force: Vector

    @property
    def is_believable(self) -> bool:
        """True if these are errors of working sensors; larger errors, or NaN, mean a broken one."""
        return all(
            abs(c) <= limit
            for values, limit in ((self.rate, LARGEST_RATE), (self.force, LARGEST_FORCE))
            for c in values
        )

    def turned(self, R_new_from_old: Matrix3) -> CheckResult:
        """Return the same in other axes."""
        return CheckResult(
            matrix_times(R_new_from_old, self.rate), matrix_times(R_new_from_old, self.force)
        )

    def less(self, rate: Vector, force: Vector) -> CheckResult:
        """Return the errors that remain when this much more is subtracted from the samples."""
        (p, q, r), (a, b, c) = self
        return CheckResult(
            (p - rate[0], q - rate[1], r - rate[2]), (a - force[0], b - force[1], c - force[2])
        )

    def as_saved(self) -> dict[str, list[float]]:
        """Return the form for a saved state; a turn to other axes and back gives the same
        numbers.
        """
        rate, force = ([round(c, DIGITS) for c in values] for values in self)
        return {"rate": rate, "force": force}

    @classmethod
    def from_saved(cls, data: object) -> CheckResult | None:
        """Return the check in a saved state; None if it is not a check of a working sensor."""
        if not isinstance(data, Mapping):
            return None
        rate, force = data.get("rate"), data.get("force")
        for values in (rate, force):
            if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != 3:
                return None
            if not all(isinstance(c, float | int) for c in values):
                return None
        assert isinstance(rate, Sequence)
        assert isinstance(force, Sequence)
        found = cls((rate[0], rate[1], rate[2]), (force[0], force[1], force[2]))
        return found if found.is_believable else None


def rest_errors(mean_rate: Vector, mean_force: Vector, is_level: bool) -> CheckResult:
    """Return bs and ds of the publication from the means of a rest [rad/s, m/s^2], vertical axis z.

    Level: ds is the mean minus gravity on z. Otherwise only the part of ds along the measured
    vertical is used: the rest of a mean that leans is slope as well as error. The input is any
    value from the bus, so check whether the result `is_believable`.
    """
    x, y, z = mean_force
    if is_level:
        return CheckResult(mean_rate, (x, y, z - GRAVITY))
    size = math.sqrt(x * x + y * y + z * z)
    if size == 0.0:  # without a vertical, gravity cannot be subtracted
        return CheckResult(mean_rate, (0.0, 0.0, -GRAVITY))
    k = (size - GRAVITY) / size
    return CheckResult(mean_rate, (x * k, y * k, z * k))
