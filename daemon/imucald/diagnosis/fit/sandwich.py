"""Standard deviations of a fit from the scatter of its blocks (sandwich, Huber 1967; White
1980)."""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.fit.box import RIDGE

QUARTERS = 4


def ridge(H: Array) -> Array:
    """Ridge that is added to a Hessian (P, P) so that it can be inverted."""
    return RIDGE * np.diag(np.maximum(np.diag(H), 1e-30))


def scatters(score: Array, fitted: int) -> tuple[Array, Array]:
    """Two scatter matrices (P, P) of the blocks' scores (B, P): of single blocks, and with the
    neighbouring block for effects longer than a block. fitted: number of parameters fitted to the
    blocks."""
    B = len(score)
    alone = score.T @ score * (B / max(B - fitted, 1))
    lag = score[1:].T @ score[:-1]
    return alone, alone + lag + lag.T


def between_quarters(score: Array) -> Array:
    """Scatter of the quarters' scores about their mean (cluster-robust; Cameron and Miller 2015).

    A parameter that drifts between quarters counts by its effect on the whole fit. If a quarter has
    little information on a parameter, its own value may be very wrong, but it hardly changes the
    fit of all quarters.
    """
    if len(score) < 2 * QUARTERS:
        return np.zeros((score.shape[1], score.shape[1]))
    parts = np.array([part.sum(axis=0) for part in np.array_split(score, QUARTERS)])
    parts = parts - parts.mean(axis=0)
    return np.asarray(parts.T @ parts * (QUARTERS / (QUARTERS - 1)))


def variances(inverse: Array, scatter: Array) -> Array:
    """(P,) variances of the parameters, from the inverse Hessian and the scatter of the scores."""
    return np.diag(inverse @ scatter @ inverse)
