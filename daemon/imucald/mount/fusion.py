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


class CommonCovariance:
    """Covariance that sources have with one another (and with themselves) from shared errors."""

    def __init__(self, shared: Sequence[CommonError], scaled: Sequence[CommonError] = ()) -> None:
        """scaled: errors as large as `scale` says (1 at first), which may change."""
        self._pairs = _pairs(shared)
        self._scaled = _pairs(scaled)
        self.scale2 = 1.0

    def scaled(self, names: Sequence[str]) -> Array:
        """Covariance of the sources of those names from the scaled errors, at scale 1."""
        get = self._scaled.get
        return np.array([[get((a, b), 0.0) for b in names] for a in names])

    def covariance(self, sources: Mapping[str, AngleEvidence], names: Sequence[str]) -> Array:
        """Covariance of the sources of those names, their own variances included."""
        get = self._pairs.get
        known = np.array(
            [
                [get((a, b), 0.0) + (sources[a].variance if a == b else 0.0) for b in names]
                for a in names
            ]
        )
        return known + self.scale2 * self.scaled(names) if self._scaled else known


def _pairs(shared: Sequence[CommonError]) -> dict[tuple[str, str], float]:
    found: dict[tuple[str, str], float] = {}
    for s in shared:
        for one, sign in s.signs.items():
            for other, other_sign in s.signs.items():
                sofar = found.get((one, other), 0.0)
                found[one, other] = sofar + s.std * s.std * sign * other_sign
    return found


def probable_scale2(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    candidates: Sequence[tuple[float, float]],
    uneven: Mapping[str, float],
) -> float:
    """Mean square of the scale of the scaled errors, from how far sources contradict one another.

    candidates: scales and their prior probabilities. Each is weighed by the likelihood of the
    differences between the sources of an angle (of which the angle itself is free; restricted
    maximum likelihood, Patterson and Thompson, Biometrika 58, 1971), over all angles.
    uneven: what sources differ by for other reasons [rad].
    """
    log = np.array([math.log(p) for _, p in candidates])
    squares = np.array([scale * scale for scale, _ in candidates])
    before, sharing.scale2 = sharing.scale2, 0.0
    for axis in AXES:
        names = [name for name in sources if name.startswith(axis)]
        if len(names) < 2:
            continue
        known, extra = sharing.covariance(sources, names), sharing.scaled(names)
        known += np.diag([uneven.get(name, 0.0) ** 2 for name in names])
        values = np.array([sources[name].value for name in names])
        V = known + squares[:, None, None] * extra
        inverse = np.linalg.inv(V)
        column = inverse.sum(axis=2)
        total = column.sum(axis=1)
        left = values - ((column @ values) / total)[:, None]
        log -= 0.5 * ((inverse @ left[:, :, None])[:, :, 0] * left).sum(axis=1)
        log -= 0.5 * (np.linalg.slogdet(V)[1] + np.log(total))
    sharing.scale2 = before
    weight = np.exp(log - log.max())
    return float(weight @ squares / weight.sum())


def fuse(
    sources: Mapping[str, AngleEvidence],
    sharing: CommonCovariance,
    base: CommonCovariance | None = None,
) -> Fused:
    """Best linear unbiased mean per angle; a source's name begins with its angle.

    The weights are V^-1 1 / (1' V^-1 1), V being the sources' variances plus what they share; a
    negative weight is not taken. base: what the weights are made of, where `sharing` holds errors
    that are only probable: these widen the interval and move nothing.
    """
    error, variance = np.zeros(3), np.full(3, np.inf)
    shares: dict[str, dict[str, float]] = {}
    for i, axis in enumerate(AXES):
        names = [name for name in sources if name.startswith(axis)]
        if not names:
            continue
        V = sharing.covariance(sources, names)
        inverse = np.linalg.inv(V)
        even = inverse if base is None else np.linalg.inv(base.covariance(sources, names))
        weight = np.maximum(even.sum(axis=1), 0.0)
        weight /= weight.sum()
        values = np.array([sources[name].value for name in names])
        error[i] = weight @ values
        left = values - error[i]
        free = max(len(names) - 1, 1)
        disagreement = min(max(float(left @ inverse @ left) / free, 1.0), MAX_WIDENED)
        evenness = len(names) / free * (1.0 - float(weight @ weight))
        variance[i] = float(weight @ V @ weight) * (1.0 + (disagreement - 1.0) * evenness)
        shares[axis] = dict(zip(names, weight.tolist(), strict=True))
    return Fused(error, variance, shares)
