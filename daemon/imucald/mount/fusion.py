"""Fuse sources of evidence about the three angles into one rotation with a covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.arrays import Array, summed_in_order
from imucald.mount.road_segments import AngleEvidence

Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

MAX_WIDENED = 25.0
"""Largest factor on the variance.

Sources of equal weight that disagree widen the variance by chi^2 per degree of freedom (Birge).
Where one source carries nearly all the weight, the disagreement of another says more about that
other source.
"""
AXES = ("roll", "pitch", "yaw")
SAME_ROAD = ("_gravity", "_axis")
"""Endings of the names of two sources that share the road of a drive.

A vehicle that turns on a slope turns about the vertical. In the vehicle's axes, its axis of turning
therefore leans as gravity does. One source contains the mean slope of the road, the other one
another mean of it, over turns. Their covariance is the variance of the former, as long as the
latter is not better (Gauss and Markov).
"""


class CommonError(Struct, frozen=True):
    """An error that several sources share: its standard deviation [rad], and its sign in each
    source."""

    std: float
    signs: Mapping[str, float]


class Fused(Struct, frozen=True):
    """Result: e (3,) [rad], its variances (3,), and the weight of each source in each angle."""

    error: Array
    variance: Array
    shares: dict[str, dict[str, float]]


CERTAIN: Sequence[tuple[float, float]] = ((0.0, 1.0),)
"""Scales and their probabilities if there are no scaled errors."""


class CommonCovariance:
    """Covariance between sources (and of each with itself) from shared errors."""

    def __init__(self, shared: Sequence[CommonError]) -> None:
        self._pairs = _pairs(shared)
        self._of_names: dict[tuple[str, ...], Array] = {}

    def errors(self, names: Sequence[str]) -> Array:
        """Covariance of sources from shared errors alone."""
        key = tuple(names)
        found = self._of_names.get(key)
        if found is None:  # few sets of names come
            pairs = self._pairs
            found = np.array([[pairs.get((a, b), 0.0) for b in names] for a in names])
            self._of_names[key] = found
        return found

    def covariance(self, sources: Mapping[str, AngleEvidence], names: Sequence[str]) -> Array:
        """Return the covariance of the named sources, including their own variances."""
        known = self.errors(names).copy()
        known.flat[:: len(names) + 1] += [sources[name].variance for name in names]
        for i, j in _same_road(tuple(names)):
            shared = min(sources[names[i]].road, sources[names[j]].variance)
            known[i, j] += shared
            known[j, i] += shared
        return known


def _pairs(shared: Sequence[CommonError]) -> dict[tuple[str, str], float]:
    found: dict[tuple[str, str], float] = {}
    for s in shared:
        for one, sign in s.signs.items():
            for other, other_sign in s.signs.items():
                sofar = found.get((one, other), 0.0)
                found[one, other] = sofar + s.std * s.std * sign * other_sign
    return found


class Seen(Struct, frozen=True):
    """Measurements that show scaled errors and do not depend on any angle: values (k,), and the
    covariance of their other errors.

    covariance: (k, k) without the scaled errors. answers: (k, m) responses to the scaled errors at
    scale 1.
    """

    values: Array
    covariance: Array
    answers: Array


class _Places(Struct, frozen=True):
    """Places of the sources that belong to each angle.

    angles (A,): angles with any source. shown (N, A): 1 where a source belongs to an angle. names:
    names of each angle's sources. of_angle (A, n): their places among all sources, in rows as long
    as the longest. used (A, n): places of a row that are in use. both (A, n, n): pairs of used
    places. alone (n, n): the identity. count (A,): number of an angle's sources.
    """

    angles: Index
    shown: Array
    names: Sequence[Sequence[str]]
    of_angle: Index
    used: Flags
    both: Flags
    alone: Array
    count: Index


@cache
def _same_road(names: tuple[str, ...]) -> list[tuple[int, int]]:
    """Return the places of gravity and of the axis of the same angle (`SAME_ROAD`)."""
    axes = [(i, name.replace(*SAME_ROAD)) for i, name in enumerate(names)]
    return [(i, names.index(axis)) for i, axis in axes if axis != names[i] and axis in names]


@cache
def _places(names: tuple[str, ...]) -> _Places:
    by_axis = [[i for i, name in enumerate(names) if name.startswith(axis)] for axis in AXES]
    angles = [k for k, found in enumerate(by_axis) if found]
    most = max(map(len, by_axis))
    used = np.array([np.arange(most) < len(by_axis[k]) for k in angles])
    shown = [[float(name.partition("_")[0] == AXES[k]) for k in angles] for name in names]
    return _Places(
        angles=np.array(angles),
        shown=np.array(shown),
        names=[[names[i] for i in by_axis[k]] for k in angles],
        of_angle=np.array([by_axis[k] + [0] * (most - len(by_axis[k])) for k in angles]),
        used=used,
        both=used[:, :, None] & used[:, None, :],
        alone=np.eye(most),
        count=used.sum(axis=1),
    )


def _covariances(known: Array, answers: Array, squares: Array) -> Array:
    """Return the covariances of sources (n,) for each square of a scale (S,): the known part (n, n)
    plus the scaled part.

    answers: responses of the sources (n, m) to the scaled errors at scale 1.
    """
    scaled = summed_in_order(answers[:, None] * answers[None])
    return np.asarray(known + squares[:, None, None] * scaled)


def weighed_scales(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    candidates: Sequence[tuple[float, float]],
    answers: Mapping[str, Array],
    seen: Seen,
) -> list[tuple[float, float]]:
    """Return scales of the scaled errors with their probabilities, from the contradictions of the
    sources.

    candidates: scales and their prior probabilities. Each scale is weighed by the likelihood of all
    sources and of the other measurements, with the three angles free (restricted maximum
    likelihood, Patterson and Thompson, Biometrika 58, 1971).
    """
    names = tuple(sources)
    n, more = len(names), len(seen.values)
    y = np.concatenate([[sources[name].value for name in names], seen.values])
    shown = _places(names).shown
    X = np.zeros((n + more, shown.shape[1]))
    X[:n] = shown
    known = np.zeros((n + more, n + more))
    known[:n, :n] = sharing.covariance(sources, names)
    known[n:, n:] = seen.covariance
    of = np.concatenate([[answers[name] for name in names], seen.answers])
    scales, prior = np.array(candidates).T
    squares, pivots, of_angles = _free_of_angles(known, of, scales * scales, X, y)
    log = np.log(prior) - 0.5 * squares
    log -= 0.5 * (np.log(pivots).sum(axis=1) + np.log(of_angles).sum(axis=1))
    weight = np.exp(log - log.max())
    return list(zip(scales.tolist(), (weight / weight.sum()).tolist(), strict=True))


def fuse(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    scales: Sequence[tuple[float, float]] = CERTAIN,
    answers: Mapping[str, Array] | None = None,
) -> Fused:
    """Return the best linear unbiased mean per angle. The name of a source begins with its angle.

    The weights are V^-1 1 / (1' V^-1 1). V is the variances of the sources plus their shared
    errors; a negative weight is not used. scales: scales of the scaled errors, with probabilities.
    The means of all scales are averaged, and the variance contains their spread (Bayesian model
    averaging; Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999). The variance
    also contains the distance of the result from the mean of the first, smallest scale, because
    sources may contradict for other reasons. answers: responses of each source (m,) to independent
    scaled errors at scale 1.
    """
    error, variance = np.zeros(3), np.full(3, np.inf)
    if not sources:
        return Fused(error, variance, {})
    names = tuple(sources)
    at = _places(names)
    squares, probability = np.array([(scale * scale, p) for scale, p in scales]).T
    known = sharing.covariance(sources, names)
    of = np.array([answers[name] for name in names]) if answers else np.zeros((len(names), 1))
    values = np.array([sources[name].value for name in names])
    mean, around, carried = _means(known, of, squares, values, at, probability)
    error[at.angles], variance[at.angles] = mean, around
    shares = {
        AXES[k]: dict(zip(own, part, strict=False))  # a row has unused places behind its names
        for k, own, part in zip(at.angles.tolist(), at.names, carried.tolist(), strict=True)
    }
    return Fused(error, variance, shares)


def _eliminated(V: Array, columns: Array) -> Array:
    """Eliminate covariances (..., n, n), with columns (..., n, k) behind them, below the diagonal.

    There is no search for pivots, because symmetric positive definite matrices do not need one.
    """
    both = np.concatenate([V, columns], axis=-1)
    for k in range(V.shape[-1] - 1):
        below, row = both[..., k + 1 :, k:], both[..., k, None, k:]
        below -= below[..., :1] / row[..., :1] * row
    return both


def _substituted(eliminated: Array) -> Array:
    """Return the solution (..., n) of an eliminated system with one column (..., n, n + 1)."""
    n = eliminated.shape[-2]
    out = np.empty(eliminated.shape[:-1])
    for i in range(n - 1, -1, -1):
        sum_ = eliminated[..., i, n].copy()
        for j in range(i + 1, n):
            sum_ -= eliminated[..., i, j] * out[..., j]
        out[..., i] = sum_ / eliminated[..., i, i]
    return out


def _free_of_angles(
    known: Array, answers: Array, scales2: Array, X: Array, y: Array
) -> tuple[Array, Array, Array]:
    """Return left' V^-1 left (S,) of values y (n,) with covariances V (S, n, n), after fitting
    angles X (n, A) freely. Also return the pivots (S, n), whose product is the determinant, and the
    pivots of the angles' information. known, answers, scales2: see `_covariances`.
    """
    scales, n, angles = len(scales2), len(y), X.shape[1]
    V = _covariances(known, answers, scales2)
    columns = np.broadcast_to(np.concatenate([X, y[:, None]], axis=1), (scales, n, angles + 1))
    both = _eliminated(V, columns)
    pivots = both.diagonal(axis1=1, axis2=2).copy()
    shown = both[:, :, n:].transpose(0, 2, 1)  # (S, A + 1, n)
    J = summed_in_order(shown[:, :angles, None] * shown[:, None] / pivots[:, None, None])
    information = _eliminated(J[:, :, :angles], J[:, :, angles:])
    found = _substituted(information)
    left = shown[:, angles].copy()
    for k in range(angles):
        left -= shown[:, k] * found[:, k, None]
    squares = summed_in_order(left * left / pivots)
    return squares, pivots, information.diagonal(axis1=1, axis2=2).copy()


def _means(
    known: Array, answers: Array, scales2: Array, values: Array, at: _Places, probability: Array
) -> tuple[Array, Array, Array]:
    """Return the best means of angles (A,), their variances, and the weight of each source (A, n).

    known, answers, scales2: see `_covariances`. values: values of the sources. probability:
    probabilities of the scales.
    """
    used = at.used
    V = _covariances(known, answers, scales2)
    V = V[:, at.of_angle[:, :, None], at.of_angle[:, None, :]]  # (scales, A, n, n)
    V = np.where(at.both, V, at.alone)  # an unused place stands alone
    values = values[at.of_angle]
    weight = np.maximum(_substituted(_eliminated(V, np.ones((*V.shape[:-1], 1)))), 0.0) * used
    weight /= summed_in_order(weight)[..., None]
    each = summed_in_order(weight * values)  # (scales, A)
    left = (values - each[:, :, None]) * used
    n = used.sum(axis=1)
    free = np.maximum(n - 1, 1)
    chi2 = summed_in_order(left * _substituted(_eliminated(V, left[..., None])))
    disagreement = np.minimum(np.maximum(chi2 / free, 1.0), MAX_WIDENED)
    evenness = n / free * (1.0 - summed_in_order(weight * weight))
    own = summed_in_order(weight * summed_in_order(V * weight[:, :, None]))
    own *= 1.0 + (disagreement - 1.0) * evenness
    mean = summed_in_order((probability[:, None] * each).T)
    around = summed_in_order((probability[:, None] * (own + (each - mean) ** 2)).T)
    carried = summed_in_order((probability[:, None, None] * weight).transpose(1, 2, 0))
    return mean, around + (mean - each[0]) ** 2, carried
