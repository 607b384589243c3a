"""Samples of one tap on a chunk, and triads put together from several frames."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.inputs.taps import Tap

MAX_SKEW = 0.1
"""Parts of a triad from different frames belong together within this [s]: one tick."""


class TapSamples(Struct, frozen=True, eq=False):
    """What one tap gave on a chunk: times, rows, values (N, k) or (N,), codes."""

    tap: Tap
    t: NDArray[np.float64]
    row: NDArray[np.int64]
    values: NDArray[np.float64]
    codes: NDArray[np.int8]

    def take(self, keep: NDArray[np.bool_] | NDArray[np.intp]) -> TapSamples:
        """Return the chosen rows."""
        return TapSamples(
            self.tap, self.t[keep], self.row[keep], self.values[keep], self.codes[keep]
        )

    def merged(self, other: TapSamples) -> TapSamples:
        """Return both, in the order of rows; at equal rows this one comes first."""
        row = np.concatenate([self.row, other.row])
        order = np.argsort(row, kind="stable")
        return TapSamples(
            self.tap,
            np.concatenate([self.t, other.t])[order],
            row[order],
            np.concatenate([self.values, other.values])[order],
            np.concatenate([self.codes, other.codes])[order],
        )


class TriadAssembler:
    """Puts one sample (a triad, four wheel speeds) together from values of several frames.

    A value that comes again before the sample is whole begins the next one: a part was lost, or
    comes less often. So no part is older than a cycle of the others.
    """

    def __init__(self, width: int) -> None:
        self._values: list[float | None] = [None] * width
        self._times = [-math.inf] * width

    def add(
        self, t: float, slots: Sequence[int], values: Sequence[float] | None
    ) -> tuple[Sequence[float] | None, bool]:
        """Return (the whole triad or None, whether a rejected part made a sample invalid)."""
        if values is None:
            self._values = [None] * len(self._values)
            return None, True
        if any(self._values[slot] is not None for slot in slots):
            self._values = [None] * len(self._values)
        for slot, value in zip(slots, values, strict=True):
            self._values[slot] = value
            self._times[slot] = t
        for slot, time in enumerate(self._times):
            if t - time > MAX_SKEW:
                self._values[slot] = None
        whole = [v for v in self._values if v is not None]
        if len(whole) < len(self._values):
            return None, False
        self._values = [None] * len(self._values)
        return whole, False


def in_row_order(
    found: Iterable[TapSamples],
) -> list[tuple[int, Tap, float, Sequence[float], int]]:
    """Row, tap, time, values and code of every sample, in the order of rows, then of ranks."""
    events: list[tuple[int, Tap, float, Sequence[float], int]] = []
    for part in sorted(found, key=lambda p: p.tap.rank):
        values = part.values if part.values.ndim == 2 else part.values[:, None]
        events.extend(
            (row, part.tap, t, value, code)
            for row, t, value, code in zip(
                part.row.tolist(),
                part.t.tolist(),
                values.tolist(),
                part.codes.tolist(),
                strict=True,
            )
        )
    events.sort(key=lambda event: event[0])
    return events
