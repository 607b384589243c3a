"""Ticks from samples: one tick from single samples, in live operation, and ticks from whole columns
of samples, in replay."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import Samples, Series
from imucald.motion.ticks import (
    ACCEL,
    BAD,
    GYRO,
    LASTS,
    MEANS,
    SPEED,
    TICK_RATE,
    WHEEL_SPREAD,
    T,
    empty_rows,
)


def ticks_from_samples(
    samples: Samples,
    first: int,
    stop: int,
    rejected: Mapping[str, NDArray[np.float64]] | None = None,
) -> NDArray[np.float64]:
    """Return ticks first .. stop-1 as (stop - first, COLUMNS), from whole columns of samples.

    Samples outside these ticks are ignored. rejected: for each channel, times [s] of samples that
    were rejected for their values.
    """
    n = max(stop - first, 0)
    out = empty_rows(n)
    out[:, T] = (np.arange(first, first + n) + 1) / TICK_RATE
    for channel, series in samples.items():
        if channel in _COLUMNS or channel in LASTS:
            _fill(out, channel, series, first)
    for channel, times in (rejected or {}).items():
        if channel in BAD:
            index = np.floor(times * TICK_RATE).astype(np.int64) - first
            index = index[(index >= 0) & (index < n)]
            out[:, BAD[channel]] = np.bincount(index, minlength=n)
    return out


_COLUMNS: Mapping[str, tuple[int, int, int | None]] = {
    "accel": (ACCEL.n, ACCEL.x, ACCEL.age),
    "gyro": (GYRO.n, GYRO.x, GYRO.age),
    "speed": (SPEED.n, SPEED.mean, SPEED.age),
    "wheel_speeds": (*WHEEL_SPREAD, None),
    **{name: (*columns, None) for name, columns in MEANS.items()},
}
"""For each channel, the columns of count, first mean, and age."""


def _fill(out: NDArray[np.float64], channel: str, series: Series, first: int) -> None:
    """Write the samples of a channel to rows of ticks, the first of number `first`.

    A sum depends only on the samples of its tick: `np.bincount` adds in their order.
    """
    index = np.floor(series.t * TICK_RATE).astype(np.int64) - first
    part = slice(*np.searchsorted(index, (0, len(out))))
    index, t, values = index[part], series.t[part], series.values[part]
    if not len(index):
        return
    count = np.bincount(index, minlength=len(out))
    some = np.flatnonzero(count)
    begin, n = (np.cumsum(count) - count)[some], count[some]
    if channel in LASTS:
        out[some, LASTS[channel]] = values[begin + n - 1]
        return
    if channel == "wheel_speeds":
        values = values.max(axis=1) - values.min(axis=1)

    def mean(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.bincount(index, x, len(out))[some] / n

    at_count, at_mean, at_age = _COLUMNS[channel]
    out[some, at_count] = n
    for axis, x in enumerate(values.reshape(len(t), -1).T):
        out[some, at_mean + axis] = mean(x)
        if channel == "accel":
            out[some, ACCEL.xx + axis] = mean(x * x)
            out[some, ACCEL.min_x + axis] = np.minimum.reduceat(x, begin)
            out[some, ACCEL.max_x + axis] = np.maximum.reduceat(x, begin)
    if at_age is not None:
        out[some, at_age] = out[some, T] - mean(t)


class TickAccumulator:
    """Collects the samples of one tick, in live operation.

    The caller adds the samples of one tick (see `tick_index`), closes the tick, and continues with
    the next tick.
    """

    def __init__(self) -> None:
        self._samples: dict[str, tuple[list[float], list[Sequence[float]]]] = {}
        self._rejected: Counter[str] = Counter()

    def add_sample(self, channel: str, t: float, values: Sequence[float]) -> None:
        """Add a sample of any channel (see `samples`). Channels without a column in a tick are
        ignored."""
        times, rows = self._samples.setdefault(channel, ([], []))
        times.append(t)
        rows.append(values)

    def reject(self, channel: str) -> None:
        """Count a rejected sample of a channel."""
        self._rejected[channel] += 1

    def close(self, k: int) -> list[float]:
        """Return the row of tick number k and begin an empty tick."""
        samples = {}
        for channel, (times, rows) in self._samples.items():
            values = np.array(rows, dtype=float)
            values = values[:, 0] if values.shape[1] == 1 else values
            samples[channel] = Series(np.array(times), values)
        row: list[float] = ticks_from_samples(samples, k, k + 1)[0].tolist()
        for channel, count in self._rejected.items():
            if channel in BAD:
                row[BAD[channel]] = float(count)
        self._samples.clear()
        self._rejected.clear()
        return row
