"""Detection of a moved sensor. All tests for a move and the changes found in this drive are here.

`large_change` sees a rotation by several degrees in single blocks. `gravity_step` sees a step that
the gyroscope did not see. `shift` sees a small change once enough road has been driven. `creep`
sees a slow one. Where the joint solution is served and has a gyroscope, `joint.moves` takes the
place of `shift`.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.core.rotations import Rows, vector_from_rotation
from imucald.mount.block_sums import block_sums, driven
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.evidence_response import GROUP
from imucald.mount.gravity_step import GravityStep
from imucald.mount.joint.moves import Move
from imucald.mount.large_change import LargeChange, LargeChangeDetector
from imucald.mount.shift import Shift
from imucald.mount.signal_blocks import SignalBlock, SignalBlockMaker
from imucald.mount.solver import MountSolver
from imucald.mount.zero_step import LEAST_TILT, ZeroStep

MountChange = Shift | GravityStep | LargeChange | Move

NEAR_SHIFT = 0.7
"""While a change reaches this share of the threshold, every block is followed by a fit. The
significance of a change grows as the root of the number of road segments that show it. A smaller
change therefore does not reach the threshold within the next segment: from one to two, it grows by
sqrt(2).
"""
SHIFTS_ALLOWED = 1
"""Number of shifts in one drive above which the mount counts as loose."""
ALERT_LIMIT = math.radians(1.0)
"""Error of an angle [rad] below which no consumer is misled."""
ALERT_DEVIATIONS = 4.0
"""Number of stated deviations below which the error of an angle misleads no consumer
(records/integrity.md).
"""
COVERING = 0.5
"""Deviation as a share of a change while the earlier rotation is applied: the 95 % interval then
reaches from the earlier to the new angle.
"""
NORMAL_LEVEL = 4.4
"""Equivalent of the thresholds of `shift` in deviations of a normal variable.

One false alarm in 300 h and angle, with 140 road segments an hour and two independent spans each,
is a chance of 1.2e-5, two-sided.
"""


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

    history: each change that was found. is_near: whether an unconfirmed change is near the
    threshold. borne: movement of each angle (3,) [rad] since the applied rotation was found, if it
    misleads no consumer.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._large = LargeChangeDetector(settings)
        self.zero = ZeroStep(settings)
        self.history: list[TakenChange] = []
        self._open: TakenChange | None = None  # the mount after it may still become more certain
        self.is_near = False
        self.borne = np.zeros(3)
        self._doubted = np.zeros(3)
        self._probability = np.zeros(3)
        self._found: tuple[object, object] | None = None  # inputs of the last variance
        self._with: tuple[object, ...] = ()
        self._last_variance = np.zeros(3)

    def at_once(
        self, p: SignalBlock, solver: MountSolver, signals: SignalBlockMaker
    ) -> LargeChange | None:
        """Return a rotation that this block alone shows: while standing, or by the gyroscope alone.

        solver: has a rotation, and has already taken the block.
        """
        assert solver.R is not None
        change = self._large.while_standing(p, solver.R)
        if change is None and solver.own_gyro and not signals.without_speed:
            motion = solver.motion(p, solver.R)
            change = self._large.while_driving(p, solver.R, motion, "yaw_rate" in signals.seen)
        return change

    def add(self, p: SignalBlock, solver: MountSolver, signals: SignalBlockMaker) -> None:
        """Take a block, which is compared with earlier and later blocks."""
        assert solver.R is not None
        has = not signals.without_speed, "reverse" in signals.seen
        use = driven(p)
        sums = block_sums(p, solver.turn_rate, use)
        motion = solver.motion(p, solver.R)
        self._large.add(sums, use, solver.R, motion, solver.gains(), *has)
        self.zero.add(p, sums, solver)

    def large(self, solver: MountSolver) -> LargeChange | None:
        """Return a rotation by several degrees within the last blocks."""
        return self._large.found(with_yaw=solver.own_gyro)

    def small(self, solver: MountSolver) -> Shift | None:
        """Return a small change in the last minutes."""
        found = solver.largest_change()
        self.forget_doubt()
        if found is not None:
            self.is_near = found.excess > NEAR_SHIFT
            self._doubted[found.axis] = found.size
            self._probability[found.axis] = probability(found.excess)
        return None if found is None or found.excess < 1.0 else found

    def is_bearable(self, found: MountChange, solver: MountSolver, std: float) -> bool:
        """True if the applied correction misleads no consumer after a change.

        std: stated deviation of the changed angle [rad], without the part that the same change
        added before it was confirmed. A sudden tilt may be a step of the zero. No deviation of the
        mount includes such a step (`zero_step`).
        """
        if not math.isfinite(std) or self._may_be_stepped_zero(found, solver):
            return False
        return abs(found.size) <= max(ALERT_LIMIT, ALERT_DEVIATIONS * std)

    def stated(self, solver: MountSolver, blocks: int) -> tuple[float, ...]:
        """Return the solver's deviations (3,) [rad] without the part that an unconfirmed change
        adds."""
        if solver.fused is None:
            return (math.inf, math.inf, math.inf)
        variance = solver.fused.variance + self._variance(solver, blocks, self._of_borne())
        return tuple(np.sqrt(variance).tolist())

    @staticmethod
    def _may_be_stepped_zero(found: MountChange, solver: MountSolver) -> bool:
        is_sudden_tilt = found.axis < 2 and not isinstance(found, Shift | Move)
        return is_sudden_tilt and abs(found.size) > LEAST_TILT and solver.own_gyro

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

    def take(self, found: MountChange, block: int, std: float, good: GoodMount | None) -> None:
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
        self._follow()
        self.borne[:] = 0.0

    def know_borne(self) -> None:
        """Note that another solver now knows the mounting since a change that is still
        tolerated.
        """
        self._open = next((one for one in reversed(self.history) if one.is_borne), None)
        self._follow()

    def _follow(self) -> None:
        """Note that another solver replaces the present one."""
        self._large.restart()
        self.forget_doubt()

    def forget_doubt(self) -> None:
        """Forget a small change that was not certain."""
        self.is_near = False
        self._doubted[:] = 0.0

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

    def variance(self, solver: MountSolver, blocks: int) -> Array:
        """Return the variance (3,) [rad^2] from a moving mount: from its creep, or from its shifts
        so far.

        The variance contains a tolerated change. It also contains an unconfirmed change, weighted
        by its probability, unless the deviation is already that large: a change also widens the
        deviation by spreading the evidence. Each shift restarts the evidence, so creep hardly shows
        in the rest. A mount that was found turned the same way again and again is assumed to
        continue at that rate. blocks: those of the whole drive.
        """
        doubted = self._doubted, self._probability
        found, sizes = (solver.fused, solver.creep), (*doubted, self.borne)
        others = solver.blocks, blocks, len(self.history), *(x.tobytes() for x in sizes)
        is_made = self._found is not None and all(map(operator.is_, self._found, found))
        if not is_made or others != self._with:  # it is called three times per block
            self._found, self._with = found, others
            self._last_variance = self._variance(solver, blocks, doubted, self._of_borne())
        return self._last_variance

    def _of_borne(self) -> tuple[Array, Array]:
        return self.borne, np.ones(3)

    def _variance(self, solver: MountSolver, blocks: int, *changes: tuple[Array, Array]) -> Array:
        """Compute `variance`.

        changes: sizes (3,) [rad] and probabilities (3,) of the changes to cover.
        """
        nothing = [0.0, 0.0, 0.0]
        creeping = nothing if solver.creep is None else solver.creep.variance.tolist()
        found = nothing if solver.fused is None else solver.fused.variance.tolist()
        moved = self.shifted_again()
        by_axis = [list(zip(x.tolist(), p.tolist(), strict=True)) for x, p in changes]
        variance = []
        for axis in range(3):
            since = moved[axis] / blocks * 0.5 * solver.blocks
            more = max(creeping[axis], since * since)
            known = more + found[axis]
            for size, part in (one[axis] for one in by_axis):
                covering = COVERING * size
                widened = min(part * size * size, max(covering * covering - known, 0.0))
                more, known = more + widened, known + widened
            variance.append(more)
        return np.array(variance)


def probability(excess: float) -> float:
    """Return the probability of a change that reaches this share of its threshold.

    At the threshold the probability is one half; below it the odds are those of a normal variable.
    """
    return 1.0 / (1.0 + math.exp(0.5 * NORMAL_LEVEL**2 * (1.0 - min(excess, 1.0) ** 2)))


def blocks_since(change: MountChange, kept: Sequence[SignalBlock]) -> list[SignalBlock]:
    """Return the stored blocks after a change."""
    if isinstance(change, Shift):
        after = change.segments * GROUP
    elif isinstance(change, Move):
        after = change.blocks
    elif isinstance(change, LargeChange):
        after = change.blocks - 1  # the oldest holds the change itself
    else:
        after = change.blocks - 2  # and its time is uncertain by one block
    return list(kept)[max(len(kept) - after, 0) :]
