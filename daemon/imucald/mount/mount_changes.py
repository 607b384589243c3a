"""Detection of a moved sensor. All tests for a move and the changes found in this drive are here.

`joint.sudden_changes` sees a sudden rotation. `large_change` sees a yaw by several degrees in
single blocks, and a tilt where that filter does not run: without a gyroscope or a speed, or before
it has a solution. `joint.moves` sees a small move once enough road has been driven. `creep` sees a
slow one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.core.rotations import Rows, vector_from_rotation
from imucald.mount.block_sums import block_sums, driven
from imucald.mount.carried_force import CarriedForce
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.joint.moves import Move
from imucald.mount.joint.sudden_changes import SuddenChange
from imucald.mount.large_change import LargeChange, LargeChangeDetector
from imucald.mount.signal_blocks import SignalBlock, SignalBlockMaker


class SuddenTurn(Struct, frozen=True):
    """A sudden rotation that was found: the largest of its angles, by axis (0 roll, 1 pitch, 2
    yaw).

    size: that angle [rad]; deviations: the same in standard deviations. blocks: number of blocks
    since. turn: (3,) whole rotation vector in vehicle axes [rad].
    """

    axis: int
    size: float
    deviations: float
    blocks: int
    turn: Array

    @classmethod
    def from_change(cls, change: SuddenChange) -> SuddenTurn:
        """Return the rotation of a change that is a turn."""
        axis = int(np.abs(change.size).argmax())
        size, std = float(change.size[axis]), math.sqrt(change.covariance[axis, axis])
        return cls(axis, size, size / std, change.blocks, change.size)


MountChange = SuddenTurn | LargeChange | Move

SHIFTS_ALLOWED = 1
"""Number of shifts in one drive above which the mount counts as loose."""
ALERT_LIMIT = math.radians(1.0)
"""Error of an angle [rad] below which no consumer is misled."""
ALERT_DEVIATIONS = 4.0
"""Number of stated deviations below which the error of an angle misleads no consumer
(records/integrity.md).
"""


MOST_TILT = 0.35
"""Largest change of gravity that a zero of the accelerometer can cause [rad]: 350 mg."""


class GoodMount(Struct, frozen=True):
    """R: R_vehicle_from_sensor, by rows; std: deviations about the vehicle's axes (3,) [rad]."""

    R: Rows
    std: tuple[float, ...]


class TakenChange(Struct):
    """A change that was found.

    block: its number in the drive. change: result of the test, for one angle. std: stated deviation
    of that angle at that time [rad]. before, after: the good mount before the change, and the good
    mount when the next change came; None if there was none. is_borne: the change misleads no
    consumer, and the rotation stayed in use.
    """

    block: int
    change: MountChange
    std: float
    before: GoodMount | None = None
    after: GoodMount | None = None
    is_borne: bool = False

    def turn(self, now: GoodMount | None) -> tuple[Array, Array] | None:
        """Return the rotation of the mount since the change, or None.

        The result is a rotation vector (3,) about the vehicle's axes and the larger deviation (3,)
        [rad] of both mounts; None if one mount is not known.

        now: the mount that is good now, if no other change has come.
        """
        after = self.after if now is None else now
        if self.before is None or after is None:
            return None
        R_after, R_before = (np.array(one.R).reshape(3, 3) for one in (after, self.before))
        std = np.maximum(after.std, self.before.std)
        return vector_from_rotation(R_after @ R_before.T), std


class MountChanges:
    """Tests for a moved sensor in one drive.

    history: each change that was found. borne: movement of each angle (3,) [rad] since the applied
    rotation was found, if it misleads no consumer.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._large = LargeChangeDetector(settings)
        self.history: list[TakenChange] = []
        self._open: TakenChange | None = None  # the mount after it may still become more certain
        self.borne = np.zeros(3)

    def at_once(
        self, p: SignalBlock, carried: CarriedForce, signals: SignalBlockMaker, is_watched: bool
    ) -> LargeChange | None:
        """Return a rotation that this block alone shows: while standing, or by the gyroscope alone.

        carried: has a rotation, and has already taken the block. is_watched: as in `large`.
        """
        assert carried.R is not None
        change = self._large.while_standing(p, carried.R)
        if is_watched and _may_be_zero(change):
            change = None
        if change is None and carried.own_gyro and not signals.without_speed:
            motion = carried.motion(p, carried.R)
            change = self._large.while_driving(p, carried.R, motion, "yaw_rate" in signals.seen)
        return change

    def take_block(self, p: SignalBlock, carried: CarriedForce, signals: SignalBlockMaker) -> None:
        """Take a block, which is compared with earlier and later blocks."""
        assert carried.R is not None
        has = not signals.without_speed, "reverse" in signals.seen
        use = driven(p)
        sums = block_sums(p, carried.turn_rate, use)
        motion = carried.motion(p, carried.R)
        self._large.take_block(sums, use, carried.R, motion, carried.gains, *has)

    def large(self, carried: CarriedForce, is_watched: bool) -> LargeChange | None:
        """Return a rotation by several degrees within the last blocks.

        is_watched: the filter of `joint.sudden_changes` tells a tilt from a step of a zero.
        """
        found = self._large.found(with_yaw=carried.own_gyro)
        return None if is_watched and _may_be_zero(found) else found

    @staticmethod
    def is_bearable(found: MountChange, std: float) -> bool:
        """True if the applied correction misleads no consumer after a change.

        std: stated deviation of the changed angle [rad], without the part that the same change
        added before it was confirmed.
        """
        return math.isfinite(std) and abs(found.size) <= max(ALERT_LIMIT, ALERT_DEVIATIONS * std)

    def bear(self, found: MountChange, block: int, std: float, good: GoodMount | None) -> bool:
        """Take a change that misleads no consumer; return whether it is new.

        std: stated deviation of its angle [rad]; good: the mount before it.
        """
        borne = float(self.borne[found.axis])
        is_new = borne == 0.0 or borne * found.size < 0.0
        if is_new:
            self.history.append(TakenChange(block, found, std, before=good, is_borne=True))
        if is_new or abs(found.size) > abs(borne):
            self.borne[found.axis] = found.size
        return is_new

    def note_change(
        self, found: MountChange, block: int, std: float, good: GoodMount | None
    ) -> None:
        """Take a change after which the mount is searched again. good: the mount before it."""
        self.history.append(TakenChange(block, found, std, before=good))
        self._open = self.history[-1]

    def end_of_mounting(self, good: GoodMount | None) -> None:
        """End the present mounting, because of another change or a restart.

        good: the mount until now.
        """
        if self._open is not None:
            self._open.after = good
        self._open = None

    def skip(self) -> None:
        """Restart the test for large changes: there is no rotation to compare blocks with."""
        self._large.restart()

    def restart(self) -> None:
        """Begin another mounting, which is not compared with earlier data."""
        self._large.restart()
        self.borne[:] = 0.0

    def know_borne(self) -> None:
        """Note that the mounting since a tolerated change is known now."""
        self._open = next((one for one in reversed(self.history) if one.is_borne), None)
        self.restart()

    @property
    def is_loose(self) -> bool:
        """True if the mount moved more often than a fixed mount does."""
        return len(self.history) > SHIFTS_ALLOWED

    def shifted_again(self) -> list[float]:
        """Change of each angle [rad] that has shifted repeatedly; 0 for the others."""
        every = [one.change for one in self.history]
        by_axis = [[change.size for change in every if change.axis == axis] for axis in range(3)]
        return [math.fsum(x) if len(x) > SHIFTS_ALLOWED else 0.0 for x in by_axis]

    def turns(self, now: GoodMount | None) -> list[tuple[Array, Array] | None]:
        """Return `TakenChange.turn` of each change. now: the mount that is good now."""
        return [one.turn(now if one is self._open else None) for one in self.history]


def _may_be_zero(found: LargeChange | None) -> bool:
    """True if a rotation may be a step of a zero, which turns no gyroscope."""
    return (
        found is not None and found.axis < 2 and not found.is_felt and abs(found.size) < MOST_TILT
    )


def blocks_since(
    change: MountChange | SuddenChange, kept: Sequence[SignalBlock]
) -> list[SignalBlock]:
    """Return the stored blocks after a change."""
    after = change.blocks if isinstance(change, Move) else change.blocks - 1  # one may hold it
    return list(kept)[max(len(kept) - after, 0) :]
