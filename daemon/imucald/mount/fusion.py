"""Fuse pieces of evidence about the three angles into one rotation with a covariance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.mount.evidence_pieces import Piece

Array = NDArray[np.float64]

MOST_WIDENED = 25.0
"""Pieces that disagree widen the variance by chi^2 per degree of freedom (Birge), at most this."""
AXES = ("roll", "pitch", "yaw")


@dataclass(frozen=True)
class Shared:
    """An error that several pieces share: its standard deviation [rad] and each one's sign."""

    std: float
    signs: Mapping[str, float]


@dataclass(frozen=True)
class Fused:
    """e (3,) [rad], its variances (3,), and which share of each angle each piece carried."""

    error: Array
    variance: Array
    shares: dict[str, dict[str, float]]


def fuse(pieces: Mapping[str, Piece], shared: Sequence[Shared]) -> Fused:
    """Best linear unbiased mean per angle; a piece's name begins with its angle.

    The weights are V^-1 1 / (1' V^-1 1), V being the pieces' variances plus what they share; a
    negative weight is not taken.
    """
    error, variance = np.zeros(3), np.full(3, np.inf)
    shares: dict[str, dict[str, float]] = {}
    for i, axis in enumerate(AXES):
        names = [name for name in pieces if name.startswith(axis)]
        if not names:
            continue
        V = np.diag([pieces[name].variance for name in names])
        for s in shared:
            signs = [s.signs.get(name, 0.0) for name in names]
            if any(signs):
                V += s.std * s.std * np.outer(signs, signs)
        weight = np.maximum(np.linalg.solve(V, np.ones(len(names))), 0.0)
        weight /= weight.sum()
        error[i] = float(weight @ np.array([pieces[name].value for name in names]))
        left = np.array([pieces[name].value for name in names]) - error[i]
        disagreement = float(left @ np.linalg.solve(V, left)) / max(len(names) - 1, 1)
        variance[i] = float(weight @ V @ weight) * min(max(disagreement, 1.0), MOST_WIDENED)
        shares[axis] = {name: float(w) for name, w in zip(names, weight, strict=True)}
    return Fused(error, variance, shares)
