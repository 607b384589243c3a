"""Ticks from whole columns of samples: the version of `ticks` for replay, with bit-equal
results."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from imucald.core import compiled
from imucald.core.samples import Samples
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
    TickAccumulator,
    empty_rows,
    tick_index,
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
    n = stop - first
    if n <= 0:
        return empty_rows(0)
    out = _by_kernel(samples, first, n)
    if out is None:
        out = _one_by_one(samples, first, n)
    for channel, times in (rejected or {}).items():
        if channel in BAD:
            index = np.floor(times * TICK_RATE).astype(np.int64) - first
            index = index[(index >= 0) & (index < n)]
            out[:, BAD[channel]] = np.bincount(index, minlength=n)
    return out


_PLACES: Mapping[str, NDArray[np.int64]] = {
    name: np.array(columns)
    for name, columns in {
        "accel": (ACCEL.n, ACCEL.x, ACCEL.xx, ACCEL.min_x, ACCEL.max_x, ACCEL.age, -1),
        "gyro": (GYRO.n, GYRO.x, -1, -1, -1, GYRO.age, -1),
        "speed": (SPEED.n, SPEED.mean, -1, -1, -1, SPEED.age, -1),
        "wheel_speeds": (WHEEL_SPREAD.n, WHEEL_SPREAD.mean, -1, -1, -1, -1, -1),
        **{name: (*columns, -1, -1, -1, -1, -1) for name, columns in MEANS.items()},
        **{name: (-1, -1, -1, -1, -1, -1, column) for name, column in LASTS.items()},
    }.items()
}
"""For each channel, the columns of count, first mean, first mean square, first smallest value,
first largest value, age, and last value; -1: no such column.
"""


def _rows(first: int, n: int) -> NDArray[np.float64]:
    rows = empty_rows(n)
    rows[:, T] = (np.arange(first, first + n) + 1) / TICK_RATE
    return rows


def _by_kernel(samples: Samples, first: int, n: int) -> NDArray[np.float64] | None:
    """Return the rows from the compiled code; None if it is missing or times decrease."""
    if compiled.kernels is None:
        return None
    out = _rows(first, n)
    for channel, series in samples.items():
        if channel not in _PLACES:
            continue
        values, places = series.values, _PLACES[channel]
        if channel == "wheel_speeds":
            values = values.max(axis=1) - values.min(axis=1)
        values = values[:, None] if values.ndim == 1 else values[:, :3]
        if compiled.kernels.tick_sums(series.t, values, places, first, TICK_RATE, out):
            return None
    return out


def _one_by_one(samples: Samples, first: int, n: int) -> NDArray[np.float64]:
    ticks: dict[int, TickAccumulator] = {}
    for channel, series in samples.items():
        values = series.values[:, None] if series.values.ndim == 1 else series.values
        for t, sample in zip(series.t.tolist(), values.tolist(), strict=True):
            k = tick_index(t)
            if first <= k < first + n:
                ticks.setdefault(k, TickAccumulator()).add_sample(channel, t, sample)
    out = _rows(first, n)
    for k, tick in ticks.items():
        out[k - first] = tick.close(k)
    return out
