"""A table of samples that grows segment by segment. The rows of the table are never stored
twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

LEEWAY = 1.05
"""Number of reserved rows divided by the number of expected rows. Reserved memory uses no RAM until
it is written."""
MOST_TIMES = 64
"""Largest number of reserved rows divided by the number of present rows, because the expected
number of rows may be wrong at the beginning."""
SPARE = 2
"""A column is copied at the end if its reserved rows exceed its used rows by more than this
factor."""


class GrowingTable:
    """Columns of a table. Each is one array with space for the expected rows."""

    def __init__(self) -> None:
        self._columns: list[NDArray[Any]] = []
        self._room = 0
        self.rows = 0

    def add_rows(self, parts: Sequence[NDArray[Any]], share: float | None) -> None:
        """Add rows. parts: (n,) for each column. share: estimated share of all rows that is present
        after this call; None if not known."""
        before, self.rows = self.rows, self.rows + len(parts[0])
        if not self._columns or self.rows > self._room:
            self._grow(before, parts, share)
        for column, part in zip(self._columns, parts, strict=True):
            column[before : self.rows] = part

    def _grow(self, before: int, parts: Sequence[NDArray[Any]], share: float | None) -> None:
        expected = LEEWAY * self.rows / share if share else 0.0
        self._room = int(min(max(expected, self.rows, 2 * before), MOST_TIMES * self.rows))
        former = self._columns or [part[:0] for part in parts]
        self._columns = _side_by_side([column.dtype for column in former], self._room)
        for column, old in zip(self._columns, former, strict=True):
            column[:before] = old[:before]

    def columns(self) -> list[NDArray[Any]]:
        """Return the columns with the rows so far."""
        found = [column[: self.rows] for column in self._columns]
        return [one.copy() for one in found] if self._room > SPARE * self.rows else found


def _side_by_side(kinds: Sequence[np.dtype[Any]], rows: int) -> list[NDArray[Any]]:
    """Make empty columns. Columns of the same type share one array.

    The shared array is large, and numpy requests large memory pages for arrays from 4 MiB on. With
    large pages, the first write to an hour of samples takes a third of the time.
    """
    of_kind = {kind: iter(np.empty((kinds.count(kind), rows), kind)) for kind in set(kinds)}
    return [next(of_kind[kind]) for kind in kinds]
