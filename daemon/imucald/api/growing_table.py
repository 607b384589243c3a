"""A table of samples that grows segment by segment, without its rows being kept twice."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

LEEWAY = 1.05
"""Room for so many times the rows that are expected: memory that is never touched is free."""
MOST_TIMES = 64
"""Room for no more than so many times the rows so far: what comes may be other than what came."""
SPARE = 2
"""A column of more than so many times its rows is copied at the end."""


class GrowingTable:
    """Columns, each in one array with room for the rows that are expected."""

    def __init__(self) -> None:
        self._columns: list[NDArray[Any]] = []
        self._room = 0
        self.rows = 0

    def add(self, parts: Sequence[NDArray[Any]], share: float | None) -> None:
        """Add rows: of each column a part (n,). share: of all rows, as far as anyone knows."""
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
    """Empty columns, those of one type in one array: numpy asks for large pages from 4 MiB on.

    To touch an hour of samples for the first time takes a third of the time then.
    """
    of_kind = {kind: iter(np.empty((kinds.count(kind), rows), kind)) for kind in set(kinds)}
    return [next(of_kind[kind]) for kind in kinds]
