"""Fuse sources of evidence about the three angles into one rotation with a covariance."""

from __future__ import annotations

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

    def __init__(self, shared: Sequence[CommonError]) -> None:
        self._pairs: dict[tuple[str, str], float] = {}
        for s in shared:
            for one, sign in s.signs.items():
                for other, other_sign in s.signs.items():
                    sofar = self._pairs.get((one, other), 0.0)
                    self._pairs[one, other] = sofar + s.std * s.std * sign * other_sign

    def covariance(self, sources: Mapping[str, AngleEvidence], names: Sequence[str]) -> Array:
        """Covariance of the sources of those names, their own variances included."""
        get = self._pairs.get
        return np.array(
            [
                [get((a, b), 0.0) + (sources[a].variance if a == b else 0.0) for b in names]
                for a in names
            ]
        )


def fuse(sources: Mapping[str, AngleEvidence], sharing: CommonCovariance) -> Fused:
    """Best linear unbiased mean per angle; a source's name begins with its angle.

    The weights are V^-1 1 / (1' V^-1 1), V being the sources' variances plus what they share; a
    negative weight is not taken.
    """
    error, variance = np.zeros(3), np.full(3, np.inf)
    shares: dict[str, dict[str, float]] = {}
    for i, axis in enumerate(AXES):
        names = [name for name in sources if name.startswith(axis)]
        if not names:
            continue
        V = sharing.covariance(sources, names)
        inverse = np.linalg.inv(V)
        weight = np.maximum(inverse.sum(axis=1), 0.0)
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
