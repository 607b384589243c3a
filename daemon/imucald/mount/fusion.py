"""Fuse sources of evidence about the three angles into one rotation with a covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.mount.road_segments import AngleEvidence

Array = NDArray[np.float64]

MAX_WIDENED = 25.0
"""Sources of equal weight that disagree widen the variance by chi^2 per degree of freedom (Birge),
at most this; where one carries nearly all, another's dissent says more of that other."""
AXES = ("roll", "pitch", "yaw")


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
    """Covariance that sources have with one another (and with themselves) from shared errors.

    scaled: errors that are as large as a scale says, which only `fuse` is given.
    """

    def __init__(self, shared: Sequence[CommonError], scaled: Sequence[CommonError] = ()) -> None:
        self._pairs = _pairs(shared)
        self._scaled = _pairs(scaled)
        self._of_names: dict[tuple[str, ...], tuple[Array, Array]] = {}

    def errors(self, names: Sequence[str]) -> tuple[Array, Array]:
        """Covariances of sources from shared errors, and from scaled ones at scale 1."""
        key = tuple(names)
        found = self._of_names.get(key)
        if found is None:  # few sets of names come
            shared, scaled = (
                np.array([[pairs.get((a, b), 0.0) for b in names] for a in names])
                for pairs in (self._pairs, self._scaled)
            )
            found = self._of_names[key] = shared, scaled
        return found

    def covariance(self, sources: Mapping[str, AngleEvidence], names: Sequence[str]) -> Array:
        """Covariance of the sources of those names, their own variances included, at scale 0."""
        known = self.errors(names)[0].copy()
        known.flat[:: len(names) + 1] += [sources[name].variance for name in names]
        return known


def _pairs(shared: Sequence[CommonError]) -> dict[tuple[str, str], float]:
    found: dict[tuple[str, str], float] = {}
    for s in shared:
        for one, sign in s.signs.items():
            for other, other_sign in s.signs.items():
                sofar = found.get((one, other), 0.0)
                found[one, other] = sofar + s.std * s.std * sign * other_sign
    return found


class _Angle(Struct, frozen=True):
    """Sources of one angle: values (n,), covariances at all scales and their inverses (K, n, n)."""

    axis: int
    names: list[str]
    values: Array
    V: Array
    inverse: Array


def _angles(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    scales: Sequence[tuple[float, float]],
) -> list[_Angle]:
    squares = np.array([scale * scale for scale, _ in scales])[:, None, None]
    found = []
    for i, axis in enumerate(AXES):
        names = [name for name in sources if name.startswith(axis)]
        if names:
            values = np.array([sources[name].value for name in names])
            V = sharing.covariance(sources, names) + squares * sharing.errors(names)[1]
            found.append(_Angle(i, names, values, V, np.asarray(np.linalg.inv(V), np.float64)))
    return found


def weighed_scales(
    angles: Sequence[_Angle],
    candidates: Sequence[tuple[float, float]],
    seen: Sequence[tuple[float, float]] = (),
) -> list[tuple[float, float]]:
    """Scales of the scaled errors with their probabilities, from how far sources contradict.

    candidates: scales and their prior probabilities. Each is weighed by the likelihood of the
    differences between the sources of an angle (of which the angle itself is free; restricted
    maximum likelihood, Patterson and Thompson, Biometrika 58, 1971), over all angles.
    seen: further errors of scale one, seen by themselves, with what else is in them (std).
    """
    scales, prior = np.array(candidates).T
    log = np.log(prior)
    for one in angles:
        if len(one.names) < 2:
            continue
        column = one.inverse.sum(axis=2)
        total = column.sum(axis=1)
        left = one.values - ((column @ one.values) / total)[:, None]
        log -= 0.5 * ((one.inverse @ left[:, :, None])[:, :, 0] * left).sum(axis=1)
        log -= 0.5 * (np.linalg.slogdet(one.V)[1] + np.log(total))
    for value, std in seen:
        variance = scales * scales + std * std
        log -= 0.5 * (value * value / variance + np.log(variance))
    weight = np.exp(log - log.max())
    return list(zip(scales.tolist(), (weight / weight.sum()).tolist(), strict=True))


def fuse_weighing(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    candidates: Sequence[tuple[float, float]],
    seen: Sequence[tuple[float, float]] = (),
) -> tuple[Fused, list[tuple[float, float]]]:
    """`fuse` with the scales that `weighed_scales` makes of the candidates, and these."""
    angles = _angles(sources, sharing, candidates)
    scales = weighed_scales(angles, candidates, seen)
    return _fused(angles, scales), scales


def fuse(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    scales: Sequence[tuple[float, float]] = CERTAIN,
) -> Fused:
    """Best linear unbiased mean per angle; a source's name begins with its angle.

    The weights are V^-1 1 / (1' V^-1 1), V being the sources' variances plus what they share; a
    negative weight is not taken. scales: of the scaled errors, with probabilities; the means of
    all are averaged, and how far they lie apart is in the variance (Bayesian model averaging;
    Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999). So is how far that moves
    the mean from that of the first scale, the smallest: sources may contradict for other reasons.
    """
    return _fused(_angles(sources, sharing, scales), scales)


def _fused(angles: Sequence[_Angle], scales: Sequence[tuple[float, float]]) -> Fused:
    error, variance = np.zeros(3), np.full(3, np.inf)
    shares: dict[str, dict[str, float]] = {}
    probability = np.array([p for _, p in scales])
    for one in angles:
        n = len(one.names)
        weight = np.maximum(one.inverse.sum(axis=2), 0.0)
        weight /= weight.sum(axis=1, keepdims=True)
        each = weight @ one.values
        left = one.values - each[:, None]
        free = max(n - 1, 1)
        chi2 = (left * (one.inverse @ left[:, :, None])[:, :, 0]).sum(axis=1)
        disagreement = np.minimum(np.maximum(chi2 / free, 1.0), MAX_WIDENED)
        evenness = n / free * (1.0 - (weight * weight).sum(axis=1))
        own = (weight * (one.V @ weight[:, :, None])[:, :, 0]).sum(axis=1)
        own *= 1.0 + (disagreement - 1.0) * evenness
        mean = float(probability @ each)
        error[one.axis] = mean
        variance[one.axis] = probability @ (own + (each - mean) ** 2) + (mean - each[0]) ** 2
        shares[AXES[one.axis]] = dict(zip(one.names, (probability @ weight).tolist(), strict=True))
    return Fused(error, variance, shares)
