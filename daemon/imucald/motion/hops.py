"""A hop is half a second of one sensor's samples. This module computes statistics of each hop and
axis, which show the sensor's health.

The statistics are counts and comparisons of single samples, without smoothing. Examples are runs of
equal values, the largest value, and the number of samples with the largest value. In live
operation, a hop is computed when it is over. In replay, many hops are computed together. Live
operation and replay use `hop_rows`, so the results are bit-equal. The compiled code and
`_count_axis` compute the same numbers.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core import compiled
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
    began, valid only for a run that began in the same hop. tops: `top` of `HopRows`, first of the
    upper side, then of the lower side. counts: count, ended, longest and run of each hop. in_rows:
    top, on_top, step and level as contiguous arrays. runs: for each hop, the number of runs of
    equal values in motion that ended before the hop, and the length of the longest of these runs;
    the caller appends an entry for each hop.
    """

    def __init__(self, axis: int, rows: HopRows) -> None:
        self.axis, self.rows = axis, rows
        self.runs: list[tuple[int, int]] = []
        level, step, top = (
            rows.level[axis],
            rows.step[axis],
            np.ascontiguousarray(rows.top[:, axis]),
        )
        self.in_rows = top, np.ascontiguousarray(rows.on_top[:, axis]), step, level
        self.level: list[float] = level.tolist()
        self.step: list[float] = step.tolist()
        self.tops: list[list[float]] = top.tolist()
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

    values: (N, axes) samples. hop: (N,) hop number of each sample, in ascending order.
    """
    edges = np.searchsorted(hop, np.arange(hops + 1))
    v = np.ascontiguousarray(values.T)
    shape = len(v), hops
    mean, level, step = np.empty((3, *shape))
    ended, longest, run = np.empty((3, *shape), np.int64)
    top, on_top = np.empty((SIDES, *shape)), np.empty((SIDES, *shape), np.int64)
    figures = mean, level, step, ended, longest, run, top, on_top
    before = carry.last
    carry.last, carry.run, carry.step = before.copy(), carry.run.copy(), carry.step.copy()
    if compiled.kernels is not None:
        kernel = compiled.kernels.hop_figures
        kernel(v, edges, carry.last, carry.run, carry.step, *figures)
    else:
        for axis, column in enumerate(v.tolist()):
            _count_axis(column, edges.tolist(), carry, axis, figures)
    return HopRows(np.diff(edges), *figures, v, edges, before)


def _count_axis(
    column: list[float],
    edges: list[int],
    carry: Carry,
    axis: int,
    figures: tuple[NDArray[Any], ...],
) -> None:
    """Fill the statistics of one axis, sample by sample. edges: index of the first sample of each
    hop (half a second)."""
    mean, level, steps, ended, longest, runs, top, on_top = figures
    last, run, step = float(carry.last[axis]), int(carry.run[axis]), float(carry.step[axis])
    for h, (begin, end) in enumerate(pairwise(edges)):
        own = column[begin:end]
        total = changes = 0.0
        over = most = 0
        for x in own:
            total += x
            if x == last:
                run += 1
                continue
            change = abs(x - last)
            if change > 0.0:  # NaN before the first of all
                changes += change
                step = min(step, change)
            over += 1
            most = max(most, run)
            run, last = 1, x
        per = len(own) or 1
        high, low = max(own, default=-math.inf), min(own, default=math.inf)
        mean[axis, h], level[axis, h], steps[axis, h] = total / per, changes / per, step
        ended[axis, h], longest[axis, h], runs[axis, h] = over, most, run
        top[:, axis, h], on_top[:, axis, h] = (high, -low), (own.count(high), own.count(low))
    carry.last[axis], carry.run[axis], carry.step[axis] = last, run, step
