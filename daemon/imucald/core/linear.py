"""Solutions and inverses of linear systems, as arrays of floats for the type checker."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def solved(matrix: Array, right: Array) -> Array:
    """Return x (..., n, k) or (n,) with matrix x = right. Raises LinAlgError for a singular one."""
    return np.asarray(np.linalg.solve(matrix, right), dtype=float)


def inverse(matrix: Array) -> Array:
    """Return the inverse (..., n, n). Raises LinAlgError where the matrix is singular."""
    return np.asarray(np.linalg.inv(matrix), dtype=float)
