"""Of several sources of one quantity, the first that is alive is selected."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

SOURCE_HOLD = 1.5
"""A less preferred source is selected when the preferred ones were silent this long [s]: longer
than the cycle of any vehicle speed, shorter than a manoeuvre."""

Times = NDArray[np.float64]
Rows = NDArray[np.int64]


class SourceSelector:
    """Selects among `n` sources by preference: rank 0 first. One without good samples is silent.

    Single samples go through `accept`. In a chunk of columns the order of all samples is that of
    their rows, and of ranks within one: `begin_chunk`, then each rank's samples, better ones
    first (`accept_columns`), or all of them in that order (`accept_row`).
    """

    def __init__(self, n: int) -> None:
        self._last = [-math.inf] * n
        self._before = list(self._last)
        self._chunk: list[list[tuple[Times, Rows]]] = [[] for _ in range(n)]

    def accept(self, t: float, rank: int) -> bool:
        """Take note of a sample at t [s]; whether its source is selected."""
        self._last[rank] = t
        return self.selects(t, rank)

    def selects(self, t: float, rank: int) -> bool:
        """Whether this source would be selected at t [s]."""
        return all(t - self._last[better] > SOURCE_HOLD for better in range(rank))

    def begin_chunk(self) -> None:
        """Columns follow, their rows counted from 0."""
        self._before = list(self._last)
        self._chunk = [[] for _ in self._last]

    def accept_row(self, t: float, row: int, rank: int) -> bool:
        """`accept` within a chunk."""
        self._chunk[rank].append((np.array([t]), np.array([row], np.int64)))
        return self.accept(t, rank)

    def accept_columns(self, t: Times, row: Rows, rank: int) -> NDArray[np.bool_]:
        """`accept` for all of a source's samples (N,) of the chunk, in order."""
        if len(t):
            self._chunk[rank].append((t, row))
            self._last[rank] = float(t[-1])
        return self.selects_columns(t, row, rank)

    def selects_columns(self, t: Times, row: Rows, rank: int) -> NDArray[np.bool_]:
        """`selects` at times (N,) and rows of the chunk, once it is whole."""
        selected = np.ones(len(t), dtype=bool)
        for better in range(rank):
            selected &= t - self._last_at(better, row) > SOURCE_HOLD
        return selected

    def _last_at(self, rank: int, row: Rows) -> Times:
        """Time of the source's last sample up to each row (N,)."""
        found = self._chunk[rank]
        if not found:
            return np.full(len(row), self._before[rank])
        if len(found) > 1:
            times, rows = (np.concatenate(column) for column in zip(*found, strict=True))
            self._chunk[rank] = found = [(times, rows)]
        times, rows = found[0]
        index = np.searchsorted(rows, row, side="right")
        last: Times = np.concatenate([[self._before[rank]], times])[index]
        return last
