"""Detection of a moved sensor. All tests for a move and the changes found in this drive are here.

`hand_moves` detects a sensor that is turned by hand or by a knock. `joint.sudden_changes` detects a
sudden rotation with a filter. `joint.moves` detects a move from the responses to motion, after
enough road was driven. `creep` detects a slow move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.core.rotations import Rows, vector_from_rotation
from imucald.mount.carried_force import CarriedForce
from imucald.mount.hand_moves import HandMove, HandMoves
from imucald.mount.joint.moves import Move
from imucald.mount.joint.sudden_changes import SuddenChange
from imucald.mount.signal_blocks import SignalBlock, SignalBlockMaker


class SuddenTurn(Struct, frozen=True):
    """A sudden rotation of the sensor, described by its largest angle.

    axis: 0 roll, 1 pitch, 2 yaw. size: largest angle [rad]. deviations: largest angle in standard
    deviations. blocks: number of blocks since the rotation. turn: (3,) whole rotation vector in
    vehicle axes [rad].
    """

    axis: int
    size: float
    deviations: float
    blocks: int
    turn: Array

    @classmethod
    def from_change(cls, change: SuddenChange) -> SuddenTurn:
        """Return the rotation of a sudden change that is a turn."""
        axis = int(np.abs(change.size).argmax())
        size, std = float(change.size[axis]), math.sqrt(change.covariance[axis, axis])
        return cls(axis, size, size / std, change.blocks, change.size)


MountChange = SuddenTurn | HandMove | Move

SHIFTS_ALLOWED = 1
"""Number of shifts in one drive above which the mount counts as loose."""
ALERT_LIMIT = math.radians(1.0)
"""Error of an angle [rad] below which no consumer is misled."""
ALERT_DEVIATIONS = 4.0
"""Error of an angle, in stated deviations, below which no consumer is misled
(records/integrity.md).
"""


MOST_TILT = 0.35
"""Largest change in the direction of gravity that a zero error of the accelerometer can cause
[rad]: 350 mg."""


class GoodMount(Struct, frozen=True):
    """R: R_vehicle_from_sensor, row by row. std: deviations about the vehicle's axes (3,) [rad]."""

    R: Rows
    std: tuple[float, ...]


class TakenChange(Struct):
    """A change that was found.

    block: number of the block in the drive. change: result of the test, for one angle. std: stated
    deviation of this angle at this time [rad]. before: good mount before the change. after: good
    mount at the time of the next change. before and after are None if there was no good mount.
    is_borne: the change misleads no consumer, and the rotation stayed in use.
    """

    block: int
    change: MountChange
    std: float
    before: GoodMount | None = None
    after: GoodMount | None = None
    is_borne: bool = False

    def turn(self, now: GoodMount | None) -> tuple[Array, Array] | None:
        """Return the rotation of the mount since the change, or None if one of the two mounts is
        not known.

        The result is a rotation vector (3,) about the vehicle's axes [rad] and, for each axis (3,),
        the larger deviation of the two mounts [rad]. now: present good mount, if there was no other
        change since.
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
    rotation was found, if the movement misleads no consumer.
    """

    def __init__(self) -> None:
        self._hand_moves = HandMoves()
        self.history: list[TakenChange] = []
        self._open: TakenChange | None = None  # the mount after it may still become more certain
        self.borne = np.zeros(3)

    def at_once(
        self, p: SignalBlock, carried: CarriedForce, signals: SignalBlockMaker, is_watched: bool
    ) -> HandMove | None:
        """Return a rotation that this block alone shows: while standing, or from the gyroscope
        alone.

        carried: has a rotation, and has already taken the block. is_watched: the filter of
        `joint.sudden_changes` runs and can distinguish a tilt from a step of a zero error.
        """
        assert carried.R is not None
        change = self._hand_moves.while_standing(p, carried.R)
        if is_watched and _may_be_zero(change):
            change = None
        if change is None and carried.own_gyro and not signals.without_speed:
            turns = carried.turn_rate, carried.lone @ carried.R[1]
            has_yaw_rate = "yaw_rate" in signals.seen
            change = self._hand_moves.while_driving(p, carried.R, *turns, has_yaw_rate)
        return change

    @staticmethod
    def is_bearable(found: MountChange, std: float) -> bool:
        """True if the applied correction misleads no consumer after a change.

        std: stated deviation of the changed angle [rad]. If the unconfirmed change has enlarged
        this deviation, the enlargement is left out.
        """
        return math.isfinite(std) and abs(found.size) <= max(ALERT_LIMIT, ALERT_DEVIATIONS * std)

    def bear(self, found: MountChange, block: int, std: float, good: GoodMount | None) -> bool:
        """Register a change that misleads no consumer. Returns True if the change is new.

        std: stated deviation of the changed angle [rad]. good: good mount before the change.
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
        """Register a change after which the mount is searched again. good: good mount before the
        change."""
        self.history.append(TakenChange(block, found, std, before=good))
        self._open = self.history[-1]

    def end_of_mounting(self, good: GoodMount | None) -> None:
        """End the present mounting, because of another change or a restart.

        good: good mount until now.
        """
        if self._open is not None:
            self._open.after = good
        self._open = None

    def skip(self) -> None:
        """Restart the tests, because there is no rotation."""
        self._hand_moves.restart()

    def restart(self) -> None:
        """Begin another mounting. The data of the new mounting are not compared with earlier
        data."""
        self._hand_moves.restart()
        self.borne[:] = 0.0

    def know_borne(self) -> None:
        """Note that the mount since a tolerated change is known now."""
        self._open = next((one for one in reversed(self.history) if one.is_borne), None)
        self.restart()

    @property
    def is_loose(self) -> bool:
        """True if the mount moved more often than a fixed mount does."""
        return len(self.history) > SHIFTS_ALLOWED

    def shifted_again(self) -> list[float]:
        """Change of each angle [rad] that has shifted repeatedly; 0 for an angle that has not."""
        every = [one.change for one in self.history]
        by_axis = [[change.size for change in every if change.axis == axis] for axis in range(3)]
        return [math.fsum(x) if len(x) > SHIFTS_ALLOWED else 0.0 for x in by_axis]

    def turns(self, now: GoodMount | None) -> list[tuple[Array, Array] | None]:
        """Return `TakenChange.turn` of each change. now: present good mount."""
        return [one.turn(now if one is self._open else None) for one in self.history]


def _may_be_zero(found: HandMove | None) -> bool:
    """True if the change may be a step of the accelerometer's zero error. The gyroscope does not
    show such a step."""
    return (
        found is not None and found.axis < 2 and not found.is_felt and abs(found.size) < MOST_TILT
    )


def blocks_since(
    change: MountChange | SuddenChange, kept: Sequence[SignalBlock]
) -> list[SignalBlock]:
    """Return the stored blocks after a change."""
    after = change.blocks if isinstance(change, Move) else change.blocks - 1  # one may hold it
    return list(kept)[max(len(kept) - after, 0) :]
