"""Fuse sources of evidence about the three angles into one rotation with a covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.mount.road_segments import AngleEvidence

Array = NDArray[np.float64]

MAX_WIDENED = 25.0
"""Sources of equal weight that disagree widen the variance by chi^2 per degree of freedom (Birge),
at most this; where one carries nearly all, another's dissent says more of that other."""
AXES = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class CommonError:
    """An error that several sources share: its standard deviation [rad] and each one's sign."""

    std: float
    signs: Mapping[str, float]


@dataclass(frozen=True)
class Fused:
    """e (3,) [rad], its variances (3,), and which share of each angle each source carried."""

    error: Array
    variance: Array
    shares: dict[str, dict[str, float]]


CERTAIN: Sequence[tuple[float, float]] = ((0.0, 1.0),)
"""Scales and their probabilities where no error is as large as a scale says."""


class CommonCovariance:
    """Covariance that sources have with one another (and with themselves) from shared errors.

    scaled: errors that are as large as a scale says, which only `fuse` is told.
    """

    def __init__(self, shared: Sequence[CommonError], scaled: Sequence[CommonError] = ()) -> None:
        self._pairs = _pairs(shared)
        self._scaled = _pairs(scaled)

    def scaled(self, names: Sequence[str]) -> Array:
        """Covariance of the sources of those names from the scaled errors, at scale 1."""
        get = self._scaled.get
        return np.array([[get((a, b), 0.0) for b in names] for a in names])

    def covariance(self, sources: Mapping[str, AngleEvidence], names: Sequence[str]) -> Array:
        """Covariance of the sources of those names, their own variances included, at scale 0."""
        get = self._pairs.get
        return np.array(
            [
                [get((a, b), 0.0) + (sources[a].variance if a == b else 0.0) for b in names]
                for a in names
            ]
        )


def _pairs(shared: Sequence[CommonError]) -> dict[tuple[str, str], float]:
    found: dict[tuple[str, str], float] = {}
    for s in shared:
        for one, sign in s.signs.items():
            for other, other_sign in s.signs.items():
                sofar = found.get((one, other), 0.0)
                found[one, other] = sofar + s.std * s.std * sign * other_sign
    return found


def probable_scales(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    candidates: Sequence[tuple[float, float]],
    seen: Sequence[tuple[float, float]] = (),
) -> list[tuple[float, float]]:
    """Scales of the scaled errors with their probabilities, from how far sources contradict.

    candidates: scales and their prior probabilities. Each is weighed by the likelihood of the
    differences between the sources of an angle (of which the angle itself is free; restricted
    maximum likelihood, Patterson and Thompson, Biometrika 58, 1971), over all angles.
    seen: further errors of scale one, seen by themselves, with what else is in them (std).
    """
    log = np.array([math.log(p) for _, p in candidates])
    squares = np.array([scale * scale for scale, _ in candidates])
    for axis in AXES:
        names = [name for name in sources if name.startswith(axis)]
        if len(names) < 2:
            continue
        values = np.array([sources[name].value for name in names])
        V = _covariances(sources, sharing, names, squares)
        inverse = np.linalg.inv(V)
        column = inverse.sum(axis=2)
        total = column.sum(axis=1)
        left = values - ((column @ values) / total)[:, None]
        log -= 0.5 * ((inverse @ left[:, :, None])[:, :, 0] * left).sum(axis=1)
        log -= 0.5 * (np.linalg.slogdet(V)[1] + np.log(total))
    for value, std in seen:
        variance = squares + std * std
        log -= 0.5 * (value * value / variance + np.log(variance))
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    return [(scale, float(p)) for (scale, _), p in zip(candidates, weight, strict=True)]


def _covariances(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    names: Sequence[str],
    squares: Array,
) -> Array:
    """Covariances (K, n, n) of n sources at squared scales (K,)."""
    known: Array = sharing.covariance(sources, names) + squares[:, None, None] * sharing.scaled(
        names
    )
    return known


def fuse(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    scales: Sequence[tuple[float, float]] = CERTAIN,
) -> Fused:
    """Best linear unbiased mean per angle; a source's name begins with its angle.

    The weights are V^-1 1 / (1' V^-1 1), V being the sources' variances plus what they share; a
    negative weight is not taken. scales: of the scaled errors, with probabilities; the means of
    all are averaged, and how far they lie apart is in the variance (Bayesian model averaging;
    Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999).
    """
    error, variance = np.zeros(3), np.full(3, np.inf)
    shares: dict[str, dict[str, float]] = {}
    squares = np.array([scale * scale for scale, _ in scales])
    probability = np.array([p for _, p in scales])
    for i, axis in enumerate(AXES):
        names = [name for name in sources if name.startswith(axis)]
        if not names:
            continue
        V = _covariances(sources, sharing, names, squares)
        inverse = np.linalg.inv(V)
        weight = np.maximum(inverse.sum(axis=2), 0.0)
        weight /= weight.sum(axis=1, keepdims=True)
        values = np.array([sources[name].value for name in names])
        each = weight @ values
        left = values - each[:, None]
        free = max(len(names) - 1, 1)
        chi2 = (left * (inverse @ left[:, :, None])[:, :, 0]).sum(axis=1)
        disagreement = np.minimum(np.maximum(chi2 / free, 1.0), MAX_WIDENED)
        evenness = len(names) / free * (1.0 - (weight * weight).sum(axis=1))
        own = (weight * (V @ weight[:, :, None])[:, :, 0]).sum(axis=1)
        own *= 1.0 + (disagreement - 1.0) * evenness
        error[i] = probability @ each
        variance[i] = probability @ (own + (each - error[i]) ** 2)
        shares[axis] = dict(zip(names, (probability @ weight).tolist(), strict=True))
    return Fused(error, variance, shares)
