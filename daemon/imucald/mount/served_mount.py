"""The state that is reported for a mount, and the correction that is applied under it."""

from __future__ import annotations

import math
from collections.abc import Callable

from imucald.mount.acceptance import Acceptance
from imucald.mount.estimate import Correction, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.hysteresis import GOOD
from imucald.mount.slewing import SlewedCorrection
from imucald.mount.states import MountKnowledge, judged, reported

SLEW_RATE = math.radians(0.5)
"""The applied correction turns no faster than this [rad/s]."""


class ServedMount:
    """Judges the knowledge after each block, and follows a good correction tick by tick.

    state: what is reported. has_moved: the mount has moved, and nothing good was applied since.
    step: go on by one tick.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._slewed = SlewedCorrection(SLEW_RATE)
        self.state = MountState.WAITING
        self.has_moved = False
        self.step = self._slewed.step  # every tick: a method of its own would cost a tenth of it

    @property
    def correction(self) -> Correction | None:
        """What to apply now, or None."""
        return self._slewed.correction

    @property
    def good(self) -> Correction | None:
        """What to apply, unless the sensor was moved since it was good."""
        return None if self.has_moved else self.correction

    @property
    def has_arrived(self) -> bool:
        """Whether what is applied is what was found last."""
        return self._slewed.has_arrived

    @property
    def is_turning(self) -> bool:
        """Whether the next tick changes what is applied."""
        return self._slewed.is_moving

    def judge(
        self,
        known: MountKnowledge,
        acceptance: Acceptance,
        has_faults: bool,
        is_refitting: bool,
        found_correction: Callable[[], Correction],
    ) -> None:
        """Find the state after a block; where it is good, turn towards what was found.

        has_faults: something contradicts the estimate. is_refitting: it is sought again.
        found_correction: makes that of the evidence so far.
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
        """No *fine* before the tests can see, and nothing good in the face of a contradiction."""
        is_serving = self.correction is not None and not self.has_moved
        if found in GOOD and not is_serving and acceptance.missing_to_be_good() is not None:
            return MountState.LEVELLED
        if found is MountState.FINE and not acceptance.may_be_fine():
            return MountState.USABLE
        return found
