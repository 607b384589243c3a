"""Checks of the signals against one another: present contradictions, and agreement.

`contradictions` finds pairs of signals that contradict each other. `alternatives` rules out wrong
signs and exchanged axes. This module uses the results of both modules in every block and decides
whether the rotation must be searched again. The search is repeated in two cases: a new
contradiction begins, or a contradiction ends during which the rotation was found.

`Acceptance` has the conditions for a *good* and for a *fine* estimate in addition to small
deviations. The deviations hold under two assumptions: the signals are what the configuration says,
and the mount does not move.
"""

from __future__ import annotations

from collections.abc import Sequence

from msgspec import Struct

from imucald.config.base import MAX_SPEED_DELAY
from imucald.core.rotations import Matrix3
from imucald.core.text import counted
from imucald.mount.alternatives import NOT_CONFIRMED, Alternatives
from imucald.mount.carried_force import CarriedForce
from imucald.mount.contradictions import WRONG_UNIT, Contradictions, StandingFault
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.log_ratios import TO_BE_FINE, TO_BE_GOOD
from imucald.mount.mount_changes import MountChanges
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
NO_SIDES = (
    "a yaw rate, steering angle, lateral acceleration or heading, or 'calibration: {orientation: "
    "{up: z}}' with the axis that points up: without one of them an upside-down sensor looks like "
    "one with inverted signs"
)
"""Reason why a certain estimate is not *fine*: no signal distinguishes left from right."""
TURNED_SIDES = (
    "'calibration: {orientation: {up: z}}' with the axis that points up: the yaw rate, steering "
    "angle or lateral acceleration has 'sign: -1', so it cannot show that the accelerometer's "
    "signs are right"
)
"""Reason why an estimate is not *fine*: the configuration inverts the sign of the signal that
distinguishes left from right."""
WHY_GRAVITY_MOVED = (
    "more bends: the accelerometer shows a sudden change. Bends show whether the sensor was turned "
    "or the zero of its accelerometer has changed"
)
SIGNS = "check of the signs"
NO_SPEED = "a speed: without one, a turn of the sensor would not be noticed"
"""Reason why a mount is not *fine*: the speed is missing."""
LATE_SPEED = (
    f"a speed with less delay: it seems to be more than {MAX_SPEED_DELAY:g} s behind the "
    "accelerometer"
)


class SignalChecks:
    """Compares the signals of a drive with one another.

    standing: present contradictions. history: all contradictions of the drive, each with the number
    of its first block. contradictions, alternatives: the two tests.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self.contradictions = Contradictions(settings)
        self.alternatives = Alternatives(settings)
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
        self.contradictions.take_block(
            p,
            carried.turn_rate,
            carried.own_gyro,
            R,
            offset,
            "yaw_rate" in signals.seen,
            carried.delay.value if carried.delay.is_known else None,
        )
        self.alternatives.take_block(kept, R, carried.bias, carried.gains, signals.seen, offset)
        before = tuple(f for f in self.standing if f not in OF_NO_PAIR)
        self.standing = self.contradictions.faults
        is_sure = carried.is_sure or fits_no_sensor or StandingFault.GYRO_AXES in before
        if self.alternatives.gyro_accused and is_sure:
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
        stated = self.alternatives.contradicted_orientation(R, is_yaw_known)
        if stated is not None:
            self.accuse_lasting(AGAINST_A_PERSON[stated], block)

    def accuse_lasting(self, fault: StandingFault, block: int) -> None:
        """Set a fault that another class finds in each block. block: number of the block."""
        self.accuse(fault)
        if fault not in {seen for _, seen in self.history}:
            self.history.append((block, fault))

    def forget_rotation(self) -> None:
        """Forget the evidence that was computed with a rotation that was wrong for some time."""
        self.contradictions.forget_forces()
        self.alternatives.forget_rotation()

    def restart(self) -> None:
        """Restart, because the rotation is searched again: earlier agreement no longer counts."""
        self.contradictions.forget_forces()
        self.alternatives.restart()

    @property
    def have_agreed(self) -> bool:
        """True if all signals were seen to agree, with the certainty that *fine* needs."""
        return self._has_usual_gains and self.alternatives.are_seen(TO_BE_FINE)

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
            return self.alternatives.share(TO_BE_GOOD)
        if not self._has_usual_gains:
            return 0.0
        return min(self.alternatives.share(TO_BE_FINE), self.alternatives.mirror_share)


class Acceptance(Struct, frozen=True):
    """Checks of an estimate with the present evidence.

    is_gravity_open: gravity has changed, and the cause is not known yet: a turned sensor, or a zero
    error that stepped.
    is_delay_beyond: the delay of the speed may be larger than the largest delay that is searched.
    has_speed: a speed was received in this drive. has_speed_now: a speed was received in the last
    minute.
    Without a speed no test shows that the sensor turns in yaw, so the mount is *usable* at most.
    are_signs_known: an earlier drive proved the signs, and no evidence since then shows a change.
    The state *fine* still waits until this drive has proved all signs. The state *fine* does not
    wait until the tests could detect a small move of the sensor. Such a move is rare, and waiting
    for minutes in every drive is not justified.
    """

    checks: SignalChecks
    changes: MountChanges
    is_gravity_open: bool
    is_delay_beyond: bool
    has_speed: bool
    has_speed_now: bool
    are_signs_known: bool

    def missing_to_be_good(self) -> str | None:
        """Return the missing conditions in words: those that keep an estimate with small deviations
        from becoming good."""
        if not self.has_speed:
            return None
        if self.is_delay_beyond:
            return LATE_SPEED
        if self.is_gravity_open:
            return WHY_GRAVITY_MOVED
        return self._missing_of_signals()

    def _missing_of_signals(self) -> str | None:
        return None if self.are_signs_known else self.checks.alternatives.missing(TO_BE_GOOD)

    def shares(self, is_fine: bool) -> dict[str, float]:
        """Return the share of each condition that is met (0 to 1), by the name of the condition.

        is_fine: return the conditions of *fine*, not those of *usable*.
        """
        found = {}
        if self.has_speed and (is_fine or self._missing_of_signals() is not None):
            found[SIGNS] = self.checks.share(is_fine)
        return found

    def may_be_fine(self) -> bool:
        """True if the estimate meets all conditions of *fine*.

        There are three conditions: a move of the sensor would be noticed, the signals were seen to
        agree, and few changes were found.
        """
        if self.changes.is_loose or not self.has_speed_now:
            return False
        if not self.checks.alternatives.is_mirror_excluded:
            return False
        return not self.has_speed or self.checks.have_agreed

    def missing_to_be_fine(self) -> str:
        """Return the missing conditions in words: those that keep an estimate with small deviations
        from becoming *fine*."""
        if not self.has_speed_now:
            return NO_SPEED
        if self.changes.is_loose:
            times = counted(len(self.changes.history), "time")
            return f"a firmly fixed sensor (it moved {times} in this drive)"
        if self.has_no_sides:
            open_ones = self.checks.alternatives.not_checked
            return TURNED_SIDES if NOT_CONFIRMED in open_ones else NO_SIDES
        return "more turns and changes of speed, to check that the signals agree"

    @property
    def can_become_fine(self) -> bool:
        """True if more driving can make the estimate *fine*. The present deviations are not
        tested."""
        return not (self.changes.is_loose or self.has_no_sides)

    @property
    def has_no_sides(self) -> bool:
        """True if no signal of this vehicle distinguishes the drive from its mirror image."""
        return bool(self.checks.alternatives.not_checked)
