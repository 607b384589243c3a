"""Checks of the signals against one another: present contradictions, and agreement.

`contradictions` finds pairs of signals that contradict each other. `alternatives` rules out wrong
signs and exchanged axes. This module uses the results of both modules in every block and decides
whether the rotation must be searched again. The search is repeated in two cases: a new
contradiction begins, or a contradiction ends during which the rotation was found.
"""

from __future__ import annotations

from collections.abc import Sequence

from imucald.core.rotations import Matrix3
from imucald.mount.alternatives import Alternatives
from imucald.mount.carried_force import CarriedForce
from imucald.mount.contradictions import WRONG_UNIT, Contradictions, StandingFault
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.log_ratios import TO_BE_FINE, TO_BE_GOOD
from imucald.mount.signal_blocks import SignalBlock, SignalBlockMaker
from imucald.mount.stated_orientation import Stated

FOUND_ANEW = frozenset({StandingFault.FORCE_TURNS, StandingFault.FORCE_SPEED})
"""Faults that end when a new rotation is found during the fault. This new rotation stays in use."""

AGAINST_A_PERSON: dict[Stated, StandingFault] = {
    "up": StandingFault.ORIENTATION,
    "forward": StandingFault.FORWARD,
}


OF_NO_PAIR = frozenset(
    {
        *AGAINST_A_PERSON.values(),
        StandingFault.ACCEL_LEVEL,
        StandingFault.ACCEL_ZERO,
        StandingFault.ACCEL_DRIFT,
    }
)
"""Faults that are not contradictions between two signals. Another rotation does not end these
faults."""


class SignalChecks:
    """Compares the signals of a drive with one another.

    standing: present contradictions. history: all contradictions of the drive, each with the number
    of its first block.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._contradictions = Contradictions(settings)
        self._alternatives = Alternatives(settings)
        self._gains = (1.0, 1.0)
        self.standing: tuple[StandingFault, ...] = ()
        self.history: list[tuple[int, StandingFault]] = []

    def take_block(
        self,
        p: SignalBlock,
        carried: CarriedForce,
        signals: SignalBlockMaker,
        kept: Sequence[SignalBlock],
        fits_no_sensor: bool = False,
    ) -> bool:
        """Process a block. Returns True if the rotation must be searched again, from this block on.

        carried: has already taken the block. signals: the maker of the block. kept: the last
        blocks. fits_no_sensor: no rotation of any sensor fits the evidence.
        """
        if signals.without_speed:
            self.standing = ()
            return False
        R, offset = carried.R, signals.steering_offset
        self._gains = carried.gains
        self._contradictions.take_block(
            p,
            carried.turn_rate,
            carried.own_gyro,
            R,
            offset,
            "yaw_rate" in signals.seen,
            carried.delay.value if carried.delay.is_known else None,
        )
        self._alternatives.take_block(kept, R, carried.bias, carried.gains, signals.seen, offset)
        before = tuple(f for f in self.standing if f not in OF_NO_PAIR)
        self.standing = self._contradictions.faults
        is_sure = carried.is_sure or fits_no_sensor or StandingFault.GYRO_AXES in before
        if self._alternatives.gyro_accused and is_sure:
            self.accuse(StandingFault.GYRO_AXES)
        new = [fault for fault in self.standing if fault not in before]
        self.history += [(signals.blocks, fault) for fault in new]
        has_ended = bool(before) and not self.standing and FOUND_ANEW.isdisjoint(before)
        return bool(new) or has_ended

    @property
    def is_motion_accused(self) -> bool:
        """True if the force contradicts dv/dt or v r (speed times yaw rate) now.

        In this state, the signals are no evidence of the mount or of a move.
        """
        return not FOUND_ANEW.isdisjoint(self.standing)

    def accuse(self, fault: StandingFault) -> None:
        """Set a fault until the next block is taken."""
        if fault not in self.standing:
            self.standing = (*self.standing, fault)

    def hold_against_orientation(self, R: Matrix3, is_yaw_known: bool, block: int) -> None:
        """Set a fault if the sensor sits in the opposite direction to the stated orientation.

        R: R_vehicle_from_sensor (3, 3). block: number of the block.
        """
        stated = self._alternatives.contradicted_orientation(R, is_yaw_known)
        if stated is not None:
            self.accuse_lasting(AGAINST_A_PERSON[stated], block)

    def accuse_lasting(self, fault: StandingFault, block: int) -> None:
        """Set a fault that another class finds in each block. block: number of the block."""
        self.accuse(fault)
        if fault not in {seen for _, seen in self.history}:
            self.history.append((block, fault))

    def forget_forces(self) -> None:
        """Forget the evidence of the forces, because this evidence is about an earlier rotation."""
        self._contradictions.forget_forces()

    def forget_rotation(self) -> None:
        """Forget the evidence that was computed with a rotation that was wrong for some time."""
        self._contradictions.forget_forces()
        self._alternatives.forget_rotation()

    def restart(self) -> None:
        """Restart, because the rotation is searched again: earlier agreement no longer counts."""
        self._contradictions.forget_forces()
        self._alternatives.restart()

    def take_mount(self, R: Matrix3) -> None:
        """Use the mount R_vehicle_from_sensor (3, 3) that a person states.

        The statement can rule out the mirror image of the drive.
        """
        self._alternatives.take_mount(R)

    def missing_to_be_good(self) -> str | None:
        """Return in words the evidence that an estimate needs to become good; None: no more
        evidence is needed."""
        return self.doubt or self._alternatives.missing(TO_BE_GOOD)

    @property
    def doubt(self) -> str | None:
        """Return in words the evidence that is needed because signals contradict each other; None:
        no more evidence is needed."""
        is_doubtful = self._contradictions.doubtful
        return "more bends: some signals contradict each other" if is_doubtful else None

    @property
    def have_agreed(self) -> bool:
        """True if all signals were seen to agree, with the certainty that *fine* needs."""
        return self._has_usual_gains and self._alternatives.are_seen(TO_BE_FINE)

    @property
    def _has_usual_gains(self) -> bool:
        """True if the gains of the force on dv/dt and v r (speed times yaw rate) show no wrong
        unit.
        """
        return all(1.0 / WRONG_UNIT < gain < WRONG_UNIT for gain in self._gains)

    def share(self, is_fine: bool) -> float:
        """Return the collected share (0 to 1) of the evidence that the signals agree.

        is_fine: return the share for *fine*, not for *usable*.
        """
        if not is_fine:
            return self._alternatives.share(TO_BE_GOOD)
        if not self._has_usual_gains:
            return 0.0
        return min(self._alternatives.share(TO_BE_FINE), self._alternatives.mirror_share)

    @property
    def is_mirror_excluded(self) -> bool:
        """True if the mirror image of this drive is ruled out, by a signal or by a person's
        statement."""
        return self._alternatives.is_mirror_excluded

    @property
    def not_checked(self) -> tuple[str, ...]:
        """Return, in words, the properties that no signal of this vehicle shows and that no person
        has stated."""
        return self._alternatives.not_checked
