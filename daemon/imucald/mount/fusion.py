"""Fuse sources of evidence about the three angles into one rotation with a covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.mount.road_segments import AngleEvidence

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

MAX_WIDENED = 25.0
"""Sources of equal weight that disagree widen the variance by chi^2 per degree of freedom (Birge),
at most this; where one carries nearly all, another's dissent says more of that other."""
AXES = ("roll", "pitch", "yaw")
SAME_ROAD = ("_gravity", "_axis")
"""Of an angle and a drive, by how their names end. A vehicle that turns on a slope turns about the
vertical, and so its axis of turning leans as gravity does. Of the mean slope of a road and any
other mean of it, as that over turns, the covariance is the former's variance, as long as the latter
is no better (Gauss and Markov)."""


class CommonError(Struct, frozen=True):
    """An error that several sources share: its standard deviation [rad] and each one's sign."""

    std: float
    signs: Mapping[str, float]


class Fused(Struct, frozen=True):
    """e (3,) [rad], its variances (3,), and which share of each angle each source carried."""

    error: Array
    variance: Array
    shares: dict[str, dict[str, float]]


CERTAIN: Sequence[tuple[float, float]] = ((0.0, 1.0),)
"""Scales and their probabilities where no error is as large as a scale says."""


class CommonCovariance:
    """Covariance that sources have with one another (and with themselves) from shared errors."""

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
        """Covariance of the sources of those names, their own variances included."""
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
    """What shows scaled errors without any angle in it: values (k,), and what else is in them.

    covariance: (k, k) without the scaled errors. answers: (k, m) to the scaled errors at scale 1.
    """

    values: Array
    covariance: Array
    answers: Array


class _Places(Struct, frozen=True):
    """Which sources speak of which angle.

    angles (A,): those that any speaks of; shown (N, A): 1 where a source speaks of one. names: of
    each angle's sources. of_angle (A, n): the same as places among all, as many as the most have.
    used (A, n): which of those hold one; both (A, n, n): pairs of them; alone (n, n): the identity.
    count (A,): of an angle's sources.
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
    """Places of gravity and of the axis of the same angle (`SAME_ROAD`)."""
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


def _scaled(names: Sequence[str], answers: Mapping[str, Array]) -> Array:
    """Covariance of sources from the scaled errors at scale 1; zero where none answers."""
    if not answers:
        return np.zeros((len(names), len(names)))
    of = np.array([answers[name] for name in names])
    covariance: Array = of @ of.T
    return covariance


def weighed_scales(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    candidates: Sequence[tuple[float, float]],
    answers: Mapping[str, Array],
    seen: Seen,
) -> list[tuple[float, float]]:
    """Scales of the scaled errors with their probabilities, from how far sources contradict.

    candidates: scales and their prior probabilities. Each is weighed by the likelihood of all
    sources and of what is seen besides, of which the three angles are free (restricted maximum
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
    V = known + (scales * scales)[:, None, None] * (of @ of.T)
    inverse = np.linalg.inv(V)
    to_angles = X.T @ inverse
    information = to_angles @ X
    angles = np.linalg.solve(information, (to_angles @ y)[:, :, None])
    left = y - (X @ angles)[:, :, 0]
    log = np.log(prior) - 0.5 * ((inverse @ left[:, :, None])[:, :, 0] * left).sum(axis=1)
    log -= 0.5 * (np.linalg.slogdet(V)[1] + np.linalg.slogdet(information)[1])
    weight = np.exp(log - log.max())
    return list(zip(scales.tolist(), (weight / weight.sum()).tolist(), strict=True))


def fuse(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    scales: Sequence[tuple[float, float]] = CERTAIN,
    answers: Mapping[str, Array] | None = None,
) -> Fused:
    """Best linear unbiased mean per angle; a source's name begins with its angle.

    The weights are V^-1 1 / (1' V^-1 1), V being the sources' variances plus what they share; a
    negative weight is not taken. scales: of the scaled errors, with probabilities; the means of
    all are averaged, and how far they lie apart is in the variance (Bayesian model averaging;
    Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999). So is how far that moves
    the mean from that of the first scale, the smallest: sources may contradict for other reasons.
    answers: of each source (m,) to independent scaled errors at scale 1.
    """
    error, variance = np.zeros(3), np.full(3, np.inf)
    if not sources:
        return Fused(error, variance, {})
    names = tuple(sources)
    at = _places(names)
    squares = np.array([scale * scale for scale, _ in scales])[:, None, None]
    V = sharing.covariance(sources, names) + squares * _scaled(names, answers or {})
    V = V[:, at.of_angle[:, :, None], at.of_angle[:, None, :]]  # (scales, A, n, n)
    V = np.where(at.both, V, at.alone)  # an unused place stands alone
    values = np.array([sources[name].value for name in names])[at.of_angle]
    probability = np.array([p for _, p in scales])
    inverse = np.linalg.inv(V)
    weight = np.maximum(inverse.sum(axis=3), 0.0) * at.used
    weight /= weight.sum(axis=2, keepdims=True)
    each = (weight * values).sum(axis=2)  # (scales, A)
    left = (values - each[:, :, None]) * at.used
    n = at.count
    free = np.maximum(n - 1, 1)
    chi2 = (left * (inverse @ left[..., None])[..., 0]).sum(axis=2)
    disagreement = np.minimum(np.maximum(chi2 / free, 1.0), MAX_WIDENED)
    evenness = n / free * (1.0 - (weight * weight).sum(axis=2))
    own = (weight * (V @ weight[..., None])[..., 0]).sum(axis=2)
    own *= 1.0 + (disagreement - 1.0) * evenness
    mean = probability @ each
    error[at.angles] = mean
    variance[at.angles] = probability @ (own + (each - mean) ** 2) + (mean - each[0]) ** 2
    carried = (probability @ weight.reshape(len(weight), -1)).reshape(at.used.shape).tolist()
    shares = {
        AXES[k]: dict(zip(own, part, strict=False))  # behind its names a row has unused places
        for k, own, part in zip(at.angles.tolist(), at.names, carried, strict=True)
    }
    return Fused(error, variance, shares)
