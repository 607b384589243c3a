"""Going through kept hops again into a new solution, a little per tick.

Two uses: once gyro bias and rotation are known, the first minutes are worth a second look; and
after a shift the last minutes are all that counts.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from imucald.mount.signal_blocks import Prepared
from imucald.mount.solver import Solution

Array = NDArray[np.float64]

KEPT_HOPS = 55
"""Hops that are kept: 350 s."""


class Rebuild:
    """Feeds kept hops to a new solution; new hops queue up behind them."""

    def __init__(self, fresh: Solution, hops: list[Prepared], gyro_bias: Array) -> None:
        self.fresh = fresh
        self._queue = deque(hops)
        self._gyro_bias = gyro_bias

    def push(self, p: Prepared) -> None:
        """Queue a new hop."""
        self._queue.append(p)

    def step(self) -> tuple[Array, Array] | None:
        """Feed one hop; return its dv/dt and v r, or None when all is done."""
        if not self._queue:
            self.fresh.fit()
            return None
        p = self._queue.popleft()
        return self.fresh.add(p.with_gyro_bias(self._gyro_bias))
