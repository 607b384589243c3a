"""Detect whether the sensor has moved. New evidence is compared with earlier evidence.

Evidence comes in road segments of about 26 s of driving. Each source of evidence about an angle and
each number of last segments, 2, 3, ... 12, is tested. A change of the angle that begins with these
segments is fitted together with the angle and the nuisance of all segments (a generalised
likelihood ratio test for a step of unknown time and size; Basseville and Nikiforov, Detection of
Abrupt Changes, 1993, ch. 2.4). The spread between earlier segments sets the scale: on rough roads
and hills the test becomes less sensitive and does not raise false alarms.

The ratio of the likelihoods with and without the change shows how far the sources of an angle agree
on one change. In yaw, wind and rough roads disturb only the evidence from dv/dt, while lever arm
and sideslip disturb only the evidence from turns, both now and then by much. The tails are
therefore heavy: one source alone needs a very large change, while two sources that agree need a
smaller one. In roll and pitch, the lean of a road in bends shows in all sources, but causes no step
in gravity (`step`). Such a step at the time of the change is therefore independent evidence, and is
added.
"""

from __future__ import annotations

import math
from functools import cache

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.arrays import Array, summed_in_order
from imucald.mount.evidence_rows import MAX_REGRESSORS, SAME_NOISE
from imucald.mount.road_segments import AngleFit, ScoreSeries

FIRST_SPAN = 2
SPANS = np.arange(FIRST_SPAN, 13)
"""Numbers of last road segments that are compared with all earlier ones."""
MIN_BEFORE = (16, 10, 14)
"""Smallest number of earlier segments for roll, pitch and yaw."""
CLIP = 4.5
"""Largest number of standard deviations of one segment: one bad road is no move of the sensor."""
UNEVEN_STD = {
    "roll_turn": 0.007,
    "roll_axis": 0.007,
    "roll_gravity": 0.0026,
    "pitch_dvdt": 0.0017,
    "pitch_axis": 0.007,
    "pitch_gravity": 0.014,
    "yaw_turn": 0.0017,
    "yaw_dvdt": 0.0035,
}
"""Difference of a source between town and motorway without a shift [rad]."""
TAILS = np.array((1e6, 1e6, 8.0))
"""Degrees of freedom of Student's t, for roll, pitch and yaw; a large number is nearly normal."""
LEAST_SIZES = np.array((0.026, 0.026, 0.013))
"""Smallest change that is tested [rad]: 1.5, 1.5 and 0.75 deg."""
STEP_MIN, STEP_MAX = 2.0, 5.5
"""Number of standard deviations from which a step in gravity counts, and the largest number that
counts."""
STEP_FROM = 2.5
"""Number of standard deviations that the road segments alone must reach for a step to count."""
NO_STEP = 1.15
"""Factor on the thresholds for roll and pitch without a step."""
WITHOUT_STEP = np.array((NO_STEP, NO_STEP, 1.0))
THRESHOLD = np.array(
    (
        (6.5, 6.5, 6.5, 6.5, 6.1, 6.1, 6.1, 6.1, 6.1, 6.1, 6.1),
        (5.0, 5.0, 5.0, 5.0, 4.8, 4.8, 4.8, 4.8, 4.8, 4.8, 4.8),
        (3.45, 3.38, 3.22, 3.12, 3.0, 2.9, 2.77, 2.72, 2.65, 2.6, 2.56),
    )
)
"""Thresholds for roll, pitch and yaw, and each span, as a root of twice the log of the ratio.
records/mount-accuracy.md gives their results. Over short spans a windy or winding stretch looks
like a rotation.
"""
NEIGHBOURS = 0.9
"""In yaw, two neighbouring spans that reach this share of their thresholds are also a shift."""
OTHER_ROADS = 1.15
"""Factor on the thresholds where the test needs segments of earlier drives."""
MIN_KNOWN = 1e-6
"""New segments with less than this share of the information are ignored."""
PRIOR_SEGMENTS, PRIOR_SPREAD, MIN_SPREAD = 6.0, 1.0, 0.8
"""Prior of the spread: its weight in segments, its value relative to the model, and the smallest
spread.
"""
YAW = 2
LEAST = 1e-12
"""Smallest value of a sum that is used as a divisor."""
NO_STEPS: Array = np.zeros((len(SPANS), 2, 2))
"""No step in gravity; see `largest_change`."""


class Shift(Struct, frozen=True):
    """The largest change found: axis, size [rad], size in standard deviations, age in segments.

    deviations: the root of twice the log of the ratio of likelihoods, signed. For one normal source
    it would be the size in standard deviations. excess: ratio to the threshold; a shift from 1 on.
    """

    axis: int
    size: float
    deviations: float
    segments: int
    excess: float


def largest_change(
    series: list[ScoreSeries],
    axes: tuple[int, ...] = (0, 1, 2),
    steps: Array = NO_STEPS,
    unevenness: tuple[float, float] = (1.0, 1.0),
    fresh: int | None = None,
) -> Shift | None:
    """Return the most significant change of an angle; None if too little is known.

    steps: (S, 2, 2) size of a step in gravity at the beginning of each span, in roll and pitch: the
    largest and the smallest, signed, in standard deviations. unevenness: ratio of the roads'
    unevenness to the usual one, across and along. fresh: number of segments of this drive, if
    series begin with those of earlier drives; no span is longer.
    """
    of_axes = [one for one in series if one.axis in axes]
    found = [(axis, *_columns_of(of_axes, axis, fresh)) for axis in axes]
    asked = [(axis, columns, n) for axis, columns, n in found if columns and n]
    if not asked:
        return None
    most = max(n for _, _, n in asked)
    spans, steps = SPANS[:most], steps[:most]
    every, variances_of = changes(of_axes, spans)
    # All axes are tested together. A missing source has infinite variance.
    shape = len(asked), most, max(len(columns) for _, columns, _ in asked)
    sizes, variances = np.zeros(shape), np.full(shape, np.inf)
    for a, (axis, columns, _) in enumerate(asked):
        own, mine = slice(len(columns)), [of_axes[k] for k in columns]
        sizes[a, :, own] = every[:, columns]
        times = (*unevenness, 1.0)[axis]
        variances[a, :, own] = _uneven(mine, variances_of[:, columns], times)
    of = np.array([axis for axis, _, _ in asked])
    size, ratio = likeliest(sizes, variances, TAILS[of], LEAST_SIZES[of])
    step = np.zeros(ratio.shape)
    for a, axis in enumerate(of.tolist()):
        if axis != YAW:
            step[a] = _step_for(ratio[a], size[a], steps[:, axis])
    ratio = np.hypot(ratio, step)
    threshold = THRESHOLD[of, :most] * np.where(step > 0.0, 1.0, WITHOUT_STEP[of][:, None])
    if fresh is not None:
        before = np.array(MIN_BEFORE)[of][:, None]
        threshold = threshold * np.where(fresh - spans < before, OTHER_ROADS, 1.0)
    over = np.copysign(ratio / threshold, size)
    best: tuple[float, int, int] | None = None
    for a, (axis, _, n) in enumerate(asked):
        excess = np.abs(_with_neighbours(over[a, :n]) if axis == YAW else over[a, :n])
        k = int(excess.argmax())
        if best is None or excess[k] > best[0]:
            best = float(excess[k]), a, k
    assert best is not None
    excess_of_best, a, k = best
    axis, columns, n = asked[a]
    deviations = math.copysign(float(ratio[a, k]), size[a, k])
    own = slice(len(columns))
    seen = sizes[a, :n, own], variances[a, :n, own]
    segments, mean = _most_likely_time(*seen, spans[:n], deviations)
    return Shift(axis, mean, deviations, segments, excess_of_best)


def _columns_of(series: list[ScoreSeries], axis: int, fresh: int | None) -> tuple[list[int], int]:
    """Return the places of the series about an axis, and the number of `SPANS` for which they are
    long enough.
    """
    columns = [k for k, one in enumerate(series) if one.axis == axis]
    longest = max((len(series[k].score) for k in columns), default=0) - MIN_BEFORE[axis]
    if fresh is not None:
        longest = min(longest, fresh)
    return columns, min(max(longest - FIRST_SPAN + 1, 0), len(SPANS))


def _with_neighbours(over: Array) -> Array:
    """Return signed excesses (S,): each span's own, or its scaled mean with the next span's if
    larger.
    """
    pairs = 0.5 * (over[:-1] + over[1:]) / NEIGHBOURS
    out = over.copy()
    out[:-1] = np.where(np.abs(pairs) > np.abs(over[:-1]), pairs, over[:-1])
    return out


def changes(series: list[ScoreSeries], spans: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the change of each source over each of the last S spans, (S, sources) [rad], and the
    variances of these changes.

    A level before the change, a nuisance and the change are fitted to each source.
    """
    shape = len(spans), len(series)
    sizes, variances = np.zeros(shape), np.full(shape, np.inf)
    by_length: dict[int, list[tuple[int, AngleFit]]] = {}
    for k, one in enumerate(series):
        fit = one.fitted() if len(one.score) > spans[0] else None
        if fit is not None:
            by_length.setdefault(len(fit.left), []).append((k, fit))
    for group in by_length.values():
        columns = [k for k, _ in group]
        size, known = _changes_of([fit for _, fit in group], spans)
        sizes[:, columns] = size.T
        informed = known > 0.0
        variance = np.where(informed, 1.0 / np.where(informed, known, 1.0), np.inf)
        variances[:, columns] = variance.T
    return sizes, variances


def _uneven(series: list[ScoreSeries], variances: Array, times: float) -> Array:
    """Add the differences between sources that roads cause to the variances. Of sources with the
    same noise, only the better one counts.
    """
    variances = variances + np.array([(times * UNEVEN_STD[one.kind]) ** 2 for one in series])
    same_noise = [k for k, one in enumerate(series) if one.kind in SAME_NOISE]
    if len(same_noise) == 2:
        worse = np.where(variances[:, same_noise[0]] > variances[:, same_noise[1]], *same_noise)
        variances[np.arange(len(variances)), worse] = np.inf
    return variances


def _most_likely_time(
    sizes: Array, variances: Array, spans: NDArray[np.int64], sign: float
) -> tuple[int, float]:
    """Return the number of segments since a change, and its size: the largest likelihood of all
    spans.
    """
    known = np.maximum((1.0 / variances).sum(axis=1), 1e-9)
    mean = (sizes / variances).sum(axis=1) / known
    k = int(np.argmax(np.where(mean * sign > 0.0, mean * mean * known, 0.0)))
    return int(spans[k]), float(mean[k])


@cache
def _subsets(n: int) -> Array:
    """Return the membership of n sources in each subset that is not empty (n, 2^n - 1)."""
    return ((np.arange(1, 2**n) >> np.arange(n)[:, None]) & 1).astype(np.float64)


def likeliest(sizes: Array, variances: Array, tail: Array, least: Array) -> tuple[Array, Array]:
    """Return the most likely change of A axes, given all sources.

    The result is the size (A, S), and the root of twice the log of L(size) / L(0) (A, S).

    sizes, variances: (A, S, sources), from each source. tail (A,): degrees of freedom of Student's
    t. least (A,): smallest change that is searched. The maximum is searched among the weighted
    means of all subsets of sources. The maximum lies near such a mean wherever some sources agree.
    """
    weight, tail = 1.0 / variances, tail[:, None, None]
    subset = _subsets(sizes.shape[2])
    known = weight @ subset
    some = known > 0.0
    mean = np.where(some, (weight * sizes) @ subset / np.where(some, known, 1.0), 0.0)
    mean = np.sign(mean) * np.maximum(np.abs(mean), least[:, None, None])
    left = sizes[:, :, None] - mean[:, :, :, None]
    gain = np.log1p(sizes * sizes * weight / tail)[:, :, None]
    gain = gain - np.log1p(left * left * weight[:, :, None] / tail[..., None])
    twice = (tail + 1.0) * gain.sum(axis=3)
    best = np.argmax(twice, axis=2)[:, :, None]
    ratio: Array = np.sqrt(np.maximum(np.take_along_axis(twice, best, 2)[:, :, 0], 0.0))
    return np.where(ratio > 0.0, np.take_along_axis(mean, best, 2)[:, :, 0], 0.0), ratio


def _step_for(ratio: Array, size: Array, steps: Array) -> Array:
    """Return the contribution of steps in gravity (S, 2) to changes (S,) of the same sign [standard
    deviations].
    """
    step = np.where(size > 0.0, steps[:, 0], -steps[:, 1])
    counts = (ratio >= STEP_FROM) & (step >= STEP_MIN)
    return np.where(counts, np.minimum(step, STEP_MAX), 0.0)


def _changes_of(fits: list[AngleFit], spans: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the changes of K sources with equally many segments over their last spans (S,).

    Returns sizes [rad] and informations (K, S). Let M be the information of angle and nuisance from
    all segments, w the part of the new segments in its first row, and U their residual scores in
    the common fit. The change is U / V with V = w_0 - w' M^-1 w (the score test of a linear model;
    exact). Evidence of new segments about the angle is not used where it cannot be separated from
    nuisance that only they show. Where a source has fewer regressors than another, the rest are 0.
    """
    left = np.array([fit.left for fit in fits])  # (K, G)
    most = MAX_REGRESSORS
    rows, inverse = np.zeros((*left.shape, most)), np.zeros((len(fits), most, most))
    for k, fit in enumerate(fits):
        own = slice(fit.rows.shape[1])
        rows[k, :, own], inverse[k, own, own] = fit.rows, fit.inverse
    spans = np.minimum(spans, left.shape[1] - 1)
    n = rows[:, :, 0]
    longest = int(spans.max())
    new, backwards = slice(-longest, None), slice(-1, -longest - 1, -1)
    old = (np.arange(n.shape[1]) < (n.shape[1] - spans)[:, None]).astype(np.float64)  # (S, G)
    w = np.cumsum(rows[:, backwards], axis=1)[:, spans - 1]
    turned = summed_in_order(w[:, :, None] * inverse[:, None].swapaxes(2, 3))
    known = w[:, :, 0] - (turned * w).sum(axis=2)
    use = known > MIN_KNOWN * n.sum(axis=1)[:, None]
    known = np.where(use, known, 0.0)
    size = np.cumsum(left[:, backwards], axis=1)[:, spans - 1] / np.where(use, known, 1.0) * use
    # against the fit to the old ones
    fitted = summed_in_order(rows[:, :, None] * inverse[:, None].swapaxes(2, 3))
    alone = left[:, None] + size[:, :, None] * summed_in_order(turned[:, :, None] * rows[:, None])
    expected = np.maximum(n - (fitted * rows).sum(axis=2), 0.0)
    ratio = (old * alone * alone).sum(axis=2) / np.maximum(_sums(old, expected), LEAST)
    segments = _sums(old, n)
    segments = segments * segments / np.maximum(_sums(old, n * n), LEAST)
    scale = (PRIOR_SEGMENTS * PRIOR_SPREAD + segments * np.maximum(ratio, MIN_SPREAD)) / (
        PRIOR_SEGMENTS + segments
    )
    limit = CLIP * np.sqrt(scale[:, :, None] * n[:, None, new])
    clipped = np.minimum(np.maximum(alone[:, :, new], -limit), limit)
    clipped = ((1.0 - old[:, new]) * clipped).sum(axis=2)
    return clipped / np.maximum(w[:, :, 0], LEAST) * use, known / scale


def _sums(old: Array, of: Array) -> Array:
    """Return sums (K, S) of figures (K, G) over the old segments of each span (S, G)."""
    return np.asarray((old * of[:, None]).sum(axis=2))
