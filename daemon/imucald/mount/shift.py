"""Has the sensor moved? New evidence against what was known before it.

Evidence comes in road segments of about 26 s of driving. For every source of evidence about an
angle and for the last 2, 3, ... 12 segments, a change of the angle that begins with them is fitted
beside the angle and the nuisance of all segments (a generalised likelihood ratio test for a step
of unknown time and size; Basseville and Nikiforov, Detection of Abrupt Changes, 1993, ch. 2.4).
The spread from segment to segment before sets the scale, so that rough roads and hills make the
test dull and not nervous.

How far the sources of an angle speak for one and the same change is then the ratio of
likelihoods with and without it. In yaw, wind and rough roads move what dv/dt says alone, and
lever arm and sideslip what turns say alone, now and then by far: tails are heavy there, so that
one source must stand out very far while two that agree need not. In roll and pitch, roads that
lean in a bend show in all sources, but make no step in gravity (`step`): such a step at the time
of the change is independent evidence, and is added.
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
"""Road segments that are held against all before."""
MIN_BEFORE = (16, 10, 14)
"""Segments that must have been before, for roll, pitch and yaw."""
CLIP = 4.5
"""No single segment counts for more standard deviations: one bad road moves no sensor."""
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
"""What a source says differs by that much [rad] between town and motorway, without a shift."""
TAILS = np.array((1e6, 1e6, 8.0))
"""Degrees of freedom of Student's t, for roll, pitch and yaw; many are as good as normal."""
LEAST_SIZES = np.array((0.026, 0.026, 0.013))
"""A change that is tested against none is at least that large [rad]: 1.5, 1.5 and 0.75 deg."""
STEP_MIN, STEP_MAX = 2.0, 5.5
"""A step in gravity counts from so many standard deviations on, and for so many at most, ..."""
STEP_FROM = 2.5
"""... and where the road segments alone come to so much."""
NO_STEP = 1.15
"""Without a step, thresholds for roll and pitch are so much higher."""
WITHOUT_STEP = np.array((NO_STEP, NO_STEP, 1.0))
THRESHOLD = np.array(
    (
        (6.5, 6.5, 6.5, 6.5, 6.1, 6.1, 6.1, 6.1, 6.1, 6.1, 6.1),
        (5.0, 5.0, 5.0, 5.0, 4.8, 4.8, 4.8, 4.8, 4.8, 4.8, 4.8),
        (3.45, 3.38, 3.22, 3.12, 3.0, 2.9, 2.77, 2.72, 2.65, 2.6, 2.56),
    )
)
"""For roll, pitch and yaw, and each span, as a root of twice the log of the ratio;
records/mount-accuracy.md: what they give. Over short spans a windy stretch or a winding one passes
for a turn."""
NEIGHBOURS = 0.9
"""In yaw two neighbouring spans that come to this share of their thresholds are a shift as well."""
OTHER_ROADS = 1.15
"""Thresholds are so much higher where it takes segments of earlier drives to test at all."""
MIN_KNOWN = 1e-6
"""New segments that know less of the angle than this share say nothing."""
PRIOR_SEGMENTS, PRIOR_SPREAD, MIN_SPREAD = 6.0, 1.0, 0.8
"""The spread before is taken as the model's with that weight, and as no less than that share."""
YAW = 2
LEAST = 1e-12
"""No sum that others are divided by is smaller."""
NO_STEPS: Array = np.zeros((len(SPANS), 2, 2))
"""No step in gravity; see `largest_change`."""


class Shift(Struct, frozen=True):
    """The largest change found: axis, size [rad], in standard deviations, segments ago.

    deviations: the root of twice the log of the ratio of likelihoods, signed; of one normal
    source it would be the size in standard deviations. excess: over the threshold; a shift from
    1 on.
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
    """Return the change of an angle that stands out most; None where too little is known.

    steps: (S, 2, 2), how far a step in gravity stood out when the segments of each span began, in
    roll and pitch: the largest and the least, signed, in standard deviations.
    unevenness: how many times the usual one roads have, across and along.
    fresh: segments of this drive, where series begin with those of earlier ones; no span is longer.
    """
    of_axes = [one for one in series if one.axis in axes]
    found = [(axis, *_columns_of(of_axes, axis, fresh)) for axis in axes]
    asked = [(axis, columns, n) for axis, columns, n in found if columns and n]
    if not asked:
        return None
    most = max(n for _, _, n in asked)
    spans, steps = SPANS[:most], steps[:most]
    every, variances_of = changes(of_axes, spans)
    # of all axes at once; what one has fewer sources than another says nothing
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
    """Which series are about an axis, and how many of `SPANS` they are long enough for."""
    columns = [k for k, one in enumerate(series) if one.axis == axis]
    longest = max((len(series[k].score) for k in columns), default=0) - MIN_BEFORE[axis]
    if fresh is not None:
        longest = min(longest, fresh)
    return columns, min(max(longest - FIRST_SPAN + 1, 0), len(SPANS))


def _with_neighbours(over: Array) -> Array:
    """Signed excesses (S,): of each span its own, or its scaled mean with the next if larger."""
    pairs = 0.5 * (over[:-1] + over[1:]) / NEIGHBOURS
    out = over.copy()
    out[:-1] = np.where(np.abs(pairs) > np.abs(over[:-1]), pairs, over[:-1])
    return out


def changes(series: list[ScoreSeries], spans: NDArray[np.int64]) -> tuple[Array, Array]:
    """Changes over the last spans: what each source says (S, sources) [rad], and variances.

    To each source are fitted a level before the change, a nuisance and the change.
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
    """With what roads make sources differ by; of sources that see the same noise the better one."""
    variances = variances + np.array([(times * UNEVEN_STD[one.kind]) ** 2 for one in series])
    same_noise = [k for k, one in enumerate(series) if one.kind in SAME_NOISE]
    if len(same_noise) == 2:
        worse = np.where(variances[:, same_noise[0]] > variances[:, same_noise[1]], *same_noise)
        variances[np.arange(len(variances)), worse] = np.inf
    return variances


def _most_likely_time(
    sizes: Array, variances: Array, spans: NDArray[np.int64], sign: float
) -> tuple[int, float]:
    """Segments since a change that is there, and its size: the largest likelihood of all spans."""
    known = np.maximum((1.0 / variances).sum(axis=1), 1e-9)
    mean = (sizes / variances).sum(axis=1) / known
    k = int(np.argmax(np.where(mean * sign > 0.0, mean * mean * known, 0.0)))
    return int(spans[k]), float(mean[k])


@cache
def _subsets(n: int) -> Array:
    """Which of n sources is in which subset that is not empty (n, 2^n - 1)."""
    return ((np.arange(1, 2**n) >> np.arange(n)[:, None]) & 1).astype(np.float64)


def likeliest(sizes: Array, variances: Array, tail: Array, least: Array) -> tuple[Array, Array]:
    """The change that all sources speak for most, of A axes: size (A, S), and the root of twice the
    log of L(size) / L(0) (A, S).

    sizes, variances: (A, S, sources), of what each source says. tail (A,): degrees of freedom of
    Student's t. least (A,): changes below are not looked for. The maximum is sought among the
    weighted means of all subsets of sources, near which it is wherever some sources agree.
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
    """What steps in gravity (S, 2) add to changes (S,) of the same sign [standard deviations]."""
    step = np.where(size > 0.0, steps[:, 0], -steps[:, 1])
    counts = (ratio >= STEP_FROM) & (step >= STEP_MIN)
    return np.where(counts, np.minimum(step, STEP_MAX), 0.0)


def _changes_of(fits: list[AngleFit], spans: NDArray[np.int64]) -> tuple[Array, Array]:
    """Changes of K sources, of as many segments each, over their last spans (S,).

    Returns sizes [rad] and informations (K, S). With M the information of angle and nuisance from
    all segments, w what the new segments have of its first row and U their scores left over by the
    common fit, the change is U / V with V = w_0 - w' M^-1 w (the score test of a linear model;
    exact). What new segments say of the angle is not used where it cannot be separated from
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
    """Sums (K, S) of figures (K, G) over the old segments of each span (S, G)."""
    return np.asarray((old * of[:, None]).sum(axis=2))
