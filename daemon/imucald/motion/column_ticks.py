"""Ticks from whole columns of samples: the version of `ticks` for replay, with bit-equal
results."""

from __future__ import annotations

from collections.abc import Mapping

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
    were rejected for their values. The result is bit-equal to the result of `TickAccumulator` for
    the same samples.
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

    `np.bincount` adds in the order of the samples, as `TickAccumulator` does.
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
