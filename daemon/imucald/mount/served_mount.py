"""The reported state of a mount, and the applied correction."""

from __future__ import annotations

import math
from collections.abc import Callable

from imucald.mount.estimate import Correction, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.hysteresis import BAD, GOOD
from imucald.mount.signal_checks import Acceptance
from imucald.mount.slewing import SlewedCorrection
from imucald.mount.states import MountKnowledge, is_mount_uncertain, judged, reported

SLEW_RATE = math.radians(0.5)
"""Largest rate at which the applied correction turns [rad/s]."""


class ServedMount:
    """Judges the knowledge after each block, and changes the applied correction tick by tick.

    state: reported state. has_moved: the mount has moved, and no good correction was applied since.
    move_on: moves the applied correction on by one tick.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._slewed = SlewedCorrection(SLEW_RATE)
        self.state = MountState.WAITING
        self.has_moved = False
        # Runs every tick: an own method would cost a tenth more.
        self.move_on = self._slewed.move_on

    @property
    def correction(self) -> Correction | None:
        """Correction that was good last; the state says whether it may be sent."""
        return self._slewed.correction

    @property
    def was_good(self) -> bool:
        """True if there was a good correction in this drive."""
        return self.correction is not None

    @property
    def good(self) -> Correction | None:
        """Correction that was good last; None if the sensor was moved since."""
        return None if self.has_moved else self.correction

    @property
    def has_arrived(self) -> bool:
        """True if the applied correction equals the correction that was found last."""
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
        found_correction: Callable[[], Correction],
    ) -> None:
        """Determine the state after a block.

        In a good state, the correction that was found becomes the target of the applied correction.
        has_faults: there is a contradiction to the estimate. found_correction: function that
        returns the correction from the present evidence.
        """
        found = self._accepted(judged(known, self.state, self._settings), acceptance)
        before = self.state
        is_uncertain = is_mount_uncertain(known, self._settings)
        doubts = has_faults, self.was_good, self.has_moved, is_uncertain
        self.state = reported(found, before, *doubts)
        if self.state not in GOOD:
            return
        self._slewed.aim(found_correction())
        if before in GOOD or self._slewed.has_arrived:
            self.has_moved = False
        else:  # good again, but what is applied is still on the way from what was not good
            self.state = MountState.RECALIBRATING if before in BAD else before

    def _accepted(self, found: MountState, acceptance: Acceptance) -> MountState:
        """Return the accepted state. The state is not *fine* before the tests for a moved sensor
        work, and a new mount does not become good during a contradiction.
        """
        if found in GOOD and self.good is None and acceptance.missing_to_be_good() is not None:
            return MountState.LEVELLED
        if found is MountState.FINE and not acceptance.may_be_fine():
            return MountState.USABLE
        return found
