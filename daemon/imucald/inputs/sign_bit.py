"""A sign bit that is in a different message than the magnitude."""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, Index
from imucald.inputs.column_samples import MAX_SKEW


class SignBit:
    """The last known sign of a magnitude: -1, 1, or NaN if it is unknown or too old.

    A sign is valid until one tick after the next frame of its message is due. source: key that
    identifies the bit. Single frames and columns give the same result: first call `begin_chunk`,
    then `see_columns`, then `at_columns`.
    """

    def __init__(self, source: Hashable) -> None:
        self.source = source
        self._cycle = 0.0
        self._last = -math.inf, math.nan
        self.begin_chunk()

    def expect(self, cycle: float | None) -> None:
        """Set the stated cycle of the message [s]."""
        self._cycle = cycle or 0.0

    def go_on_from(self, former: SignBit) -> None:
        """Continue with the last sign of `former`."""
        self._last = former._last

    def see(self, t: float, bit: float) -> None:
        """Register the bit of a frame at t [s]."""
        self._last = t, -1.0 if bit else 1.0

    def at(self, t: float) -> float:
        """Return the sign for a frame at t [s]."""
        seen, sign = self._last
        return sign if t - seen <= MAX_SKEW + self._cycle else math.nan

    def begin_chunk(self) -> None:
        """Begin a chunk of columns. Its rows are counted from 0."""
        self._chunk = np.array([self._last[0]]), np.array([self._last[1]]), np.zeros(0, np.int64)

    def see_columns(self, t: Array, row: Index, bit: NDArray[np.generic]) -> None:
        """Register the bits of all frames (N,) of the message in the chunk, in order."""
        if len(t):
            times, signs, _ = self._chunk
            signs = np.concatenate([signs, np.where(bit != 0, -1.0, 1.0)])
            self._chunk = np.concatenate([times, t]), signs, row
            self._last = float(t[-1]), float(signs[-1])

    def at_columns(self, t: Array, row: Index) -> Array:
        """Return the signs for frames (N,)."""
        times, signs, rows = self._chunk
        index = np.searchsorted(rows, row, side="right")
        return np.where(t - times[index] <= MAX_SKEW + self._cycle, signs[index], np.nan)
