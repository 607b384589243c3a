"""The solver in use, and its replacement by another solver.

A solver restarts in five ways. `begin_without_rotation` uses no earlier rotation. A change between
known and unknown speed begins a new solver. `look_again` reads the first minutes a second time.
`begin_after_change` uses the data after a change of the mount. `begin_beside` does the same in a
second solver, while the old one stays in use. The last three read stored blocks, a few per tick,
while the old solver stays in use.

`Refit` feeds stored blocks into a new solver, a few per tick.

`Refit` has two uses. Once gyro bias and rotation are known, the first minutes are read again. After
a shift, only the last minutes count.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from imucald.core.arrays import Array
from imucald.mount.estimator_settings import EstimatorSettings, Limits
from imucald.mount.evidence_response import GROUP
from imucald.mount.offsets import Offsets
from imucald.mount.saved_information import SavedInformation
from imucald.mount.signal_blocks import SignalBlock
from imucald.mount.solver import MountSolver
from imucald.mount.states import Manoeuvres

KEPT_BLOCKS = 55
"""Blocks that are stored: 350 s."""


class Refit:
    """Feeds stored blocks to a new solver; new blocks queue up behind them."""

    def __init__(self, fresh: MountSolver, blocks: Iterable[SignalBlock], gyro_bias: Array) -> None:
        self.fresh = fresh
        self._queue = deque(blocks)
        self._gyro_bias = gyro_bias

    @property
    def is_behind(self) -> bool:
        """True if blocks are waiting."""
        return bool(self._queue)

    def push(self, p: SignalBlock) -> None:
        """Queue a new block."""
        self._queue.append(p)

    def step(self) -> tuple[Array, Array] | None:
        """Feed one block; return its dv/dt and v r, or None when all is done."""
        if not self._queue:
            self.fresh.fit()
            return None
        p = self._queue.popleft()
        return self.fresh.add(p.with_gyro_bias(self._gyro_bias))


KNOWN_REST_TICKS = 25.0
"""Ticks at rest from which the gyro bias counts as known."""
FIRST_LOOK_BLOCKS = 14
"""Smallest number of blocks for the second look (90 s)."""
LAST_LOOK_BLOCKS = 28
"""Blocks (3 min) after which the second look begins even without a rest that measures the gyro
bias.
"""
EAGER_BLOCKS = 20
"""Up to this many blocks (128 s), each block is followed by a fit, because it is 5 % of the
evidence or more.
"""
LAZY_BLOCKS = 2
"""Later, every second block (13 s) is followed by a fit, ..."""
SEGMENT_BLOCKS = EAGER_BLOCKS * GROUP
"""... and from this many blocks (9 min) on, while the mount is *fine*, each end of a road segment:
only then is a whole segment no more than 5 %. If evidence has grown by a share g since the fit, a
new fit would move an angle by sqrt(g / (1 + g)) of its deviation and reduce the deviation by 1 - 1
/ sqrt(1 + g). With 5 % these are 0.22 and 0.024 at most. Creep is tested once a road segment
anyway. While a small change is near, every block is followed by a fit again (`mount_changes`).
"""


class RestartableSolver:
    """A `MountSolver` that can restart.

    now: the solver in use. kept: the last blocks (350 s). driven: manoeuvres from which its
    rotation is found. has_looked_again: it has read its first minutes twice, or does not need to.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self.now = MountSolver(settings)
        self.kept: deque[SignalBlock] = deque(maxlen=KEPT_BLOCKS)
        self.driven = Manoeuvres()
        self.has_looked_again = False
        self._refit: Refit | None = None
        self._follows_change = False
        self._beside: Refit | None = None
        self._segment = 0

    @property
    def is_refitting(self) -> bool:
        """True if another solver reads stored blocks and will replace this one."""
        return self._refit is not None

    @property
    def is_catching_up(self) -> bool:
        """True if another solver still has stored blocks to read at the next tick."""
        return self._refit is not None or (self._beside is not None and self._beside.is_behind)

    @property
    def has_beside(self) -> bool:
        """True if a change is tolerated while another solver learns from the data after it."""
        return self._beside is not None

    @property
    def beside(self) -> MountSolver | None:
        """Solver that knows only the data after a change, while the old one stays in use."""
        beside = self._beside
        return None if beside is None or beside.is_behind else beside.fresh

    @property
    def is_outdated(self) -> bool:
        """True if the solver in use still describes the mount before a change."""
        return self._refit is not None and self._follows_change

    @property
    def can_compare(self) -> bool:
        """True if new blocks can be compared with a rotation."""
        return self.now.R is not None and self.now.yaw_known and not self.is_outdated

    def take(self, p: SignalBlock, without_speed: bool) -> None:
        """Take a block. without_speed: the vehicle's speed is unknown."""
        self.kept.append(p)
        if without_speed != self.now.response.without_speed:  # evidence of another kind
            self.now, self._beside = self._new(without_speed), None
        self.driven.add(*self.now.add(p))
        if self._refit is not None:
            self._refit.push(p)
        if self._beside is not None:
            was_behind = self._beside.is_behind
            self._beside.push(p)
            if not was_behind:
                self._beside.step()

    def step(self) -> None:
        """Continue the replacing solver by one tick."""
        if self._refit is None:
            if self._beside is not None and self._beside.is_behind:
                self._beside.step()
            return
        done = self._refit.step()
        if done is None:
            self.now, self._refit = self._refit.fresh, None
        elif self._follows_change:
            self.driven.add(*done)

    @property
    def is_young(self) -> bool:
        """True if each block is a large part of the evidence so far."""
        return self.now.blocks <= EAGER_BLOCKS

    def is_turn(self, block: int, is_fine: bool) -> bool:
        """True if enough evidence has come since the last fit for a new fit.

        block: its number in the drive. is_fine: no better state is possible.
        """
        now = self.now
        if is_fine and now.blocks > SEGMENT_BLOCKS and self._beside is None:
            return now.response.segment != now.fitted_segment
        return block % LAZY_BLOCKS == 0

    def fit(self) -> bool:
        """Fit the rotation to all evidence so far; return whether it is the first fit."""
        starts = self.now.starts
        self.now.fit()
        if self.beside is not None:
            self.beside.fit()
        return self.now.starts > starts

    def follow_creep(self, shifts: int) -> None:
        """Test once a road segment whether the mount creeps. shifts: found in this drive."""
        if self.now.response.segment != self._segment:
            self._segment = self.now.response.segment
            self.now.follow_creep(shifts)

    def gap(self) -> None:
        """Note a jump of time."""
        if self._refit is not None and self._follows_change:
            self.now = self._refit.fresh  # data from before the change must not return
        self.now.gap()
        self._refit = self._beside = None
        self.kept.clear()

    def begin_without_rotation(self, blocks: Iterable[SignalBlock] = ()) -> None:
        """Restart from these blocks, without the rotation so far even as a hint."""
        self.now = self._new(self.now.response.without_speed)
        self._refit = self._beside = None
        self.has_looked_again = True
        self.driven = Manoeuvres()
        for p in blocks:
            self.driven.add(*self.now.add(p))

    def begin_after_change(self, blocks: Iterable[SignalBlock], offsets: Offsets) -> None:
        """Restart from the blocks after a small change of the mount."""
        self.now.past_drives = None  # it is about the mount before
        self.has_looked_again = True
        self.driven = Manoeuvres()
        self._begin_refit(blocks, offsets, follows_change=True)

    def begin_beside(self, blocks: Iterable[SignalBlock], offsets: Offsets) -> None:
        """Let another solver learn from the blocks after a change, while this one stays in use."""
        fresh = MountSolver(self._settings)
        fresh.start_from(self.now)
        fresh.past_drives = None  # it is about the mount before
        self._beside = Refit(fresh, blocks, offsets.gyro_bias.copy())

    def take_beside(self, limits: Limits) -> bool:
        """Switch to the second solver if it is usable; return whether it was switched."""
        beside = self.beside
        if beside is None or beside.fused is None or not beside.yaw_known:
            return False
        roll, pitch, yaw = np.sqrt(beside.fused.variance).tolist()
        if max(roll, pitch) >= limits.usable_tilt or yaw >= limits.usable_yaw:
            return False
        self.now, self._beside = beside, None
        return True

    def look_again(self, offsets: Offsets) -> None:
        """Once gyro bias and rotation are known, read the first minutes again."""
        is_bias_known = offsets.gyro_ticks >= KNOWN_REST_TICKS
        is_long_enough = len(self.kept) >= FIRST_LOOK_BLOCKS
        is_late = len(self.kept) >= LAST_LOOK_BLOCKS
        if self.now.sure() and is_long_enough and (is_bias_known or is_late):
            self.has_looked_again = True
            self._begin_refit(self.kept, offsets, follows_change=False)

    def _new(self, without_speed: bool) -> MountSolver:
        solver = MountSolver(self._settings)
        solver.response.without_speed = without_speed
        return solver

    def _begin_refit(
        self, blocks: Iterable[SignalBlock], offsets: Offsets, follows_change: bool
    ) -> None:
        fresh = MountSolver(self._settings)
        fresh.start_from(self.now)
        self._refit = Refit(fresh, blocks, offsets.gyro_bias.copy())
        self._follows_change, self._beside = follows_change, None

    # past drives ----------------------------------------------------------------------------

    @property
    def contradiction(self) -> float | None:
        """Chi-square (3) of this drive's evidence against that of past drives; None without past
        drives.
        """
        past = self.now.past_drives
        return None if past is None else past.contradiction

    def saved_information(self) -> SavedInformation | None:
        """Information of all evidence, for the next start; None if there is too little."""
        return None if self.is_outdated or self.has_beside else self.now.kept()

    def join(self, kept: SavedInformation) -> None:
        """Add the information that past drives found."""
        for solver in self._solvers():
            solver.join(kept)
        self.now.fit()

    def drop_past_drives(self) -> None:
        """Continue with the evidence of this drive alone."""
        for solver in self._solvers():
            solver.past_drives = None
        self.now.fit()

    def _solvers(self) -> list[MountSolver]:
        return [self.now] if self._refit is None else [self.now, self._refit.fresh]
