"""A hop is half a second of one sensor's samples. This module computes statistics of each hop and
axis, which show the sensor's health.

The statistics are counts and comparisons of single samples, without smoothing. Examples are runs of
equal values, the largest value, and the number of samples with the largest value. In live
operation, a hop is computed when it is over. In replay, many hops are computed together. Live
operation and replay use `hop_rows`, so the results are bit-equal.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, Index
from imucald.motion.ticks import TICK_S

HOP_TICKS = 5
"""Number of ticks of a hop: half a second. Three hops are then over within two seconds of a
fault."""
HOP_S = HOP_TICKS * TICK_S

SIDES = 2
"""Number of extremes of each axis that are watched: the largest and the smallest value."""


class Carry(Struct):
    """State that one hop (half a second) passes to the next hop. Each array has one entry per axis.

    last: the last sample; NaN before the first sample. run: number of equal samples up to the last
    sample. step: smallest change from sample to sample so far.
    """

    last: Array
    run: Index
    step: Array

    @classmethod
    def none(cls, axes: int) -> Carry:
        """Return the state before the first sample."""
        return cls(
            np.full(axes, math.nan),
            np.zeros(axes, np.int64),
            np.full(axes, math.inf),
        )

    def restart(self) -> None:
        """Restart after a jump of time: no run of equal values continues across the jump."""
        self.last[:] = math.nan
        self.run[:] = 0


class HopRows(Struct, frozen=True):
    """Statistics of H hops. Shapes: count (H,), top and on_top (2, axes, H), others (axes, H).

    mean: mean of the samples. level: mean size of the change from sample to sample. step: smallest
    change so far. ended: number of runs of equal values that ended in the hop (half a second).
    longest: length of the longest of these runs. run: number of equal samples up to the hop's end.
    top: the hop's largest value, and the largest of the negated values. on_top: number of samples
    with the value of `top`. samples: (axes, N) the samples; hop h has the samples from edges[h] to
    edges[h + 1].
    before: (axes,) the sample before the first hop; NaN if there is none.
    """

    count: Index
    mean: Array
    level: Array
    step: Array
    ended: Index
    longest: Index
    run: Index
    top: Array
    on_top: Index
    samples: Array
    edges: Index
    before: Array

    def previous(self, k: int) -> Array:
        """Return the sample before sample k (axes,); NaN if there is none."""
        return self.samples[:, k - 1] if k else self.before


class AxisHops:
    """Statistics of the hops of one axis, as lists by hop (half a second).

    level, step: as in `HopRows`. entry: size of the change at which the run at the end of the hop
    began, valid only for a run that began in the same hop. tops, on_tops: `top` and `on_top` of
    `HopRows`, first of the upper side, then of the lower side. counts: count, ended, longest and
    run of each hop. runs: for each hop, the number of runs of equal values in motion that ended
    before the hop, and the length of the longest of these runs; the caller appends an entry for
    each hop.
    """

    def __init__(self, axis: int, rows: HopRows) -> None:
        self.axis, self.rows = axis, rows
        self.runs: list[tuple[int, int]] = []
        self.level: list[float] = rows.level[axis].tolist()
        self.step: list[float] = rows.step[axis].tolist()
        self.tops: list[list[float]] = rows.top[:, axis].tolist()
        self.on_tops: list[list[int]] = rows.on_top[:, axis].tolist()
        counts = rows.count, rows.ended[axis], rows.longest[axis], rows.run[axis]
        self.counts = list(zip(*(x.tolist() for x in counts), strict=True))
        x = rows.samples[axis]
        at = np.minimum(np.maximum(rows.edges[1:] - rows.run[axis], 0), len(x) - 1)
        earlier = np.where(at > 0, x[at - 1], rows.before[axis])
        self.entry: list[float] = np.abs(x[at] - earlier).tolist()

    def samples(self, h: int) -> Array:
        """Return the samples of hop h (half a second), (N,)."""
        return self.rows.samples[self.axis, self.rows.edges[h] : self.rows.edges[h + 1]]

    def previous(self, h: int) -> float:
        """Return the sample before hop h (half a second); NaN if there is none."""
        return float(self.rows.previous(self.rows.edges[h])[self.axis])


def hop_rows(values: Array, hop: Index, hops: int, carry: Carry) -> HopRows:
    """Return the statistics of hops 0 .. hops-1, and update `carry` to the end of the last hop
    (half a second).

    values: (N, axes) samples, N > 0. hop: (N,) hop number of each sample, in ascending order.
    """
    edges = np.searchsorted(hop, np.arange(hops + 1))
    v, count = np.ascontiguousarray(values.T), np.diff(edges)
    shape, per = (len(v), hops), np.maximum(count, 1)
    some = np.flatnonzero(count)
    mean, level, step = np.empty((3, *shape))
    ended, longest, run = np.zeros((3, *shape), np.int64)
    top, on_top = np.full((SIDES, *shape), -math.inf), np.zeros((SIDES, *shape), np.int64)
    before = carry.last
    for axis, x in enumerate(v):
        change = np.abs(np.diff(x, prepend=before[axis]))  # NaN before the first of all
        size = np.where(change > 0.0, change, 0.0)
        mean[axis] = np.bincount(hop, x, hops) / per
        level[axis] = np.bincount(hop, size, hops) / per
        least = np.minimum.accumulate(np.where(size > 0.0, size, math.inf))
        step[axis] = np.minimum(np.append(math.inf, least)[edges[1:]], carry.step[axis])
        new = np.flatnonzero(change != 0.0)
        ended[axis] = np.bincount(hop[new], minlength=hops)
        begun = np.append(-carry.run[axis], new)
        np.maximum.at(longest[axis], hop[new], np.diff(begun))
        run[axis] = edges[1:] - begun[np.searchsorted(new, edges[1:])]
        for side, sided in enumerate((x, -x)):
            top[side, axis, some] = np.maximum.reduceat(sided, edges[some])
            on_top[side, axis] = np.bincount(hop[sided == top[side, axis, hop]], minlength=hops)
    carry.last, carry.run, carry.step = v[:, -1].copy(), run[:, -1].copy(), step[:, -1].copy()
    return HopRows(count, mean, level, step, ended, longest, run, top, on_top, v, edges, before)
