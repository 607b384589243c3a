"""Divide the drives of a vehicle into segments. The sensor may have been moved between two
segments.

Optimal partitioning (Jackson et al., IEEE Signal Processing Letters 12, 2005): the partition with
the smallest sum of chi-square and a penalty for each cut. Cuts are only candidates for remounts.
The decision needs the data of all vehicles (`remounts`).
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from imucald.core.arrays import Array, Index

CANDIDATE_P = 0.05
"""Probability that a vehicle without a remount gets a candidate."""


def candidates(e: Array, W: Array, may: NDArray[np.bool_]) -> list[int]:
    """Return the cuts of one vehicle: the index of the first drive after each cut.

    e: (n, 3) rotation vectors [deg]. W: (n, 3, 3) inverse covariances of single drives [1/deg^2].
    may: (n,) whether a cut may lie before each drive.
    """
    n = len(e)
    if n < 2:
        return []
    penalty = _penalty(n)
    We = np.einsum("nij,nj->ni", W, e)
    sums = (
        _from_zero(W),
        _from_zero(We),
        _from_zero(np.einsum("ni,ni->n", e, We)),
    )
    best = np.zeros(n + 1)
    best[0] = -penalty
    before = np.zeros(n + 1, dtype=np.int64)
    for end in range(1, n + 1):
        total = best[:end] + _costs(sums, end) + penalty
        before[end] = int(np.argmin(total))
        best[end] = total[before[end]] if end == n or may[end] else np.inf
    cuts = []
    place = int(before[n])
    while place > 0:
        cuts.append(place)
        place = int(before[place])
    return cuts[::-1]


@cache
def _penalty(n: int) -> float:
    """Return the chi-square that the best of n - 1 cuts exceeds only with the probability
    `CANDIDATE_P` in a vehicle without a remount."""
    return float(chi2.isf(CANDIDATE_P / (n - 1), 3))


def _from_zero(values: Array) -> Array:
    return np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])


def _costs(sums: tuple[Array, Array, Array], end: int) -> Array:
    """Return for each a below `end` the chi-square of the drives a ... end - 1 about their mean,
    (end,)."""
    W, We, eWe = (s[end] - s[:end] for s in sums)
    mean = np.linalg.solve(W, We[:, :, None])[:, :, 0]
    return np.asarray(eWe - np.einsum("ni,ni->n", We, mean))


def means(e: Array, W: Array, segment: Index, is_after: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return the weighted means (k, 3) of the segments 0 ... k - 1, and the covariances (k, 3, 3)
    of the means.

    A remount may be hidden in a segment that contains drives without an order
    (`KnownDrives.is_after`). If the drives of such a segment scatter more than the stated
    covariances explain, the additional scatter is added to the covariance of the mean.
    """
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    We = np.einsum("nij,nj->ni", W, e)
    covariance = np.linalg.inv(np.add.reduceat(W, starts, axis=0))
    mean = np.einsum("kij,kj->ki", covariance, np.add.reduceat(We, starts, axis=0))
    if not is_after.all():
        count = np.diff(starts, append=len(e))[:, None]
        spread = np.add.reduceat((e - mean[segment]) ** 2, starts) / np.maximum(count - 1, 1)
        stated = np.diagonal(np.linalg.inv(W), axis1=1, axis2=2)
        more = np.maximum(spread - np.add.reduceat(stated, starts) / count, 0.0)
        more[np.logical_and.reduceat(is_after, starts)] = 0.0
        covariance = covariance + more[:, :, None] * np.eye(3)
    return mean, covariance
