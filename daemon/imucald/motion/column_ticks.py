"""Ticks of whole columns of samples: the replay's half of `ticks`, to the last bit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from imucald.core import compiled
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

    Samples outside those ticks are ignored. rejected: channel to times [s] of samples rejected for
    their values.
    The result equals `TickAccumulator` on the same samples to the last bit.
    """
    n = stop - first
    out = empty_rows(n)
    if n <= 0:
        return out
    out[:, T] = (np.arange(first, stop) + 1) / TICK_RATE
    for channel, whole in samples.items():
        if _fill_compiled(out, channel, first, whole):
            continue
        index, series = _within(whole, first, stop)
        if len(index):
            _fill(out, channel, index, series)
    for channel, times in (rejected or {}).items():
        if channel in BAD:
            index = np.floor(times * TICK_RATE).astype(np.int64) - first
            index = index[(index >= 0) & (index < n)]
            out[:, BAD[channel]] = np.bincount(index, minlength=n)
    return out


_PLACES: Mapping[str, NDArray[np.int64]] = {
    name: np.array(columns)
    for name, columns in {
        "accel": (ACCEL.n, ACCEL.x, ACCEL.xx, ACCEL.min_x, ACCEL.max_x, ACCEL.age),
        "gyro": (GYRO.n, GYRO.x, -1, -1, -1, GYRO.age),
        "speed": (SPEED.n, SPEED.mean, -1, -1, -1, SPEED.age),
        "wheel_speeds": (WHEEL_SPREAD.n, WHEEL_SPREAD.mean, -1, -1, -1, -1),
        **{name: (*columns, -1, -1, -1, -1) for name, columns in MEANS.items()},
    }.items()
}
"""By channel the columns of count, first mean, mean square, least, largest and age; -1: none."""


def _fill_compiled(out: NDArray[np.float64], channel: str, first: int, series: Series) -> bool:
    """Fill a channel's columns by the compiled part; whether it could."""
    places = _PLACES.get(channel)
    if compiled.kernels is None or places is None:
        return False
    values = series.values
    if channel == "wheel_speeds":
        values = values.max(axis=1) - values.min(axis=1)
    values = values[:, None] if values.ndim == 1 else values[:, :3]
    taken = compiled.kernels.tick_sums(series.t, values, places, first, TICK_RATE, out)
    return taken == 0


def _within(series: Series, first: int, stop: int) -> tuple[NDArray[np.int64], Series]:
    index = np.floor(series.t * TICK_RATE).astype(np.int64) - first
    keep = (index >= 0) & (index < stop - first)
    if keep.all():
        return index, series
    return index[keep], Series(series.t[keep], series.values[keep])


def _fill(out: NDArray[np.float64], channel: str, index: NDArray[np.int64], series: Series) -> None:
    n = len(out)
    values = series.values
    if channel in LASTS:
        out[index, LASTS[channel]] = values  # the last of repeated indices stays
        return
    if channel == "wheel_speeds":
        counts, has = _counts(index, n)
        out[:, WHEEL_SPREAD.n] = counts
        spread = values.max(axis=1) - values.min(axis=1)
        out[has, WHEEL_SPREAD.mean] = np.bincount(index, spread, n)[has] / counts[has]
    elif channel in MEANS:
        n_index, column = MEANS[channel]
        counts, has = _counts(index, n)
        out[:, n_index] = counts
        out[has, column] = np.bincount(index, values, n)[has] / counts[has]
    elif channel == "speed":
        counts, has = _counts(index, n)
        out[:, SPEED.n] = counts
        out[has, SPEED.mean] = np.bincount(index, values, n)[has] / counts[has]
        _ages(out, SPEED.age, index, series.t, counts, has)
    elif channel == "gyro":
        counts, has = _counts(index, n)
        out[:, GYRO.n] = counts
        for i in range(3):
            out[has, GYRO.x + i] = np.bincount(index, values[:, i], n)[has] / counts[has]
        _ages(out, GYRO.age, index, series.t, counts, has)
    elif channel == "accel":
        counts, has = _counts(index, n)
        out[:, ACCEL.n] = counts
        order_starts = np.flatnonzero(np.diff(index, prepend=-1))
        for i in range(3):
            v = np.ascontiguousarray(values[:, i])
            out[has, ACCEL.x + i] = np.bincount(index, v, n)[has] / counts[has]
            out[has, ACCEL.xx + i] = np.bincount(index, v * v, n)[has] / counts[has]
            out[has, ACCEL.min_x + i] = np.minimum.reduceat(v, order_starts)
            out[has, ACCEL.max_x + i] = np.maximum.reduceat(v, order_starts)
        _ages(out, ACCEL.age, index, series.t, counts, has)


def _counts(index: NDArray[np.int64], n: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    counts = np.bincount(index, minlength=n).astype(np.float64)
    return counts, counts > 0


def _ages(
    out: NDArray[np.float64],
    column: int,
    index: NDArray[np.int64],
    t: NDArray[np.float64],
    counts: NDArray[np.float64],
    has: NDArray[np.bool_],
) -> None:
    mean_time = np.bincount(index, t, len(out))[has] / counts[has]
    out[has, column] = out[has, T] - mean_time
