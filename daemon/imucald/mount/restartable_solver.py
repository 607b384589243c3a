"""The solver whose rotation counts, and how another takes its place.

A solver begins anew in five ways: without any hint (`begin_without_rotation`), as the speed came or
went, to go through the first minutes a second time (`look_again`), with what came after a change of
the mount (`begin_after_change`), and with the same next to the old one, which counts until the new
one knows enough (`begin_beside`). The last three go through kept blocks, a little per tick, while
the old one still counts.

Going through kept blocks again into a new solver, a little per tick.

Two uses: once gyro bias and rotation are known, the first minutes are worth a second look; and
after a shift the last minutes are all that counts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from imucald.core.arrays import Array
from imucald.mount.creep import P_CONSTANT, P_CONSTANT_AGAIN
from imucald.mount.estimator_settings import EstimatorSettings, Limits
from imucald.mount.evidence_response import GROUP
from imucald.mount.offsets import Offsets
from imucald.mount.saved_information import SavedInformation
from imucald.mount.signal_blocks import SignalBlock
from imucald.mount.solver import MountSolver
from imucald.mount.states import Manoeuvres

KEPT_BLOCKS = 55
"""Hops that are kept: 350 s."""


class Refit:
    """Feeds kept blocks to a new solver; new blocks queue up behind them."""

    def __init__(self, fresh: MountSolver, blocks: Iterable[SignalBlock], gyro_bias: Array) -> None:
        self.fresh = fresh
        self._queue = deque(blocks)
        self._gyro_bias = gyro_bias

    @property
    def is_behind(self) -> bool:
        """Whether blocks are waiting."""
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
"""The second look takes at least that many blocks (90 s)."""
LAST_LOOK_BLOCKS = 28
"""Without a rest to know the gyro bias from, it waits no longer than that (3 min)."""
EAGER_BLOCKS = 20
"""Up to so many blocks (128 s) each is followed by a fit: it is 5 % of the evidence or more."""
LAZY_BLOCKS = 2
"""Later every second (13 s), ..."""
SEGMENT_BLOCKS = EAGER_BLOCKS * GROUP
"""... and from so many (9 min) on, while the mount is *fine*, each time that a road segment has
ended: only then a whole one is no more than 5 %. Of evidence that has grown by a share g since the
fit, all would move an angle by sqrt(g / (1 + g)) of its deviation and make that smaller by
1 - 1 / sqrt(1 + g): with 5 % by 0.22 and 0.024 at most. Creep is tested once a road segment anyway;
where a small change is near, every block is followed by a fit again (`mount_changes`)."""


class RestartableSolver:
    """A `MountSolver` with what it takes to begin anew.

    now: the solver that counts. kept: the last blocks (350 s). driven: manoeuvres that its
    rotation is found from. has_looked_again: it has gone through its first minutes twice, or
    need not.
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
        """Whether another solver goes through kept blocks and is to take over."""
        return self._refit is not None

    @property
    def is_catching_up(self) -> bool:
        """Whether another solver has kept blocks to go through at the next tick."""
        return self._refit is not None or (self._beside is not None and self._beside.is_behind)

    @property
    def has_beside(self) -> bool:
        """Whether a change is borne: another solver learns from what came after it."""
        return self._beside is not None

    @property
    def beside(self) -> MountSolver | None:
        """The solver that knows only what came after a change, while the old one counts."""
        beside = self._beside
        return None if beside is None or beside.is_behind else beside.fresh

    @property
    def is_outdated(self) -> bool:
        """Whether the solver that counts still is one of the mount before a change."""
        return self._refit is not None and self._follows_change

    @property
    def can_compare(self) -> bool:
        """Whether new blocks can be compared with a rotation."""
        return self.now.R is not None and self.now.yaw_known and not self.is_outdated

    def take(self, p: SignalBlock, without_speed: bool) -> None:
        """Take a block; without_speed: nobody knows the vehicle's speed."""
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
        """Go on by one tick with the solver that is to take over."""
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
        """Whether each block is much of the evidence so far."""
        return self.now.blocks <= EAGER_BLOCKS

    def is_turn(self, block: int, is_fine: bool) -> bool:
        """Whether enough has come since the last fit for another.

        block: its number in the drive. is_fine: nothing better is waited for.
        """
        now = self.now
        if is_fine and now.blocks > SEGMENT_BLOCKS and self._beside is None:
            return now.response.segment != now.fitted_segment
        return block % LAZY_BLOCKS == 0

    def fit(self) -> bool:
        """Fit the rotation to all evidence so far; return whether it is a first one."""
        starts = self.now.starts
        self.now.fit()
        if self.beside is not None:
            self.beside.fit()
        return self.now.starts > starts

    def follow_creep(self, has_shifted: bool) -> None:
        """See once a road segment whether the mount creeps; has_shifted: it did in this drive."""
        if self.now.response.segment != self._segment:
            self._segment = self.now.response.segment
            self.now.p_constant = P_CONSTANT_AGAIN if has_shifted else P_CONSTANT
            self.now.follow_creep()

    def gap(self) -> None:
        """Time jumped."""
        if self._refit is not None and self._follows_change:
            self.now = self._refit.fresh  # what came before the change must not return
        self.now.gap()
        self._refit = self._beside = None
        self.kept.clear()

    def begin_without_rotation(self, blocks: Iterable[SignalBlock] = ()) -> None:
        """Begin anew from these blocks: not even the rotation so far is a hint."""
        self.now = self._new(self.now.response.without_speed)
        self._refit = self._beside = None
        self.has_looked_again = True
        self.driven = Manoeuvres()
        for p in blocks:
            self.driven.add(*self.now.add(p))

    def begin_after_change(self, blocks: Iterable[SignalBlock], offsets: Offsets) -> None:
        """Begin anew from the blocks after a small change of the mount."""
        self.now.past_drives = None  # it is about the mount before
        self.has_looked_again = True
        self.driven = Manoeuvres()
        self._begin_refit(blocks, offsets, follows_change=True)

    def begin_beside(self, blocks: Iterable[SignalBlock], offsets: Offsets) -> None:
        """Let another solver learn from the blocks after a change, while this one counts."""
        fresh = MountSolver(self._settings)
        fresh.start_from(self.now)
        fresh.past_drives = None  # it is about the mount before
        self._beside = Refit(fresh, blocks, offsets.gyro_bias.copy())

    def take_beside(self, limits: Limits) -> bool:
        """Let the second solver count from now on, where it is usable; return whether it does."""
        beside = self.beside
        if beside is None or beside.fused is None or not beside.yaw_known:
            return False
        roll, pitch, yaw = np.sqrt(beside.fused.variance).tolist()
        if max(roll, pitch) >= limits.usable_tilt or yaw >= limits.usable_yaw:
            return False
        self.now, self._beside = beside, None
        return True

    def look_again(self, offsets: Offsets) -> None:
        """Once gyro bias and rotation are known, go through the first minutes again."""
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
        """Chi-square (3) of past drives' evidence against this one's; None without any."""
        past = self.now.past_drives
        return None if past is None else past.contradiction

    def saved_information(self) -> SavedInformation | None:
        """What all evidence comes to, for the next start; None where there is too little."""
        return None if self.is_outdated or self.has_beside else self.now.kept()

    def join(self, kept: SavedInformation) -> None:
        """Go on with what past drives found as well."""
        for solver in self._solvers():
            solver.join(kept)
        self.now.fit()

    def drop_past_drives(self) -> None:
        """Go on with this drive's evidence alone."""
        for solver in self._solvers():
            solver.past_drives = None
        self.now.fit()

    def _solvers(self) -> list[MountSolver]:
        return [self.now] if self._refit is None else [self.now, self._refit.fresh]
