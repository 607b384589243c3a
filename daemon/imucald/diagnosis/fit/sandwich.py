"""Deviations of a fit from how its blocks scatter (sandwich, Huber 1967; White 1980)."""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.fit.box import RIDGE

QUARTERS = 4


def ridge(H: Array) -> Array:
    """What is added to a Hessian (P, P) so that it can be inverted."""
    return RIDGE * np.diag(np.maximum(np.diag(H), 1e-30))


def scatters(score: Array, fitted: int) -> tuple[Array, Array]:
    """Scatter (P, P) of the blocks' scores (B, P): each by itself, and with its neighbour, for what
    lasts longer than a block. fitted: parameters that the blocks were used up for."""
    B = len(score)
    alone = score.T @ score * (B / max(B - fitted, 1))
    lag = score[1:].T @ score[:-1]
    return alone, alone + lag + lag.T


def between_quarters(score: Array) -> Array:
    """Scatter of the quarters' scores about their mean (cluster-robust; Cameron and Miller 2015).

    What drifts from piece to piece counts by as much as it moves the whole. Where a quarter holds
    little on a parameter, its own value of it may be anything, and the whole hardly moves.
    """
    if len(score) < 2 * QUARTERS:
        return np.zeros((score.shape[1], score.shape[1]))
    parts = np.array([part.sum(axis=0) for part in np.array_split(score, QUARTERS)])
    parts = parts - parts.mean(axis=0)
    return np.asarray(parts.T @ parts * (QUARTERS / (QUARTERS - 1)))


def variances(inverse: Array, scatter: Array) -> Array:
    """(P,) of the parameters, from the inverse Hessian and the scatter of the scores."""
    return np.diag(inverse @ scatter @ inverse)
