"""Ticks: what one tenth of a second of samples comes to, as one row of numbers.

Estimators run ten times a second on ticks; a tick holds sums over the samples that fell into it,
so a row costs a few additions per sample live (`TickAccumulator`) and a few `bincount` calls in
replay (`ticks_from_samples`). Both add in the same order, so they give the same bits.

A tick covers [k / 10, (k + 1) / 10) seconds of stream time. Every tick of a segment is emitted,
also an empty one: rows are a uniform 10 Hz grid. NaN marks what was not there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import Samples, Series

TICK_RATE = 10.0
"""Ticks per second [1/s]: ten times the bandwidth of vehicle motion, a tenth of an IMU's rate."""
TICK_S = 1.0 / TICK_RATE

TickRow = Sequence[float]
"""One row; the constants below index it."""

T = 0
"""End of the tick, stream time [s]."""
ACCEL_N = 1
"""Accelerometer samples in the tick; 0 where there is none (likewise the other *_N)."""
ACCEL_X, ACCEL_Y, ACCEL_Z = 2, 3, 4
"""Mean specific force, sensor axes [m/s^2]."""
ACCEL_XX, ACCEL_YY, ACCEL_ZZ = 5, 6, 7
"""Mean square specific force, sensor axes [(m/s^2)^2]."""
ACCEL_MIN_X, ACCEL_MIN_Y, ACCEL_MIN_Z = 8, 9, 10
ACCEL_MAX_X, ACCEL_MAX_Y, ACCEL_MAX_Z = 11, 12, 13
ACCEL_AGE = 14
"""Mean age of the samples at the end of the tick [s] (likewise the other *_AGE)."""
GYRO_N = 15
GYRO_X, GYRO_Y, GYRO_Z = 16, 17, 18
"""Mean angular rate, sensor axes [rad/s]."""
GYRO_AGE = 19
SPEED_N = 20
SPEED = 21
"""Mean speed [m/s]."""
SPEED_AGE = 22
STEERING_N = 23
STEERING = 24
"""Mean steering-wheel angle [rad]."""
YAW_RATE_N = 25
YAW_RATE = 26
"""Mean vehicle yaw rate [rad/s]."""
LATERAL_N = 27
LATERAL = 28
"""Mean vehicle lateral acceleration [m/s^2]."""
LONGITUDINAL_N = 29
LONGITUDINAL = 30
"""Mean vehicle longitudinal acceleration [m/s^2]."""
WHEELS_N = 31
WHEEL_SPREAD = 32
"""Mean over samples of fastest minus slowest wheel [m/s]."""
REVERSE = 33
"""Last value in the tick, 0 or 1 (likewise the four below, in their units)."""
BRAKE = 34
HEADING = 35
TEMPERATURE = 36
ACCEL_BAD = 37
"""Accelerometer samples that were rejected in the tick (damaged, saturated, not available)."""
GYRO_BAD = 38
SPEED_BAD = 39
COLUMNS = 40
"""Length of a row."""

NAN = math.nan

_MEANS: Mapping[str, tuple[int, int]] = {
    "steering": (STEERING_N, STEERING),
    "yaw_rate": (YAW_RATE_N, YAW_RATE),
    "lateral_accel": (LATERAL_N, LATERAL),
    "longitudinal_accel": (LONGITUDINAL_N, LONGITUDINAL),
}
_LASTS: Mapping[str, int] = {
    "reverse": REVERSE,
    "brake": BRAKE,
    "heading": HEADING,
    "temperature": TEMPERATURE,
}
_BAD: Mapping[str, int] = {"accel": ACCEL_BAD, "gyro": GYRO_BAD, "speed": SPEED_BAD}
_NEVER_NAN = (
    ACCEL_N, GYRO_N, SPEED_N, STEERING_N, YAW_RATE_N, LATERAL_N, LONGITUDINAL_N, WHEELS_N,
    ACCEL_BAD, GYRO_BAD, SPEED_BAD,
)  # fmt: skip
_EMPTY = [0.0 if i in _NEVER_NAN else NAN for i in range(COLUMNS)]


def tick_index(t: float) -> int:
    """Return the number of the tick that stream time t [s] falls into."""
    return math.floor(t * TICK_RATE)


class TickAccumulator:
    """Builds one tick from single samples; the live path.

    The caller adds samples of one tick (see `tick_index`), closes it, and goes on with the next.
    """

    def __init__(self) -> None:
        self._reset()

    def _reset(self) -> None:
        self._na = self._ng = self._nv = self._nw = 0
        self._a = [0.0] * 7  # x, y, z, xx, yy, zz, t
        self._low = [math.inf] * 3
        self._high = [-math.inf] * 3
        self._g = [0.0] * 4  # x, y, z, t
        self._v = [0.0] * 2  # speed, t
        self._w = 0.0
        self._means: dict[str, list[float]] = {}
        self._lasts: dict[str, float] = {}
        self._bad: dict[str, int] = {}

    def add_accel(self, t: float, x: float, y: float, z: float) -> None:
        """Add a specific force [m/s^2] in sensor axes at stream time t [s]."""
        self._na += 1
        a = self._a
        a[0] += x
        a[1] += y
        a[2] += z
        a[3] += x * x
        a[4] += y * y
        a[5] += z * z
        a[6] += t
        low, high = self._low, self._high
        for i, value in ((0, x), (1, y), (2, z)):
            if value < low[i]:
                low[i] = value
            if value > high[i]:
                high[i] = value

    def add_gyro(self, t: float, x: float, y: float, z: float) -> None:
        """Add an angular rate [rad/s] in sensor axes at stream time t [s]."""
        self._ng += 1
        g = self._g
        g[0] += x
        g[1] += y
        g[2] += z
        g[3] += t

    def add(self, channel: str, t: float, values: Sequence[float]) -> None:
        """Add a sample of any channel (see `samples`); those a tick does not hold are ignored."""
        if channel == "accel":
            self.add_accel(t, values[0], values[1], values[2])
        elif channel == "gyro":
            self.add_gyro(t, values[0], values[1], values[2])
        elif channel == "speed":
            self._nv += 1
            self._v[0] += values[0]
            self._v[1] += t
        elif channel in _MEANS:
            cell = self._means.setdefault(channel, [0.0, 0.0])
            cell[0] += 1.0
            cell[1] += values[0]
        elif channel in _LASTS:
            self._lasts[channel] = values[0]
        elif channel == "wheel_speeds":
            self._nw += 1
            self._w += max(values) - min(values)

    def reject(self, channel: str) -> None:
        """Count a rejected sample of a channel."""
        if channel in _BAD:
            self._bad[channel] = self._bad.get(channel, 0) + 1

    def close(self, k: int) -> list[float]:
        """Return the row of tick number k and begin an empty one."""
        row = list(_EMPTY)
        end = row[T] = (k + 1) / TICK_RATE
        if self._na:
            n = float(self._na)
            row[ACCEL_N] = n
            for i in range(6):
                row[ACCEL_X + i] = self._a[i] / n
            row[ACCEL_MIN_X : ACCEL_MIN_X + 3] = self._low
            row[ACCEL_MAX_X : ACCEL_MAX_X + 3] = self._high
            row[ACCEL_AGE] = end - self._a[6] / n
        if self._ng:
            n = float(self._ng)
            row[GYRO_N] = n
            for i in range(3):
                row[GYRO_X + i] = self._g[i] / n
            row[GYRO_AGE] = end - self._g[3] / n
        if self._nv:
            n = float(self._nv)
            row[SPEED_N] = n
            row[SPEED] = self._v[0] / n
            row[SPEED_AGE] = end - self._v[1] / n
        if self._nw:
            row[WHEELS_N] = float(self._nw)
            row[WHEEL_SPREAD] = self._w / float(self._nw)
        for channel, (count, total) in self._means.items():
            n_index, index = _MEANS[channel]
            row[n_index] = count
            row[index] = total / count
        for channel, value in self._lasts.items():
            row[_LASTS[channel]] = value
        for channel, n_bad in self._bad.items():
            row[_BAD[channel]] = float(n_bad)
        self._reset()
        return row


def ticks_from_samples(
    samples: Samples,
    first: int,
    stop: int,
    rejected: Mapping[str, NDArray[np.float64]] | None = None,
) -> NDArray[np.float64]:
    """Return ticks first .. stop-1 as (stop - first, COLUMNS), from whole columns of samples.

    Samples outside those ticks are ignored. rejected: channel to times [s] of rejected samples.
    The result equals `TickAccumulator` on the same samples to the last bit.
    """
    n = stop - first
    out = np.tile(np.array(_EMPTY), (n, 1))
    if n <= 0:
        return out
    out[:, T] = (np.arange(first, stop) + 1) / TICK_RATE
    for channel, whole in samples.items():
        index, series = _within(whole, first, stop)
        if len(index):
            _fill(out, channel, index, series)
    for channel, times in (rejected or {}).items():
        if channel in _BAD:
            index = np.floor(times * TICK_RATE).astype(np.int64) - first
            index = index[(index >= 0) & (index < n)]
            out[:, _BAD[channel]] = np.bincount(index, minlength=n)
    return out


def _within(series: Series, first: int, stop: int) -> tuple[NDArray[np.int64], Series]:
    index = np.floor(series.t * TICK_RATE).astype(np.int64) - first
    keep = (index >= 0) & (index < stop - first)
    if keep.all():
        return index, series
    return index[keep], Series(series.t[keep], series.values[keep])


def _fill(out: NDArray[np.float64], channel: str, index: NDArray[np.int64], series: Series) -> None:
    n = len(out)
    values = series.values
    if channel in _LASTS:
        out[index, _LASTS[channel]] = values  # the last of repeated indices stays
        return
    if channel == "wheel_speeds":
        counts, has = _counts(index, n)
        out[:, WHEELS_N] = counts
        spread = values.max(axis=1) - values.min(axis=1)
        out[has, WHEEL_SPREAD] = np.bincount(index, spread, n)[has] / counts[has]
    elif channel in _MEANS:
        n_index, column = _MEANS[channel]
        counts, has = _counts(index, n)
        out[:, n_index] = counts
        out[has, column] = np.bincount(index, values, n)[has] / counts[has]
    elif channel == "speed":
        counts, has = _counts(index, n)
        out[:, SPEED_N] = counts
        out[has, SPEED] = np.bincount(index, values, n)[has] / counts[has]
        _ages(out, SPEED_AGE, index, series.t, counts, has)
    elif channel == "gyro":
        counts, has = _counts(index, n)
        out[:, GYRO_N] = counts
        for i in range(3):
            out[has, GYRO_X + i] = np.bincount(index, values[:, i], n)[has] / counts[has]
        _ages(out, GYRO_AGE, index, series.t, counts, has)
    elif channel == "accel":
        counts, has = _counts(index, n)
        out[:, ACCEL_N] = counts
        order_starts = np.flatnonzero(np.diff(index, prepend=-1))
        for i in range(3):
            v = np.ascontiguousarray(values[:, i])
            out[has, ACCEL_X + i] = np.bincount(index, v, n)[has] / counts[has]
            out[has, ACCEL_XX + i] = np.bincount(index, v * v, n)[has] / counts[has]
            out[has, ACCEL_MIN_X + i] = np.minimum.reduceat(v, order_starts)
            out[has, ACCEL_MAX_X + i] = np.maximum.reduceat(v, order_starts)
        _ages(out, ACCEL_AGE, index, series.t, counts, has)


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
