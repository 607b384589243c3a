"""Reduce the number of points of long series for drawing, without a visible difference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.core.arrays import Array


@dataclass(frozen=True)
class Envelope:
    """Lowest, highest and mean value of a series in each of B equal segments of time; (B,), NaN for
    an empty segment."""

    t: Array
    low: Array
    high: Array
    mean: Array


def envelope(t: Array, x: Array, bins: int) -> Envelope:
    """Return the envelope of x (N,) over t (N,). t must not decrease. Values that are not finite
    are left out. bins: number of segments."""
    known = np.isfinite(x) & np.isfinite(t)
    start, stop = _span(t)
    edges = np.linspace(start, stop, bins + 1)
    middle = 0.5 * (edges[1:] + edges[:-1])
    low, high, mean = (np.full(bins, np.nan) for _ in range(3))
    if not known.any():
        return Envelope(middle, low, high, mean)
    place = np.clip(((t[known] - start) / (stop - start) * bins).astype(np.int64), 0, bins - 1)
    order = np.argsort(place, kind="stable")
    place, values = place[order], x[known][order]
    filled, first, count = np.unique(place, return_index=True, return_counts=True)
    low[filled] = np.minimum.reduceat(values, first)
    high[filled] = np.maximum.reduceat(values, first)
    mean[filled] = np.add.reduceat(values, first) / count
    return Envelope(middle, low, high, mean)


def _span(t: Array) -> tuple[float, float]:
    known = t[np.isfinite(t)]
    if not len(known):
        return 0.0, 1.0
    start, stop = float(known.min()), float(known.max())
    return start, stop if stop > start else start + 1.0


@dataclass(frozen=True)
class Trend:
    """Mean and spread (16th and 84th percentile) of y in B bins of x; (B,). Bins with too few rows
    are left out."""

    x: Array
    mean: Array
    low: Array
    high: Array


def trend(x: Array, y: Array, bins: int, least: int) -> Trend:
    """Return y as a function of x, in equal bins from the 0.5th to the 99.5th percentile of x.

    least: smallest number of rows of a bin.
    """
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if len(x) < least:
        return Trend(*(np.zeros(0) for _ in range(4)))
    start, stop = np.percentile(x, [0.5, 99.5])
    if stop <= start:
        start, stop = _span(x)
    place = np.floor((x - start) / (stop - start) * bins).astype(np.int64)
    rows = []
    for i in range(bins):
        inside = y[place == i]
        if len(inside) >= least:
            middle = start + (i + 0.5) * (stop - start) / bins
            rows.append((middle, inside.mean(), *np.percentile(inside, [16.0, 84.0])))
    table = np.array(rows).reshape(len(rows), 4)
    return Trend(table[:, 0], table[:, 1], table[:, 2], table[:, 3])


def log_bins(frequency: Array, density: Array, bins: int) -> tuple[Array, Array]:
    """Return the means of a spectrum in logarithmic bins of frequency. Values that are not positive
    are left out."""
    known = (frequency > 0.0) & np.isfinite(density) & (density > 0.0)
    f, s = frequency[known], density[known]
    if len(f) <= bins:
        return f, s
    place = np.floor(np.log(f / f[0]) / np.log(f[-1] / f[0]) * bins * (1.0 - 1e-12))
    _, first, count = np.unique(place, return_index=True, return_counts=True)
    return np.add.reduceat(f, first) / count, np.add.reduceat(s, first) / count


def clearest_segment(t: Array, before: Array, after: Array, seconds: float) -> slice:
    """Return the rows of the segment of `seconds` in which the residual is reduced most from
    `before` to `after`. If the residual is not reduced in total, return the segment with the
    largest residual."""
    squares = np.nan_to_num(before) ** 2
    fall = squares - np.nan_to_num(after) ** 2
    worth = fall if fall.sum() > 0.0 else squares
    return richest_segment(t, worth, seconds)


def richest_segment(t: Array, worth: Array, seconds: float) -> slice:
    """Return the rows of the segment of `seconds` with the largest sum of `worth` (N,)."""
    sums = np.concatenate([[0.0], np.cumsum(worth)])
    stop = np.searchsorted(t, t + seconds, side="right")
    first = int(np.argmax(sums[stop] - sums[:-1])) if len(t) else 0
    return slice(first, int(stop[first]) if len(t) else 0)
