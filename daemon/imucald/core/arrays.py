"""Arrays of floats: the type, solutions of linear systems, sums in order, the median.

numpy's median imports its masked arrays, which takes 20 ms of every start.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of floats; its shape stands where it is used."""


def solved(matrix: Array, right: Array) -> Array:
    """Return x (..., n, k) or (n,) with matrix x = right. Raises LinAlgError for a singular one."""
    return np.asarray(np.linalg.solve(matrix, right), dtype=float)


def inverse(matrix: Array) -> Array:
    """Return the inverse (..., n, n). Raises LinAlgError where the matrix is singular."""
    return np.asarray(np.linalg.inv(matrix), dtype=float)


def summed_in_order(terms: Array) -> Array:
    """Sums from left to right over the last dimension of terms (..., n), n > 0.

    numpy sums longer ones in pairs, a library's products in any order, which differs by processor.
    """
    total: Array = terms[..., 0].copy()
    for k in range(1, terms.shape[-1]):
        total += terms[..., k]
    return total


def median(values: Iterable[float]) -> float:
    """Return the median; of an even number the mean of the middle two. ValueError: no value."""
    ordered = values if isinstance(values, np.ndarray) else sorted(values)
    if not len(ordered):
        raise ValueError("an empty array has no median")
    middle = len(ordered) // 2
    if isinstance(ordered, np.ndarray):  # as far as it matters
        ordered = np.partition(ordered, (max(middle - 1, 0), middle))
    if len(ordered) % 2:
        return float(ordered[middle])
    return float((ordered[middle - 1] + ordered[middle]) / 2.0)


def true_runs(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Runs of true flags (N,): of each its first place and the one after its last (R, 2)."""
    padded = np.zeros(len(flags) + 2, np.int8)
    padded[1:-1] = flags
    return np.flatnonzero(np.diff(padded)).reshape(-1, 2)
