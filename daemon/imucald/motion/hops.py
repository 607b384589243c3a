"""Hops: what half a second of one sensor's samples comes to, axis by axis; for its health.

Everything here is counted or compared, sample by sample, and nothing is smoothed: a run of equal
values, the largest value and how often it came. Live a hop is worked out when it is over, in
replay many at once; both go through `hop_rows`, so they give the same bits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.motion.ticks import TICK_S

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

HOP_TICKS = 5
"""Ticks of a hop: half a second, so that three are over before a fault is two seconds old."""
HOP_S = HOP_TICKS * TICK_S

SIDES = 2
"""Of each axis the upper and the lower extreme are watched."""
WINDOW_HOPS = 120
"""Extremes are those of so many hops of driving (a minute), then new ones are looked for."""


@dataclass
class Carry:
    """What the next hop has to know of those before; arrays by axis, extremes by side and axis.

    last: the last sample, NaN before the first. run: how many samples in a row have been equal to
    it. step: the smallest change so far. extreme: (2, axes), the largest value, and the largest of
    the negated ones, while the vehicle moved in this window. moved: hops of driving so far.
    """

    last: Array
    run: Index
    step: Array
    extreme: Array
    moved: int = 0

    @classmethod
    def none(cls, axes: int) -> Carry:
        """Before the first sample."""
        return cls(
            np.full(axes, math.nan),
            np.zeros(axes, np.int64),
            np.full(axes, math.inf),
            np.full((SIDES, axes), -math.inf),
        )

    def restart(self) -> None:
        """Time jumped: no run goes across."""
        self.last[:] = math.nan
        self.run[:] = 0


@dataclass(frozen=True)
class HopRows:
    """Figures of H hops: count (H,), the others (H, axes), of extremes (H, 2, axes).

    mean: of the samples. level: mean size of the change from sample to sample. step: smallest
    change so far. ended: runs of equal values that ended. longest: of those the longest, but for
    runs at an extreme. run: samples up to the hop's end that are equal. top: the hop's largest
    value. extreme: the largest so far in the window; at_it: samples on it, ties: those that follow
    another on it while another axis changed, below: samples one step, and two steps, below it
    (H, 2, 2, axes). window: the window of each hop.
    """

    count: Index
    mean: Array
    level: Array
    step: Array
    ended: Index
    longest: Index
    run: Index
    top: Array
    extreme: Array
    at_it: Index
    ties: Index
    below: Index
    window: Index


def hop_rows(values: Array, hop: Index, moving: Flags, carry: Carry) -> HopRows:
    """Return the figures of hops 0 .. H-1, and bring `carry` up to their end.

    values: (N, axes) samples. hop: (N,) the hop of each, never decreasing. moving: (H,).
    """
    n, axes = values.shape
    hops = len(moving)
    edges = np.searchsorted(hop, np.arange(hops + 1))
    count = np.diff(edges)
    # All axes in one long column, axis after axis: one call of each function instead of three.
    v = np.ascontiguousarray(values.T)
    change = np.empty((axes, n))
    change[:, 0] = v[:, 0] - carry.last
    np.subtract(v[:, 1:], v[:, :-1], out=change[:, 1:])
    flat, size = v.ravel(), np.abs(change).ravel()
    new = size != 0.0  # NaN, the first of all, is new
    cell = (np.arange(axes)[:, None] * hops + hop).ravel()
    cells = axes * hops
    per = np.maximum(count, 1)
    mean = np.bincount(cell, flat, cells).reshape(axes, hops) / per
    size[np.isnan(size)] = 0.0
    level = np.bincount(cell, size, cells).reshape(axes, hops) / per
    starts = np.flatnonzero(new)
    of_start = cell[starts]
    step = _steps(size[starts], of_start, cells, axes, carry)
    moved = moving & (count > 0)
    window = (carry.moved + np.cumsum(moved) - moved) // WINDOW_HOPS
    top, extreme = _extremes(v, edges, count, moving, window, carry)
    is_new = new.reshape(axes, n)
    alone = (~is_new & (is_new.sum(axis=0) > 0)).ravel()
    run = _runs(starts, edges, n, axes, carry)
    ended = np.bincount(of_start, minlength=cells)
    longest = _longest(v, starts, of_start, extreme, hops, carry)
    at_it, ties, below = _at_extremes(flat, alone, cell, top, extreme, step, moving)
    carry.last = v[:, -1].copy()
    carry.run, carry.step = run[:, -1].copy(), step[:, -1].copy()
    carry.extreme = extreme[:, :, -1].copy()
    carry.moved += int(moved.sum())
    if carry.moved // WINDOW_HOPS > window[-1]:
        carry.extreme[:] = -math.inf
    return HopRows(
        count=count,
        mean=mean.T,
        level=level.T,
        step=step.T,
        ended=ended.reshape(axes, hops).T,
        longest=longest.T,
        run=run.T,
        top=np.moveaxis(top, -1, 0),
        extreme=np.moveaxis(extreme, -1, 0),
        at_it=np.moveaxis(at_it, -1, 0),
        ties=np.moveaxis(ties, -1, 0),
        below=np.moveaxis(below, -1, 0),
        window=window,
    )


def _steps(size: Array, cell: Index, cells: int, axes: int, carry: Carry) -> Array:
    """Smallest change so far (axes, H)."""
    least = np.full(cells, math.inf)
    real = size > 0.0
    np.minimum.at(least, cell[real], size[real])
    first = np.minimum(least.reshape(axes, -1)[:, :1], carry.step[:, None])
    joined = np.concatenate([first, least.reshape(axes, -1)[:, 1:]], axis=1)
    return np.minimum.accumulate(joined, axis=1)


def _extremes(
    v: Array, edges: Index, count: Index, moving: Flags, window: Index, carry: Carry
) -> tuple[Array, Array]:
    """Largest values of each hop, and so far while moving in its window (2, axes, H)."""
    some = count > 0
    top = np.full((SIDES, len(v), len(count)), -math.inf)
    at = edges[:-1][some]
    top[0][:, some] = np.maximum.reduceat(v, at, axis=1)
    top[1][:, some] = -np.minimum.reduceat(v, at, axis=1)
    seen = np.where(moving, top, -math.inf)
    seen[:, :, 0] = np.maximum(seen[:, :, 0], carry.extreme)
    for part in np.split(np.arange(len(count)), np.flatnonzero(np.diff(window)) + 1):
        seen[:, :, part] = np.maximum.accumulate(seen[:, :, part], axis=2)
    return top, seen


def _runs(starts: Index, edges: Index, n: int, axes: int, carry: Carry) -> Index:
    """Equal samples up to each hop's end (axes, H)."""
    first = np.arange(axes)[:, None] * n
    ends = first + edges[1:]
    found = np.searchsorted(starts, ends.ravel() - 1, side="right").reshape(ends.shape) - 1
    begun = starts[np.maximum(found, 0)] if len(starts) else np.full(ends.shape, -1)
    own = (found >= 0) & (begun >= first)
    return np.asarray(np.where(own, ends - begun, ends - first + carry.run[:, None]))


def _longest(
    v: Array, starts: Index, cell: Index, extreme: Array, hops: int, carry: Carry
) -> Index:
    """Longest run that ended in each hop (axes, H); those on an extreme do not count."""
    axes, n = v.shape
    out = np.zeros(axes * hops, np.int64)
    if not len(starts):
        return out.reshape(axes, hops)
    axis, row = np.divmod(starts, n)
    length = np.diff(starts, prepend=0)
    first = np.concatenate([[True], axis[1:] != axis[:-1]])
    length[first] = row[first] + carry.run[axis[first]]
    value = np.where(row > 0, v.ravel()[starts - 1], carry.last[axis])
    high, low = extreme.reshape(SIDES, -1)
    length[(value >= high[cell]) | (-value >= low[cell])] = 0
    np.maximum.at(out, cell, length)
    return out.reshape(axes, hops)


def _at_extremes(
    flat: Array, alone: Flags, cell: Index, top: Array, extreme: Array, step: Array, moving: Flags
) -> tuple[Index, Index, Index]:
    """Samples at the extremes, ties there (2, axes, H), and samples below (2, 2, axes, H)."""
    shape = extreme.shape
    at_it = np.zeros(shape, np.int64)
    ties = np.zeros(shape, np.int64)
    below = np.zeros((2, *shape), np.int64)
    cells = shape[1] * shape[2]
    wide = np.where(np.isfinite(step), 2.5 * step, 0.0)
    near = (top >= extreme - wide) & moving & np.isfinite(extreme)
    for side in range(SIDES):
        if not near[side].any():
            continue
        rows = np.flatnonzero(near[side].ravel()[cell])
        mine = cell[rows]
        value = flat[rows] if side == 0 else -flat[rows]
        under = extreme[side].ravel()[mine] - value
        grain = step.ravel()[mine]
        on = under == 0.0
        one, two = under < 1.5 * grain, under < 2.5 * grain
        for out, chosen in (
            (at_it[side], on),
            (ties[side], on & alone[rows]),
            (below[0, side], one & ~on),
            (below[1, side], two & ~one),
        ):
            out[:] = np.bincount(mine[chosen], minlength=cells).reshape(out.shape)
    return at_it, ties, below
