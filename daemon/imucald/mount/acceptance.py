"""Conditions for a *good* and for a *fine* estimate, in addition to small deviations.

The deviations hold under two assumptions: the signals are what the configuration says, and the
mount does not move. This module checks these assumptions with `signal_checks`, the tests for a
moved sensor, and the delay of the speed.
"""

from __future__ import annotations

from msgspec import Struct

from imucald.config.base import MAX_SPEED_DELAY
from imucald.core.text import counted
from imucald.mount.alternatives import NOT_CONFIRMED
from imucald.mount.mount_changes import MountChanges
from imucald.mount.signal_checks import SignalChecks

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
        return self.checks.doubt if self.are_signs_known else self.checks.missing_to_be_good()

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
        if not self.checks.is_mirror_excluded:
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
            return TURNED_SIDES if NOT_CONFIRMED in self.checks.not_checked else NO_SIDES
        return "more turns and changes of speed, to check that the signals agree"

    @property
    def can_become_fine(self) -> bool:
        """True if more driving can make the estimate *fine*. The present deviations are not
        tested."""
        return not (self.changes.is_loose or self.has_no_sides)

    @property
    def has_no_sides(self) -> bool:
        """True if no signal of this vehicle distinguishes the drive from its mirror image."""
        return bool(self.checks.not_checked)
