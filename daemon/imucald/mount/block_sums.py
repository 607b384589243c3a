"""Sums over the ticks of a block."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.mount.signal_blocks import SignalBlock


def driven(p: SignalBlock) -> Flags:
    """Return flags (N,) of the usable ticks whose speed is known or zero."""
    return p.learn & (p.ok_speed | p.rest)


class PairSums(NamedTuple):
    """Sums over ticks of two signals x and y: number of ticks, x x, x y, y y, x, y."""

    ticks: float = 0.0
    xx: float = 0.0
    xy: float = 0.0
    yy: float = 0.0
    x: float = 0.0
    y: float = 0.0

    def centred(self) -> PairSums:
        """Return the sums after the means of x and y were subtracted."""
        n, xx, xy, yy, x, y = self
        n = max(n, 1.0)
        return PairSums(n, xx - x * x / n, xy - x * y / n, yy - y * y / n)


def pair_sums(x: Array, y: Array, use: Flags) -> PairSums:
    """Return the sums of two signals (N,) over the ticks that `use` (N,) selects."""
    count = int(np.count_nonzero(use))
    if not count:
        return PairSums()
    if count < len(use):
        x, y = x[use], y[use]
    return PairSums(count, *(float(one.sum()) for one in (x * x, x * y, y * y, x, y)))


def masked_sums(values: Array, use: Flags) -> tuple[int, float, float, float]:
    """Return the number of ticks that `use` (N,) selects, and the sums of their vectors (N, 3)."""
    out = np.empty(4)
    out[0] = np.count_nonzero(use)
    (values * use[:, None]).sum(axis=0, out=out[1:])
    n, x, y, z = out.tolist()
    return int(n), x, y, z
