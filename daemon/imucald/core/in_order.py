"""Sums from left to right: numpy takes longer ones in pairs, and a library's products as it likes.

The compiled part takes them in the same order, and so gives the same bits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def summed_in_order(terms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over the last dimension of terms (..., n), n > 0."""
    total: NDArray[np.float64] = terms[..., 0].copy()
    for k in range(1, terms.shape[-1]):
        total += terms[..., k]
    return total
