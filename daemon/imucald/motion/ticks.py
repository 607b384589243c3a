"""Ticks: one row of numbers for the samples of a tenth of a second.

Estimators run ten times a second on ticks. A tick contains means and extremes of its samples. In
live operation, `TickAccumulator` adds sample by sample. In replay, `column_ticks` processes whole
columns. Live operation and replay add the samples in the same order, so the results are bit-equal.

A tick covers [k / 10, (k + 1) / 10) seconds of stream time. Every tick of a segment has a row, even
a tick without samples. The rows are therefore a uniform 10 Hz grid. NaN marks missing values.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.core import samples

TICK_RATE = 10.0
"""Ticks per second [1/s]: ten times the bandwidth of vehicle motion, and a tenth of an IMU's sample
rate.
"""
TICK_S = 1.0 / TICK_RATE

TickRow = Sequence[float]
"""One row of a tick. The constants below are the indices of its values."""


class SignalColumns(NamedTuple):
    """Columns of a signal: number of samples in the tick (0: no samples), and mean of the
    samples."""

    n: int
    mean: int


class SpeedColumns(NamedTuple):
    """Columns of the speed: number of samples, mean, mean age of the samples at the end of the tick
    [s], number of rejected samples.
    """

    n: int
    mean: int
    age: int
    bad: int


class GyroColumns(NamedTuple):
    """Columns of the gyroscope: number of samples, mean angular rate [rad/s] in sensor axes, mean
    age of the samples at the end of the tick [s], number of rejected samples.
    """

    n: int
    x: int
    y: int
    z: int
    age: int
    bad: int


class AccelColumns(NamedTuple):
    """Columns of the accelerometer: number of samples, mean specific force [m/s^2] in sensor axes,
    and mean squares [(m/s^2)^2].

    Further columns: smallest and largest force [m/s^2], mean age of the samples at the end of the
    tick [s], number of rejected samples.
    """

    n: int
    x: int
    y: int
    z: int
    xx: int
    yy: int
    zz: int
    min_x: int
    min_y: int
    min_z: int
    max_x: int
    max_y: int
    max_z: int
    age: int
    bad: int


T = 0
"""End of the tick, stream time [s]."""
ACCEL = AccelColumns(*range(1, 16))
GYRO = GyroColumns(*range(16, 22))
SPEED = SpeedColumns(*range(22, 26))
"""Mean speed [m/s]."""
MEANS: Mapping[str, SignalColumns] = {
    channel: SignalColumns(SPEED.bad + 1 + 2 * i, SPEED.bad + 2 + 2 * i)
    for i, channel in enumerate(samples.VEHICLE_SIGNALS)
}
"""Signals whose mean is in a tick: [rad], [rad/s] and [m/s^2], positive to the left and forward."""
STEERING = MEANS[samples.STEERING.channel]
YAW_RATE = MEANS[samples.YAW_RATE.channel]
LATERAL_ACCEL = MEANS[samples.LATERAL_ACCEL.channel]
LONGITUDINAL_ACCEL = MEANS[samples.LONGITUDINAL_ACCEL.channel]
_AFTER_MEANS = SPEED.bad + 1 + 2 * len(MEANS)
WHEEL_SPREAD = SignalColumns(_AFTER_MEANS, _AFTER_MEANS + 1)
"""Mean over samples of the difference between fastest and slowest wheel [m/s]."""
LASTS: Mapping[str, int] = {
    row.channel: column
    for column, row in enumerate(
        (row for row in samples.QUANTITIES.values() if row.tick == "last"), _AFTER_MEANS + 2
    )
}
"""Signals whose last value is in a tick: 0 or 1, [degC], [rad]; NaN if there is none."""
REVERSE, BRAKE = LASTS[samples.REVERSE.channel], LASTS[samples.BRAKE.channel]
TEMPERATURE, HEADING = LASTS[samples.TEMPERATURE.channel], LASTS[samples.HEADING.channel]
COLUMNS = _AFTER_MEANS + 2 + len(LASTS)
"""Number of columns of a row."""

NAN = math.nan

BAD: Mapping[str, int] = {"accel": ACCEL.bad, "gyro": GYRO.bad, "speed": SPEED.bad}
"""Columns that count the samples rejected for their values.

A frame that is rejected as a whole is a hole, like a lost frame.
"""
_NEVER_NAN = (
    ACCEL.n, GYRO.n, SPEED.n, *(columns.n for columns in MEANS.values()), WHEEL_SPREAD.n,
    ACCEL.bad, GYRO.bad, SPEED.bad,
)  # fmt: skip
_EMPTY = [0.0 if i in _NEVER_NAN else NAN for i in range(COLUMNS)]


def empty_rows(n: int) -> NDArray[np.float64]:
    """Return rows of ticks without samples, (n, COLUMNS)."""
    return np.tile(np.array(_EMPTY), (n, 1))


_SENSORS = {"accel": slice(ACCEL.n, ACCEL.bad + 1), "gyro": slice(GYRO.n, GYRO.bad + 1)}


def emptied(row: TickRow, channels: Iterable[str]) -> TickRow:
    """Return the row without the values of the accelerometer or gyroscope. Only these two of the
    given channels are removed.
    """
    out = list(row)
    for channel in channels:
        if channel in _SENSORS:
            out[_SENSORS[channel]] = _EMPTY[_SENSORS[channel]]
    return out


def tick_index(t: float) -> int:
    """Return the number of the tick that contains stream time t [s]."""
    return math.floor(t * TICK_RATE)


class TickAccumulator:
    """Builds one tick from single samples, in live operation.

    The caller adds the samples of one tick (see `tick_index`), closes the tick, and continues with
    the next tick.
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

    def add_sample(self, channel: str, t: float, values: Sequence[float]) -> None:
        """Add a sample of any channel (see `samples`). Channels without a column in a tick are
        ignored.
        """
        if channel == "accel":
            self.add_accel(t, values[0], values[1], values[2])
        elif channel == "gyro":
            self.add_gyro(t, values[0], values[1], values[2])
        elif channel == "speed":
            self._nv += 1
            self._v[0] += values[0]
            self._v[1] += t
        elif channel in MEANS:
            cell = self._means.setdefault(channel, [0.0, 0.0])
            cell[0] += 1.0
            cell[1] += values[0]
        elif channel in LASTS:
            self._lasts[channel] = values[0]
        elif channel == "wheel_speeds":
            self._nw += 1
            self._w += max(values) - min(values)

    def reject(self, channel: str) -> None:
        """Count a rejected sample of a channel."""
        if channel in BAD:
            self._bad[channel] = self._bad.get(channel, 0) + 1

    def close(self, k: int) -> list[float]:
        """Return the row of tick number k and begin an empty tick."""
        row = list(_EMPTY)
        end = row[T] = (k + 1) / TICK_RATE
        if self._na:
            n = float(self._na)
            row[ACCEL.n] = n
            for i in range(6):
                row[ACCEL.x + i] = self._a[i] / n
            row[ACCEL.min_x : ACCEL.min_x + 3] = self._low
            row[ACCEL.max_x : ACCEL.max_x + 3] = self._high
            row[ACCEL.age] = end - self._a[6] / n
        if self._ng:
            n = float(self._ng)
            row[GYRO.n] = n
            for i in range(3):
                row[GYRO.x + i] = self._g[i] / n
            row[GYRO.age] = end - self._g[3] / n
        if self._nv:
            n = float(self._nv)
            row[SPEED.n] = n
            row[SPEED.mean] = self._v[0] / n
            row[SPEED.age] = end - self._v[1] / n
        if self._nw:
            row[WHEEL_SPREAD.n] = float(self._nw)
            row[WHEEL_SPREAD.mean] = self._w / float(self._nw)
        for channel, (count, total) in self._means.items():
            n_index, index = MEANS[channel]
            row[n_index] = count
            row[index] = total / count
        for channel, value in self._lasts.items():
            row[LASTS[channel]] = value
        for channel, n_bad in self._bad.items():
            row[BAD[channel]] = float(n_bad)
        self._reset()
        return row
