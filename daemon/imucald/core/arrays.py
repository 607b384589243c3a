"""Arrays of floats: the type, linear systems, ordered sums, the median, distinct values.

numpy's own median and `unique` import its masked arrays, which takes 20 ms of every run.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""An array of floats; each use states its shape."""
Flags = NDArray[np.bool_]
Index = NDArray[np.int64]
Number = TypeVar("Number", bound=np.generic)


def solved(matrix: Array, right: Array) -> Array:
    """Solve the linear system `matrix @ x = right`. Return x, (..., n, k) or (n,). Raises
    LinAlgError for a singular matrix.
    """
    return np.asarray(np.linalg.solve(matrix, right), dtype=float)


def inverse(matrix: Array) -> Array:
    """Return the inverse (..., n, n). Raises LinAlgError for a singular matrix."""
    return np.asarray(np.linalg.inv(matrix), dtype=float)


def median(values: Iterable[float]) -> float:
    """Return the median; for an even number of values, the mean of the middle two.

    Raises ValueError if there is no value.
    """
    ordered = values if isinstance(values, np.ndarray) else sorted(values)
    if not len(ordered):
        raise ValueError("an empty array has no median")
    middle = len(ordered) // 2
    if isinstance(ordered, np.ndarray):  # as far as it matters
        ordered = np.partition(ordered, (max(middle - 1, 0), middle))
    if len(ordered) % 2:
        return float(ordered[middle])
    return float((ordered[middle - 1] + ordered[middle]) / 2.0)


def distinct(values: NDArray[Number]) -> NDArray[Number]:
    """Return the distinct values of an array (N,) without NaN, in ascending order."""
    ordered = np.sort(values)
    is_first = np.ones(len(ordered), np.bool_)
    is_first[1:] = ordered[1:] != ordered[:-1]
    return ordered[is_first]


def true_runs(flags: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the runs of true flags in `flags` (N,) as an array (R, 2): the index of the first flag
    of each run, and the index after the last flag.
    """
    padded = np.zeros(len(flags) + 2, np.int8)
    padded[1:-1] = flags
    return np.flatnonzero(np.diff(padded)).reshape(-1, 2)
