"""Going through kept blocks again into a new solver, a little per tick.

Two uses: once gyro bias and rotation are known, the first minutes are worth a second look; and
after a shift the last minutes are all that counts.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from imucald.core.arrays import Array
from imucald.mount.signal_blocks import SignalBlock
from imucald.mount.solver import MountSolver

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
