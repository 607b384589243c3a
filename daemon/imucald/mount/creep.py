"""Does the mount creep? A random walk beside a constant, with the evidence as weights.

A holder that gives, tape in the sun: the mount turns slowly all the time. A constant that is fitted
to it is a mean over the drive, and grows ever surer of what is no longer true. So what the road
segments leave over from the constant is also fitted by random walks of several sizes (local level
model, Kalman filter; Durbin and Koopman, Time Series Analysis by State Space Methods, 2012, ch. 2).
Each size has the probability that its likelihood and its prior give it; the constant keeps
`P_CONSTANT` beforehand, so a drive without creep has to speak twenty times as well for a walk as
for the constant before that is believed (in sound drives less than one in twenty does so; Markov's
inequality on the likelihood ratio). The interval takes all sizes as probable as they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.mount.road_segments import AngleEvidence
from imucald.mount.shift import ScoreSeries

Array = NDArray[np.float64]

WALKS = np.radians([0.0, 0.03, 0.07, 0.15, 0.3, 0.6])
"""Standard deviation of the walk from one road segment to the next [rad]. A steady creep of r a
segment looks like a walk of that size: 4, 10, 20, 40 and 80 deg/h."""
P_CONSTANT = 0.95
"""Prior probability that the mount is tight; the walks share the rest."""
P_CONSTANT_AGAIN = 0.5
"""The same once a shift was found in the drive."""
BELIEVED = 0.9
"""Probability from which the recent level is served instead of the mean, and creep is told."""
MOST = 20
"""Road segments are joined to so many at most."""
FEWEST = 5
SILENT = frozenset({"pitch_gravity", "pitch_axis"})
"""What these say of town and of motorway differs too much to tell creep from it (`UNEVEN_STD` in
`shift`)."""


class Creep(Struct, frozen=True):
    """Roll, pitch, yaw (3,). level: beyond the constant [rad], zero where no walk is believed.

    variance: what the walks add [rad^2]. probability: that the mount creeps. rate: [rad/segment].
    moved: between the first and the last third of the drive [rad].
    """

    level: Array
    variance: Array
    probability: Array
    rate: Array
    moved: Array


def creep(
    series: list[ScoreSeries], sources: Mapping[str, AngleEvidence], p_constant: float = P_CONSTANT
) -> Creep | None:
    """Fit walks to what series leave over from the constants; None while there is too little.

    sources: the same evidence, whose variances tell by how much informations are too large.
    """
    n = max((len(one.score) for one in series), default=0)
    if n < FEWEST:
        return None
    left, known = np.zeros((3, n)), np.zeros((3, n))
    for one in series:
        fit, source = one.fitted(), sources.get(one.kind)
        if fit is None or source is None or one.kind in SILENT:
            continue
        total = float(fit.rows[:, 0].sum())
        times = max(source.variance * total, 1.0)
        m = len(fit.left)
        left[one.axis, n - m :] += fit.left / times
        known[one.axis, n - m :] += fit.rows[:, 0] / times
    joined = np.arange(min(n, MOST)) * n // min(n, MOST)
    each = np.diff(np.append(joined, n)).astype(np.float64)
    left, known = np.add.reduceat(left, joined, axis=1), np.add.reduceat(known, joined, axis=1)
    log, mean, variance = _filtered(left, known, each)
    prior = np.full(len(WALKS), (1.0 - p_constant) / (len(WALKS) - 1))
    prior[0] = p_constant
    weight = prior * np.exp(log - log.max(axis=1, keepdims=True))
    weight /= weight.sum(axis=1, keepdims=True)
    probability = 1.0 - weight[:, 0]
    level = (weight * mean).sum(axis=1) / np.maximum(probability, 1e-12)
    level = np.where(probability > BELIEVED, level, 0.0)
    spread = weight * (variance + (mean - level[:, None]) ** 2)
    extra = spread[:, 1:].sum(axis=1) + weight[:, 0] * level**2
    rate, moved = _trend(left, known, each)
    return Creep(level, extra, probability, rate, moved)


def _filtered(left: Array, known: Array, each: Array) -> tuple[Array, Array, Array]:
    """Log likelihoods, levels at the end and their variances beyond the constant's (3, walks)."""
    total = np.maximum(known.sum(axis=1), 1e-12)[:, None]
    walks2 = WALKS**2
    # the level at the beginning is free: information filter from none, restricted likelihood
    information = np.zeros((3, len(WALKS)))
    mean = np.zeros((3, len(WALKS)))
    n = left.shape[1]
    before, surprise = np.empty((2, n, 3, len(WALKS)))
    new = known.T[:, :, None]  # segments first
    value = left.T[:, :, None] / np.maximum(new, 1e-12)
    pull = np.maximum(new, 0.0)  # nothing new: the mean stays
    for k in range(n):
        if k:
            information = information / (1.0 + information * (walks2 * each[k]))
        before[k] = information
        information = information + new[k]
        surprise[k] = value[k] - mean
        mean = mean + pull[k] / np.maximum(information, 1e-12) * surprise[k]
    has = (before > 0.0) & (new > 0.0)
    spread = np.where(has, 1.0 / np.maximum(before, 1e-12) + 1.0 / np.maximum(new, 1e-12), 1.0)
    log = -0.5 * np.where(has, surprise**2 / spread + np.log(spread), 0.0).sum(axis=0)
    variance = 1.0 / np.maximum(information, 1e-12)
    return log, mean - mean[:, :1], np.maximum(variance - 1.0 / total, 0.0)


def _trend(left: Array, known: Array, each: Array) -> tuple[Array, Array]:
    """Slope of the straight line through the segments [rad/segment], and the way it makes."""
    at = np.cumsum(each) - 0.5 * each
    w = np.maximum(known, 0.0)
    total = np.maximum(w.sum(axis=1), 1e-12)
    middle = (w @ at) / total
    from_middle = at - middle[:, None]
    power = np.maximum((w * from_middle**2).sum(axis=1), 1e-12)
    slope: Array = (left * from_middle).sum(axis=1) / power
    return slope, slope * math.fsum(each.tolist())
