"""The reported state of a mount, and the applied correction.

`ReportedRotation` is the reported rotation: the solver's without the road's crown, and its
covariance.

The solver's z is the mean vertical of the roads driven. Roads lean to the side by their crown. The
lean is known only to `crown_std`, which is one more error about x. Yaw is found on leaning roads,
so the same error is also part of yaw's.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3, rotation_from_vector
from imucald.mount.acceptance import Acceptance
from imucald.mount.estimate import Correction, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.hysteresis import GOOD
from imucald.mount.priors import YAW_PER_CROWN
from imucald.mount.slewing import SlewedCorrection
from imucald.mount.solver import MountSolver
from imucald.mount.states import MountKnowledge, judged, reported

SLEW_RATE = math.radians(0.5)
"""The applied correction turns no faster than this [rad/s]."""


class ServedMount:
    """Judges the knowledge after each block, and follows a good correction tick by tick.

    state: the reported state. has_moved: the mount has moved, and no good correction was applied
    since. step: follows the correction by one tick.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._slewed = SlewedCorrection(SLEW_RATE)
        self.state = MountState.WAITING
        self.has_moved = False
        self.step = self._slewed.step  # runs every tick: an own method would cost a tenth more

    @property
    def correction(self) -> Correction | None:
        """Correction to apply now, or None."""
        return self._slewed.correction

    @property
    def good(self) -> Correction | None:
        """Correction to apply, unless the sensor was moved since it was good."""
        return None if self.has_moved else self.correction

    @property
    def has_arrived(self) -> bool:
        """True if the applied correction equals the one that was found last."""
        return self._slewed.has_arrived

    @property
    def is_turning(self) -> bool:
        """True if the next tick changes the applied correction."""
        return self._slewed.is_moving

    def judge(
        self,
        known: MountKnowledge,
        acceptance: Acceptance,
        has_faults: bool,
        is_refitting: bool,
        found_correction: Callable[[], Correction],
    ) -> None:
        """Find the state after a block.

        In a good state, turn towards the correction that was found.

        has_faults: a contradiction of the estimate stands. is_refitting: the estimate is being
        searched again. found_correction: makes the correction from the evidence so far.
        """
        was_good, is_serving = self.state in GOOD, self.correction is not None
        found = self._accepted(judged(known, self.state, self._settings), acceptance)
        self.state = reported(found, has_faults, is_serving, self.has_moved, is_refitting)
        if self.state not in GOOD:
            return
        self._slewed.aim(found_correction())
        if was_good or self._slewed.has_arrived:
            self.has_moved = False
        else:  # good again, but what is applied is still on the way from what was wrong
            self.state = MountState.RECALIBRATING

    def _accepted(self, found: MountState, acceptance: Acceptance) -> MountState:
        """Return the accepted state: not *fine* before the tests work, and not good while a
        contradiction stands.
        """
        is_serving = self.correction is not None and not self.has_moved
        if found in GOOD and not is_serving and acceptance.missing_to_be_good() is not None:
            return MountState.LEVELLED
        if found is MountState.FINE and not acceptance.may_be_fine():
            return MountState.USABLE
        return found


MOST_OF_LEAN = 0.9
"""Largest share of yaw's deviation that comes from the road's lean, so that the covariance stays
valid.
"""
UNKNOWN_YAW = (math.pi / math.sqrt(3.0)) ** 2
"""Variance of an unknown direction [rad^2]."""


class ReportedRotation:
    """Computes R_vehicle_from_sensor and its covariance from a solver's result; keeps the last."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._made_of: tuple[object, ...] | None = None
        self._moving: Array = np.zeros(3)
        self._last: tuple[Matrix3, Array] = np.eye(3), np.eye(3)

    def of(self, solver: MountSolver, moving: Array, is_yaw_known: bool) -> tuple[Matrix3, Array]:
        """Return R_vehicle_from_sensor (3, 3) and its covariance (3, 3) [rad^2], as in
        `MountEstimate`.

        solver: has fitted a rotation. moving: variance (3,) [rad^2] from a mount that moves.
        is_yaw_known: otherwise the variance of yaw is that of an unknown direction.
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
