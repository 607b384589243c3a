"""Signals of one number, and the four wheels: scale and offset taken out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.compensation.terms import ScalarTerms
from imucald.inputs.quantities import LIMITS

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


class ScalarCompensator:
    """Scale and offset of one number; limit: its largest plausible size in SI."""

    def __init__(self, terms: ScalarTerms, limit: float) -> None:
        self._offset, self._gain = terms.offset, 1.0 + terms.scale
        self._low, self._high = terms.rail
        self._limit = limit

    def one(self, t: float, v: Sequence[float]) -> Sequence[float] | None:
        """One sample; None where it is refused."""
        x = (v[0] - self._offset) / self._gain
        if self._low <= abs(v[0]) <= self._high or not -self._limit <= x <= self._limit:
            return None
        return (x,)

    def columns(self, v: Array) -> tuple[Array, Flags]:
        """Samples (N,) as `one` has them, and which are refused."""
        x = (v - self._offset) / self._gain
        size = np.abs(v)
        refused = ((self._low <= size) & (size <= self._high)) | ~(np.abs(x) <= self._limit)
        return x, refused


def wheels_one(scales: Sequence[float], v: Sequence[float]) -> Sequence[float] | None:
    """Four wheel speeds [m/s]; None where one cannot be."""
    found = [x / (1.0 + scale) for x, scale in zip(v, scales, strict=True)]
    return found if all(abs(x) <= LIMITS["speed"] for x in found) else None


def wheels_column(scales: Sequence[float], v: Array) -> tuple[Array, Flags]:
    """The same of (N, 4)."""
    found = v / (1.0 + np.array(scales))
    return found, ~(np.abs(found).max(axis=1, initial=0.0) <= LIMITS["speed"])
