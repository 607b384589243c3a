"""Was the sensor moved? Every test for that in one place, and what was found in this drive.

`large_change` sees a turn by several degrees in single blocks, `gravity_step` a step that the
gyroscope did not see, `shift` a small change once enough road has been driven, `creep` a slow one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.evidence_response import GROUP
from imucald.mount.gravity_step import GravityStep
from imucald.mount.large_change import LargeChange, LargeChangeDetector
from imucald.mount.shift import Shift
from imucald.mount.signal_blocks import SignalBlock, SignalBlockMaker
from imucald.mount.solver import MountSolver

Array = NDArray[np.float64]
MountChange = Shift | GravityStep | LargeChange

NEAR_SHIFT = 0.8
"""While a change comes to so much of the threshold, every block is followed by a fit again."""
SHIFTS_ALLOWED = 1
"""After more of them in one drive the mount is loose."""


class MountChanges:
    """Tests of a drive for a moved sensor.

    history: each change that was taken, with the number of its block. is_near: whether a change
    that is none yet comes near the threshold.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._large = LargeChangeDetector(settings)
        self.history: list[tuple[int, MountChange]] = []
        self.is_near = False

    def at_once(
        self, p: SignalBlock, solver: MountSolver, signals: SignalBlockMaker
    ) -> LargeChange | None:
        """A turn that this block alone shows: while standing, or by the gyroscope alone.

        solver: it has a rotation, and has taken the block already.
        """
        assert solver.R is not None
        change = self._large.while_standing(p, solver.R)
        if change is None and solver.own_gyro and not signals.without_speed:
            motion = solver.motion(p, solver.R)
            change = self._large.while_driving(p, solver.R, motion, "yaw_rate" in signals.seen)
        return change

    def add(self, p: SignalBlock, solver: MountSolver, has_speed: bool) -> None:
        """Take a block to be held against those before and after it."""
        assert solver.R is not None
        self._large.add(p, solver.R, solver.motion(p, solver.R), has_speed)

    def large(self, solver: MountSolver) -> LargeChange | None:
        """A turn by several degrees within the last blocks."""
        return self._large.found((0, 1, 2) if solver.own_gyro else (0, 1))

    def small(self, solver: MountSolver, thoroughly: bool) -> Shift | GravityStep | None:
        """A step in gravity now; thoroughly: a small change in the last minutes too."""
        step = solver.step()
        if step is not None or not thoroughly:
            return step
        found = solver.largest_change()
        self.is_near = found is not None and found.excess > NEAR_SHIFT
        return None if found is None or found.excess < 1.0 else found

    def skip(self) -> None:
        """Blocks come that cannot be compared with any rotation."""
        self._large.restart()

    def restart(self) -> None:
        """What comes next is another mounting, compared with nothing before."""
        self._large.restart()
        self.is_near = False

    @property
    def is_loose(self) -> bool:
        """Whether the mount moved more often than one that is fixed does."""
        return len(self.history) > SHIFTS_ALLOWED

    def shifted_again(self) -> list[float]:
        """How far each angle has moved [rad] where it was found to have shifted again; else 0."""
        by_axis = [[s.size for _, s in self.history if s.axis == axis] for axis in range(3)]
        return [math.fsum(x) if len(x) > SHIFTS_ALLOWED else 0.0 for x in by_axis]

    def variance(self, solver: MountSolver, blocks: int) -> Array:
        """Variance (3,) [rad^2] from a mount that moves: as it creeps, or as it has moved so far.

        Each shift starts the evidence anew, so that creep hardly shows in what is left. A mount
        that was found turned the same way again and again goes on at that rate. blocks: of the
        whole drive.
        """
        more = np.zeros(3) if solver.creep is None else solver.creep.variance.copy()
        for axis, moved in enumerate(self.shifted_again()):
            since = moved / blocks * 0.5 * solver.blocks
            more[axis] = max(more[axis], since * since)
        return more


def blocks_since(change: MountChange, kept: Sequence[SignalBlock]) -> list[SignalBlock]:
    """Those of the kept blocks that came after a change."""
    if isinstance(change, Shift):
        after = change.segments * GROUP
    elif isinstance(change, LargeChange):
        after = change.blocks - 1  # the oldest holds the change itself
    else:
        after = change.blocks
    return list(kept)[max(len(kept) - after, 0) :]
