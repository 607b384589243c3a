"""Detect whether the mount creeps.

A soft holder, or tape in the sun, lets the mount turn slowly all the time. If a constant angle is
fitted to such a mount, the result is the mean over the drive. The deviation of this mean becomes
smaller with time although the mount moves. Three kinds of models are therefore fitted to the
residuals of the road segments from the constant: no change, random walks of several sizes, and
steady creep at several rates. Materials creep at a steady rate under a steady load (secondary
creep; Ashby and Jones, Engineering Materials 1, ch. 20). The models are local level and local
linear trend with a Kalman filter (Durbin and Koopman, Time Series Analysis by State Space Methods,
2012, ch. 2 and 3). The probability of each model follows from its likelihood and its prior. All
models with a moving mount have the same prior. The reported angle and its interval are means over
all models, weighted by the probabilities of the models.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, Flags
from imucald.mount.joint.response import PRIOR_SEGMENTS

SIZES = np.radians([0.03, 0.07, 0.15, 0.3, 0.6])
"""Sizes of a random walk, as standard deviation of a step [rad/segment], and of steady creep, as
standard deviation of the rate [rad/segment]: 4, 10, 20, 40 and 80 deg/h."""
WALKS: Array = np.concatenate([[0.0], SIZES, 0.2 * SIZES])
WALK_VARIANCES: Array = WALKS**2
RATES: Array = np.concatenate([[0.0], 0.0 * SIZES, SIZES])
"""Standard deviation of the rate of each model [rad/segment]: zero for the constant and the random
walks, then creep. The rate of creep also wanders by a fifth of this value per segment.
"""
SHIFT_RATIO = 4.0
"""Assumed ratio of the number of shifts found in a creeping mount to the number found in a fixed
mount."""
BELIEVED = 0.995
"""Probability from which creep is reported."""
MOST = 20
"""Largest number of road segments after joining neighbours."""
FEWEST = 3
ANSWER_TAIL = 8.0
"""Degrees of freedom of the errors (Student's t distribution) of the response to motion. The causes
of large errors are wind and rough parts of the drive.
"""
LATE = 0.5
"""Mean age of a reported value, in segments. The value is valid for the middle of a segment, half a
segment ago, and is reported until the next segment ends.
"""
HIDDEN = 0.4
"""Share of a drift that the segments may not show.

An angle far from the mean looks like noise, so its segments get less weight. The lower weight
reduces the estimated level most where the drift is largest. In simulated drives with 72 deg/h
(seeds 500,000 to 500,011), the fit found 0.6 of the level with weights about the drift, and 0.5
with weights about the mean.
"""


class SegmentSeries(Struct, frozen=True):
    """Evidence about one angle from one source, by road segment.

    kind: name of the source, which begins with the name of the angle. left: (G,) residual scores
    about the constant angle. known: (G,) information of each segment [1/rad^2]. variance: variance
    of the constant from all segments, including the spread between the segments [rad^2].
    """

    kind: str
    left: Array
    known: Array
    variance: float

    @property
    def axis(self) -> int:
        """Index of the angle that the source shows: 0 roll, 1 pitch, 2 yaw."""
        return ("roll", "pitch", "yaw").index(self.kind.partition("_")[0])


class Creep(Struct, frozen=True):
    """Creep of roll, pitch and yaw, each (3,).

    level: present angle minus the constant [rad]. variance: variance that creep adds [rad^2].
    probability: probability that the mount creeps. rate: rate of change [rad/segment]. moved:
    change of the fitted line over the whole drive [rad].
    """

    level: Array
    variance: Array
    probability: Array
    rate: Array
    moved: Array


def creep(series: Sequence[SegmentSeries], chance: float, shifts: int) -> Creep | None:
    """Fit random walks and steady creep to the residuals of the series from their constants; None:
    too little data.

    The information of a series is too large by the factor that follows from its stated variance.
    chance: prior probability that the mount creeps, before any shift was found. shifts: number of
    shifts found.
    """
    n = max((len(one.left) for one in series), default=0)
    if n < FEWEST:
        return None
    left, known = np.zeros((3, n)), np.zeros((3, n))
    for one in series:
        m, times = len(one.left), _times(one)
        left[one.axis, n - m :] += one.left / times
        known[one.axis, n - m :] += one.known / times
    joined = np.arange(min(n, MOST)) * n // min(n, MOST)
    each = np.diff(np.append(joined, n)).astype(np.float64)
    left, known = np.add.reduceat(left, joined, axis=1), np.add.reduceat(known, joined, axis=1)
    log, mean, variance = _filtered(left, known, each)
    log_prior = np.full(len(WALKS), math.log(chance / (len(WALKS) - 1)))
    log_prior += shifts * math.log(SHIFT_RATIO)
    log_prior[0] = math.log(1.0 - chance)
    log = log + log_prior
    weight = np.exp(log - log.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    probability = 1.0 - weight[:, 0]
    level = (weight * mean).sum(axis=1)
    hidden = (HIDDEN * mean) ** 2
    extra = (weight * (variance + hidden + (mean - level[:, None]) ** 2)).sum(axis=1)
    rate = _trend(left, known, each)
    return Creep(level, extra, probability, rate, rate * float(n))


def _times(one: SegmentSeries) -> float:
    """Return the factor by which the information of a series is too large. The factor may be less
    than 1, because it is estimated from the segments.

    The prior is the factor that follows from the variance that the source states. The calculation
    uses the residuals about a straight line and the covariance of neighbouring segments (Newey and
    West, Econometrica 55, 1987, with their weights and 4 (n / 100)^(2/9) lags), because errors of
    a road persist over several segments, as a drift does. The covariance can only increase the
    factor.
    """
    expected = max(one.variance * float(one.known.sum()), 1.0)
    use = one.known > 0.0
    w, score = one.known[use], one.left[use]
    n = len(w)
    if n < FEWEST:
        return expected
    at = np.flatnonzero(use).astype(np.float64)
    from_middle = at - float(w @ at) / float(w.sum())
    slope = float(score @ from_middle) / float(w @ from_middle**2)
    u = (score - w * slope * from_middle) / np.sqrt(w)
    lags = int(4.0 * (0.01 * n) ** (2.0 / 9.0))
    own = float(u @ u)
    near = math.fsum(
        2.0 * (1.0 - lag / (lags + 1.0)) * float(u[lag:] @ u[:-lag])
        for lag in range(1, min(lags, n - 1) + 1)
    )
    squares = max(own + near, own) * n / max(n - 2.0, 1.0)
    return (PRIOR_SEGMENTS * expected + squares) / (PRIOR_SEGMENTS + n)


def _filtered(left: Array, known: Array, each: Array) -> tuple[Array, Array, Array]:
    """Return log likelihoods, final levels and the variances of the levels (3, K), with the
    constant subtracted."""
    total = np.maximum(known.sum(axis=1), 1e-12)[:, None]
    shape = len(known), len(WALKS)
    # of all segments at once (n, 3, 1)
    noise = 1.0 / np.maximum(known.T, 1e-12)[:, :, None]
    value = left.T[:, :, None] * noise
    is_new = known.T[:, :, None] > 0.0
    has_begun = np.logical_or.accumulate(is_new)
    before = np.concatenate([np.zeros_like(has_begun[:1]), has_begun[:-1]])
    goes_on, begins = is_new & before, is_new & ~before
    gaps = np.where(before, _gaps(each)[:, None, None], 0.0)
    state = np.zeros((2, *shape))  # level, rate
    # variance of the level, its covariance with the rate, and the rate's variance; the level at
    # the beginning is free (restricted likelihood)
    P = np.zeros((3, *shape))
    P[2] = RATES**2
    off, spread = np.zeros((len(each), *shape)), np.ones((len(each), *shape))
    last = np.where(has_begun[-1], 0.5 * float(each[-1]) + LATE, 0.0)
    _run(value, noise, gaps, goes_on, begins, off, spread, state, P)
    _go_on(state, P, last)
    loss = 0.5 * (
        (ANSWER_TAIL + 1.0) * np.log1p(off * off / (ANSWER_TAIL * spread)) + np.log(spread)
    )
    log = -np.where(goes_on, loss, 0.0).sum(axis=0)
    return log, state[0] - state[0, :, :1], np.maximum(P[0] - 1.0 / total, 0.0)


def _run(
    value: Array,
    noise: Array,
    gaps: Array,
    goes_on: Flags,
    begins: Flags,
    off: Array,
    spread: Array,
    state: Array,
    P: Array,
) -> None:
    """Run the filters over all segments (n, 3, 1), in place.

    off, spread: (n, 3, K) innovation of each filter and its variance. state: (2, 3, K) level and
    rate; P: (3, 3, K) their variances and covariance. state and P have the values after the last
    segment in the end.
    """
    each_goes_on: list[bool] = np.all(goes_on, axis=(1, 2)).tolist()
    any_begins: list[bool] = np.any(begins, axis=(1, 2)).tolist()
    for k in range(len(value)):
        _go_on(state, P, gaps[k])
        np.subtract(value[k], state[0], out=off[k])
        np.add(P[0], noise[k], out=spread[k])
        gain = P[:2] / spread[k]
        gain *= np.minimum((ANSWER_TAIL + 1.0) / (ANSWER_TAIL + off[k] * off[k] / spread[k]), 1.0)
        if not each_goes_on[k]:
            gain *= goes_on[k]
        P[2] -= gain[1] * P[1]
        P[:2] -= gain[0] * P[:2]
        state += gain * off[k]
        if any_begins[k]:
            state[0] = np.where(begins[k], value[k], state[0])
            P[0] = np.where(begins[k], noise[k], P[0])


def _gaps(each: Array) -> Array:
    """Return the distance from the middle of the previous segment to the middle of this one, in
    segments (n,)."""
    gaps = np.zeros(len(each))
    gaps[1:] = 0.5 * (each[:-1] + each[1:])
    return gaps


def _go_on(state: Array, P: Array, step: Array) -> None:
    """Predict level and covariance `step` segments ahead, in place. The rate stays the same."""
    state[0] += step * state[1]
    after = P[1] + step * P[2]
    P[0] += step * (P[1] + after + WALK_VARIANCES)
    P[1] = after


def _trend(left: Array, known: Array, each: Array) -> Array:
    """Return the slope (3,) of the straight line through the segments [rad/segment]."""
    at = np.cumsum(each) - 0.5 * each
    w = np.maximum(known, 0.0)
    middle = (w @ at) / np.maximum(w.sum(axis=1), 1e-12)
    from_middle = at - middle[:, None]
    power = np.maximum((w * from_middle**2).sum(axis=1), 1e-12)
    return np.asarray((left * from_middle).sum(axis=1) / power)
