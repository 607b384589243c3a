"""Find the frames of a chunk that belong to each route."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, IdMatch
from imucald.core import compiled
from imucald.inputs.column_samples import rows_of

Rows = NDArray[np.int64]

_STANDARD = np.arange(2048, dtype=np.uint32)
_NONE, _SEVERAL = -1, -2
_MOST = 2**15 - 1
"""Largest number of routes in the compiled code."""


class RouteRows:
    """Finds the rows of every route. matches: the filters of the routes, in order."""

    def __init__(self, matches: Sequence[IdMatch]) -> None:
        self._matches = tuple(matches)
        self._is_simple = len(matches) <= _MOST and all(one.channel is None for one in matches)
        self._pairs = np.zeros((len(matches), 2), np.uint32)
        self._table = np.full(len(_STANDARD), _NONE, np.int16)
        for k, one in enumerate(matches):
            self._pairs[k] = one.can_id & one.full_mask, one.full_mask
            hit = (_STANDARD & self._pairs[k, 1]) == self._pairs[k, 0]
            self._table[hit] = np.where(self._table[hit] == _NONE, k, _SEVERAL)

    def of(self, frames: FrameColumns) -> tuple[list[Rows], bool]:
        """Return the rows of each route, and whether surely no frame belongs to several routes."""
        kernels = compiled.kernels
        if kernels is not None and self._is_simple:
            n = len(frames)
            rows, ends = np.empty(n, np.int64), np.empty(len(self._matches), np.int64)
            which = np.empty(n, np.int16)
            if not kernels.match_frames(frames.can_id, self._table, self._pairs, which, rows, ends):
                bounds = [0, *ends.tolist()]
                return [rows[a:b] for a, b in pairwise(bounds)], True
        return [rows_of(one, frames) for one in self._matches], False
