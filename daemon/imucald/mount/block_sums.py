"""Sums over the ticks of a block, in one order of summation, by numpy or the compiled part."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.core import compiled
from imucald.core.arrays import Array
from imucald.mount.signal_blocks import SignalBlock

Flags = NDArray[np.bool_]


class BlockSums(NamedTuple):
    """Over n ticks: force (3,) in sensor axes, dv/dt, v r [m/s^2], the speed's size [m/s].

    fastest: the largest of the latter.
    """

    n: int
    force: tuple[float, float, float]
    accel: float
    turn: float
    speed: float
    fastest: float


def driven(p: SignalBlock) -> Flags:
    """Ticks (N,) that may be learnt from, and of which it is known how fast the vehicle drives."""
    return p.learn & (p.ok_speed | p.rest)


def block_sums(p: SignalBlock, turn_rate: Array, use: Flags) -> BlockSums:
    """Of the ticks (N,) in use; turn_rate: (N,) r [rad/s]."""
    out = np.empty(8)
    if compiled.kernels is not None:
        flags = compiled.kernels.block_sums(use, p.force, p.accel, p.speed, turn_rate, out)
        if flags:
            compiled.note(flags)
    else:
        size = np.abs(p.speed) * use
        out[0] = np.count_nonzero(use)
        (p.force * use[:, None]).sum(axis=0, out=out[1:4])
        out[4] = (p.accel * use).sum()
        out[5] = (p.speed * turn_rate * use).sum()
        out[6], out[7] = size.sum(), size.max()
    n, x, y, z, accel, turn, speed, fastest = out.tolist()
    return BlockSums(int(n), (x, y, z), accel, turn, speed, fastest)


def pair_sums(
    x: Array, y: Array, use: Flags, centred: bool = False
) -> tuple[int, float, float, float]:
    """How many ticks (N,) are in use, and of those the sums of x x, x y, y y.

    centred: about the means.
    """
    if compiled.kernels is not None:
        out = np.empty(4)
        flags = compiled.kernels.pair_sums(x, y, use, centred, out)
        if flags:
            compiled.note(flags)
        n, xx, xy, yy = out.tolist()
        return int(n), xx, xy, yy
    count = int(np.count_nonzero(use))
    if not count:
        return 0, 0.0, 0.0, 0.0
    if count < len(use):
        x, y = x[use], y[use]
    if centred:
        x, y = x - x.sum() / count, y - y.sum() / count
    xx, xy, yy = (float(one.sum()) for one in (x * x, x * y, y * y))
    return count, xx, xy, yy


def masked_sums(values: Array, use: Flags) -> tuple[int, float, float, float]:
    """How many ticks (N,) are in use, and the sums of their vectors (N, 3)."""
    out = np.empty(4)
    if compiled.kernels is not None:
        flags = compiled.kernels.masked_sums(values, use, out)
        if flags:
            compiled.note(flags)
    else:
        out[0] = np.count_nonzero(use)
        (values * use[:, None]).sum(axis=0, out=out[1:])
    n, x, y, z = out.tolist()
    return int(n), x, y, z
