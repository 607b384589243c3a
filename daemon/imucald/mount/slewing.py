"""The rotation that is applied: follows the estimated one at a limited rate, tick by tick."""

from __future__ import annotations

import math

import numpy as np

from imucald.core.rotations import Matrix3, rotation_from_vector, vector_from_rotation
from imucald.motion.ticks import TICK_S
from imucald.mount.estimate import Correction

ANOTHER_ANSWER = math.radians(30.0)
"""A target further away [rad] is another answer (the sign was wrong), and everything between the
two is wrong as well: it is taken at once."""


NEAR = math.radians(0.2)
"""Nearer than this [rad] a target is reached: it moves a little from fit to fit."""


class SlewedRotation:
    """Turns towards a target no faster than `rate` [rad/s]; the first target is taken at once."""

    def __init__(self, rate: float) -> None:
        self._step = rate * TICK_S
        self._target: Matrix3 | None = None
        self._now: Matrix3 | None = None
        self.correction: Correction | None = None

    def aim(self, R_vehicle_from_sensor: Matrix3) -> None:
        """Set the target (3, 3)."""
        self._target = R_vehicle_from_sensor
        if self._now is None:
            self._take(R_vehicle_from_sensor)

    @property
    def has_arrived(self) -> bool:
        """Whether the target is applied, but for `NEAR`."""
        target, now = self._target, self._now
        if target is None or now is None:
            return False
        return float(np.abs(target - now).max()) < NEAR

    @property
    def is_moving(self) -> bool:
        """Whether the next tick changes what is applied."""
        target, now = self._target, self._now
        return target is not None and now is not None and target is not now

    def clear(self) -> None:
        """Apply nothing."""
        self._target = self._now = self.correction = None

    def step(self) -> None:
        """Go on by one tick."""
        target, now = self._target, self._now
        if target is None or now is None or target is now:  # as `is_moving`
            return
        x, y, z = (float(c) for c in vector_from_rotation(target @ now.T))
        angle = math.sqrt(x * x + y * y + z * z)
        if angle <= self._step or angle > ANOTHER_ANSWER:
            self._take(target)
            return
        part = self._step / angle
        self._take(rotation_from_vector((x * part, y * part, z * part)) @ now)

    def _take(self, R: Matrix3) -> None:
        self._now = R
        xx, xy, xz, yx, yy, yz, zx, zy, zz = (float(c) for c in R.ravel())
        self.correction = (xx, xy, xz, yx, yy, yz, zx, zy, zz)
