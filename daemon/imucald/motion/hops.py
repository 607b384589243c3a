"""Hops: what half a second of one sensor's samples comes to, axis by axis; for its health.

Everything here is counted or compared, sample by sample, and nothing is smoothed: a run of equal
values, the largest value and how often it came. Live a hop is worked out when it is over, in
replay many at once; both go through `hop_rows`, so they give the same bits. A live
hop holds some tens of samples: counted one by one they take a quarter of what columns take.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core import compiled
from imucald.core.arrays import Array
from imucald.motion.ticks import TICK_S

Index = NDArray[np.int64]

HOP_TICKS = 5
"""Ticks of a hop: half a second, so that three are over before a fault is two seconds old."""
HOP_S = HOP_TICKS * TICK_S

SIDES = 2
"""Of each axis the upper and the lower extreme are watched."""


class Carry(Struct):
    """What the next hop has to know of those before; arrays by axis.

    last: the last sample, NaN before the first. run: how many samples in a row have been equal to
    it. step: the smallest change so far.
    """

    last: Array
    run: Index
    step: Array

    @classmethod
    def none(cls, axes: int) -> Carry:
        """Before the first sample."""
        return cls(
            np.full(axes, math.nan),
            np.zeros(axes, np.int64),
            np.full(axes, math.inf),
        )

    def restart(self) -> None:
        """Time jumped: no run goes across."""
        self.last[:] = math.nan
        self.run[:] = 0


class HopRows(Struct, frozen=True):
    """Figures of H hops: count (H,), the others (H, axes), of extremes (H, 2, axes).

    mean: of the samples. level: mean size of the change from sample to sample. step: smallest
    change so far. ended: runs of equal values that ended. longest: of those the longest. run:
    samples up to the hop's end that are equal. top: the hop's largest value, and the largest of
    the negated ones; on_top: samples on it. samples: (axes, N), the samples themselves, those of
    hop h from edges[h] to edges[h + 1]; before: (axes,), the one before the first, NaN if none.
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
        """(axes,) the sample before sample k, NaN if none."""
        return self.samples[:, k - 1] if k else self.before

    def entries(self) -> Array:
        """Size of the change with which the run at each hop's end began (H, axes).

        Of runs that began in their hop; of others it is no number to use.
        """
        axes = np.arange(len(self.before))
        at = np.minimum(np.maximum(self.edges[1:, None] - self.run, 0), self.samples.shape[1] - 1)
        earlier = np.where(at > 0, self.samples[axes, at - 1], self.before)
        return np.asarray(np.abs(self.samples[axes, at] - earlier))


def hop_rows(values: Array, hop: Index, hops: int, carry: Carry) -> HopRows:
    """Return the figures of hops 0 .. hops-1, and bring `carry` up to their end.

    values: (N, axes) samples. hop: (N,) the hop of each, never decreasing.
    """
    n, axes = values.shape
    edges = np.searchsorted(hop, np.arange(hops + 1))
    count = np.diff(edges)
    v = np.ascontiguousarray(values.T)
    if compiled.kernels is not None:
        return _by_kernel(compiled.kernels, v, edges, count, carry)
    # All axes in one long column, axis after axis: one call of each function instead of three.
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
    first = np.arange(axes)[:, None] * n
    begun = np.searchsorted(starts, (first + edges).ravel()).reshape(axes, -1)  # before each edge
    step = _steps(size.reshape(axes, n), edges, count, carry)
    top, on_top = _extremes(v, edges, count, cell)
    run = _runs(starts, begun[:, 1:], first, edges, carry)
    ended = np.diff(begun)
    longest = _longest(starts, begun[:, :-1], ended, first, carry)
    before = carry.last
    carry.last = v[:, -1].copy()
    carry.run, carry.step = run[:, -1].copy(), step[:, -1].copy()
    by_axis = mean, level, step, ended, longest, run
    return _rows(v, edges, count, before, by_axis, (top, on_top))


def _by_kernel(
    kernels: compiled.Kernels, v: Array, edges: Index, count: Index, carry: Carry
) -> HopRows:
    """As `hop_rows`; v: samples (axes, N), those of hop h from edges[h] on."""
    shape = len(v), len(count)
    mean, level, step = np.empty((3, *shape))
    ended, longest, run = np.empty((3, *shape), np.int64)
    top, on_top = np.empty((SIDES, *shape)), np.empty((SIDES, *shape), np.int64)
    before = carry.last
    carry.last, carry.run, carry.step = before.copy(), carry.run.copy(), carry.step.copy()
    kernels.hop_figures(
        v, edges, carry.last, carry.run, carry.step, mean, level, step, ended, longest, run, top,
        on_top,
    )  # fmt: skip
    by_axis = mean, level, step, ended, longest, run
    return _rows(v, edges, count, before, by_axis, (top, on_top))


def _rows(
    v: Array,
    edges: Index,
    count: Index,
    before: Array,
    by_axis: tuple[NDArray[Any], ...],
    tops: tuple[NDArray[Any], ...],
) -> HopRows:
    """Figures by axis (axes, H), and tops (sides, axes, H), as rows of hops."""
    mean, level, step, ended, longest, run = (figure.T for figure in by_axis)
    top, on_top = (np.moveaxis(figure, -1, 0) for figure in tops)
    return HopRows(
        count=count,
        mean=mean,
        level=level,
        step=step,
        ended=ended,
        longest=longest,
        run=run,
        top=top,
        on_top=on_top,
        samples=v,
        edges=edges,
        before=before,
    )


def _steps(size: Array, edges: Index, count: Index, carry: Carry) -> Array:
    """Smallest change so far (axes, H), from the sizes of changes (axes, N), 0 for none."""
    some = count > 0
    least = np.full((len(size), len(count)), math.inf)
    changes = np.where(size > 0.0, size, math.inf)
    least[:, some] = np.minimum.reduceat(changes, edges[:-1][some], axis=1)
    least[:, 0] = np.minimum(least[:, 0], carry.step)
    return np.minimum.accumulate(least, axis=1)


def _extremes(v: Array, edges: Index, count: Index, cell: Index) -> tuple[Array, Index]:
    """Largest values of each hop, and how many samples are on them (2, axes, H).

    cell: (axes * N,) of each sample its axis and hop, as one number.
    """
    some = count > 0
    top = np.full((SIDES, len(v), len(count)), -math.inf)
    at = edges[:-1][some]
    top[0][:, some] = np.maximum.reduceat(v, at, axis=1)
    top[1][:, some] = -np.minimum.reduceat(v, at, axis=1)
    on_top = np.empty(top.shape, np.int64)
    for side, ends in enumerate((top[0], -top[1])):
        on = np.flatnonzero(v == np.repeat(ends, count, axis=1))
        on_top[side] = np.bincount(cell[on], minlength=ends.size).reshape(ends.shape)
    return top, on_top


def _runs(starts: Index, begun: Index, first: Index, edges: Index, carry: Carry) -> Index:
    """Equal samples up to each hop's end (axes, H); begun: runs that have begun by then.

    first: (axes, 1) where each axis begins.
    """
    ends = first + edges[1:]
    latest = starts[np.maximum(begun - 1, 0)] if len(starts) else np.full(ends.shape, -1)
    own = (begun > 0) & (latest >= first)
    return np.asarray(np.where(own, ends - latest, ends - first + carry.run[:, None]))


def _longest(starts: Index, begun: Index, ended: Index, first: Index, carry: Carry) -> Index:
    """Longest run that ended in each hop (axes, H); begun: runs that began before it."""
    out = np.zeros(ended.shape, np.int64)
    if not len(starts):
        return out
    length = np.diff(starts, prepend=0)
    some = ended > 0
    has = some.any(axis=1)  # its first run that ends may have begun before
    earliest = begun[has, 0]
    length[earliest] = starts[earliest] - first[has, 0] + carry.run[has]
    out[some] = np.maximum.reduceat(length, begun[some])
    return out


Sample = Sequence[float]


def single_hop(values: Sequence[Sample], carry: Carry) -> HopRows:
    """Return the figures of a hop, and bring `carry` up to its end.

    values: its samples, at least one, each of as many axes as `carry` has, or more.
    """
    n, before = len(carry.last), carry.last
    columns = [[one[i] for one in values] for i in range(n)]
    lasts = zip(before.tolist(), carry.run.tolist(), carry.step.tolist(), strict=True)
    counted = [_counted(column, *last) for column, last in zip(columns, lasts, strict=True)]
    totals, levels, steps, ended, longest, runs = zip(*counted, strict=True)
    high, low = [max(column) for column in columns], [min(column) for column in columns]
    on_top = [
        [column.count(x) for column, x in zip(columns, ends, strict=True)] for ends in (high, low)
    ]
    samples = np.array(columns)
    carry.last = samples[:, -1].copy()
    carry.run, carry.step = np.array(runs), np.array(steps)
    count = len(values)
    return HopRows(
        count=np.array([count]),
        mean=np.array([[total / count for total in totals]]),
        level=np.array([[level / count for level in levels]]),
        step=np.array([steps]),
        ended=np.array([ended]),
        longest=np.array([longest]),
        run=np.array([runs]),
        top=np.array([[high, [-x for x in low]]]),
        on_top=np.array([on_top]),
        samples=samples,
        edges=np.array([0, count]),
        before=before,
    )


def _counted(
    column: list[float], last: float, run: int, step: float
) -> tuple[float, float, float, int, int, int]:
    """Sum, sum of changes, smallest change so far, runs that ended, longest of them, open run.

    last, run, step: of the axis, as in `Carry`.
    """
    total = level = 0.0
    ended = longest = 0
    for x in column:
        total += x
        if x == last:
            run += 1
            continue
        change = abs(x - last)
        if change > 0.0:  # NaN before the first of all
            level += change
            step = min(step, change)
        ended += 1
        longest = max(longest, run)
        run, last = 1, x
    return total, level, step, ended, longest, run
