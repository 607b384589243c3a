"""The rotation that is reported: the solver's, with the road's crown taken out, and its covariance.

The solver's z is the mean vertical of the roads driven, which lean to the side by their crown. How
much they lean is known to `crown_std` only: that is one more error about x, and as yaw is found on
leaning roads the same error is part of yaw's.
"""

from __future__ import annotations

import math
import operator

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3, rotation_from_vector
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.priors import YAW_PER_CROWN
from imucald.mount.solver import MountSolver

MOST_OF_LEAN = 0.9
"""Yaw's deviation is at most in so much that of the road's lean: a covariance stays one."""
UNKNOWN_YAW = (math.pi / math.sqrt(3.0)) ** 2
"""Variance of a direction that may be any [rad^2]."""


class ReportedRotation:
    """Makes R_vehicle_from_sensor and covariance of what a solver has found; keeps the last."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._made_of: tuple[object, ...] | None = None
        self._moving: Array = np.zeros(3)
        self._last: tuple[Matrix3, Array] = np.eye(3), np.eye(3)

    def of(self, solver: MountSolver, moving: Array, is_yaw_known: bool) -> tuple[Matrix3, Array]:
        """R_vehicle_from_sensor (3, 3) and its covariance (3, 3) [rad^2], as in `MountEstimate`.

        solver: it has fitted a rotation. moving: variance (3,) [rad^2] from a mount that moves.
        is_yaw_known: else its variance is that of any direction.
        """
        made_of = (solver.R, solver.fused, solver.creep, is_yaw_known)
        is_made = self._made_of is not None and all(map(operator.is_, self._made_of, made_of))
        is_same = moving is self._moving or np.array_equal(self._moving, moving)
        if not is_made or not is_same:
            self._made_of, self._moving = made_of, moving
            self._last = self._of(solver, moving, is_yaw_known)
        return self._last

    def _of(self, solver: MountSolver, moving: Array, is_yaw_known: bool) -> tuple[Matrix3, Array]:
        assert solver.R is not None
        assert solver.fused is not None
        R = rotation_from_vector([-self._settings.crown, 0.0, 0.0]) @ solver.R
        if solver.creep is not None:
            R = rotation_from_vector(solver.creep.level) @ R
        variance = solver.fused.variance + moving
        if not is_yaw_known:
            variance[2] = UNKNOWN_YAW
        covariance = np.diag(variance)
        lean = self._settings.vehicle.crown_std
        covariance[0, 0] += lean**2
        if is_yaw_known:  # and no more than yaw's own deviation allows
            of_lean = min(YAW_PER_CROWN * lean, MOST_OF_LEAN * math.sqrt(variance[2]))
            covariance[0, 2] = covariance[2, 0] = lean * of_lean
        return R, covariance
