"""The applied correction: it moves to the estimated correction at a limited rate, tick by tick."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import rotation_from_vector, vector_from_rotation
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.estimate import Correction

ANOTHER_ANSWER = math.radians(30.0)
"""If the angle to the target is larger than this [rad], the target is applied at once.

In this case the sign was wrong, so all rotations between the two corrections are wrong too.
"""
NEAR = math.radians(0.2)
"""Angle [rad] to the target below which the target counts as reached: each new solution moves the
target a little."""


class SlewedCorrection:
    """Moves the applied correction towards a target at `rate` [rad/s] or slower. The first target
    is applied at once.

    Rotation, matrices and offsets reach the target at the same time. The difference between a
    matrix and the rotation counts as an angle. An offset of the force counts as the tilt of gravity
    that would cause this offset. An offset of the rate of 1 rad/s counts as 1 rad.
    """

    def __init__(self, rate: float) -> None:
        self._step = rate * TICK_S
        self._target: Correction | None = None
        self.correction: Correction | None = None

    def aim(self, target: Correction) -> None:
        """Set the target. The same target again has no effect."""
        if target == self._target:
            return
        self._target = target
        if self.correction is None:
            self.correction = target

    @property
    def has_arrived(self) -> bool:
        """True if the applied correction is closer to the target than `NEAR`."""
        target, now = self._target, self.correction
        if target is None or now is None:
            return False
        turned = max(abs(a - b) for a, b in zip(target.rotation, now.rotation, strict=True))
        return max(turned, _apart(target, now)) < NEAR

    @property
    def is_moving(self) -> bool:
        """True if the next tick changes the applied correction."""
        target, now = self._target, self.correction
        return target is not None and now is not None and target is not now

    def move_on(self) -> None:
        """Move the applied correction on by one tick."""
        target, now = self._target, self.correction
        if target is None or now is None or target is now:  # as `is_moving`
            return
        R = now.matrix()
        x, y, z = (float(c) for c in vector_from_rotation(target.matrix() @ R.T))
        angle = math.sqrt(x * x + y * y + z * z)
        distance = max(angle, _apart(target, now))
        if distance <= self._step or angle > ANOTHER_ANSWER:
            self.correction = target
            return
        part = self._step / distance
        turned = Correction.turning(rotation_from_vector((x * part, y * part, z * part)) @ R)
        if not (target.is_rotation and now.is_rotation):
            rest = _rest(now)
            turned = _with_rest(turned, rest + part * (_rest(target) - rest))
        self.correction = turned


def _apart(a: Correction, b: Correction) -> float:
    """Return the distance of two corrections [rad]. The difference between the two rotations is
    left out."""
    if a.is_rotation and b.is_rotation:
        return 0.0
    return float(np.abs(_rest(a) - _rest(b)).max())


def _rest(c: Correction) -> NDArray[np.float64]:
    """Return the part of a correction beyond its rotation (24,) as angles [rad]: the differences of
    the matrices from the rotation, and the offsets.
    """
    R = np.array(c.rotation)
    offsets = np.array(c.force_offset) / GRAVITY, np.array(c.rate_offset)
    return np.concatenate([c.force - R, c.rate - R, *offsets])


def _with_rest(turned: Correction, rest: NDArray[np.float64]) -> Correction:
    """Return a correction: a rotation together with the additional matrices and offsets that
    `_rest` returns as angles.
    """
    R = np.array(turned.rotation)
    return Correction.with_matrices(
        turned.matrix(),
        (R + rest[:9]).reshape(3, 3),
        (R + rest[9:18]).reshape(3, 3),
        rest[18:21] * GRAVITY,
        rest[21:],
    )
