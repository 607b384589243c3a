"""Remove scale and offset from signals with one component and from the four wheel speeds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.core.samples import SPEED
from imucald.model_compensation.terms import ScalarTerms


class ScalarCompensator:
    """Removes scale error and offset from a signal with one component. limit: largest plausible
    absolute value, in SI."""

    def __init__(self, terms: ScalarTerms, limit: float) -> None:
        self._offset, self._gain = terms.offset, 1.0 + terms.scale
        self._low, self._high = terms.rail
        self._limit = limit

    def sample(self, t: float, v: Sequence[float]) -> Sequence[float] | None:
        """Correct one sample; None if it is refused."""
        x, refused = self.columns(v[0])
        return None if refused else (x,)

    def columns(self, v: Any) -> tuple[Any, Any]:
        """Correct samples (N,), or one number. Returns the results and flags of the refused
        samples."""
        x, size = (v - self._offset) / self._gain, abs(v)
        on_rail = (self._low <= size) & (size <= self._high)
        return x, on_rail | (abs(x) > self._limit) | (x != x)  # noqa: PLR0124


class WheelsCompensator:
    """Removes the scale errors of four wheel speeds [m/s]."""

    def __init__(self, scales: Sequence[float]) -> None:
        self._gains = [1.0 + scale for scale in scales]

    def sample(self, t: float, v: Sequence[float]) -> Sequence[float] | None:
        """Correct one sample (4,); None if one of its speeds is implausible."""
        found = [x / gain for x, gain in zip(v, self._gains, strict=True)]
        return found if all(abs(x) <= SPEED.largest for x in found) else None

    def columns(self, v: Array) -> tuple[Array, Flags]:
        """Correct samples (N, 4) as `sample` does. Returns the results and flags (N,) of the
        refused samples."""
        found = v / np.array(self._gains)
        return found, ~(np.abs(found).max(axis=1, initial=0.0) <= SPEED.largest)
