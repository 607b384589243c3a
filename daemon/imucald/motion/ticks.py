"""Ticks: one row of numbers for the samples of a tenth of a second.

Estimators run ten times a second on ticks. A tick contains means and extremes of its samples. In
live operation, a tick is made when it is over; in replay, many ticks are made together
(`column_ticks`).

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

BAD: Mapping[str, int] = {"accel": ACCEL.bad, "gyro": GYRO.bad, "speed": SPEED.bad}
"""Columns that count the samples rejected for their values.

A frame that is rejected as a whole is a hole, like a lost frame.
"""
_NEVER_NAN = (
    ACCEL.n, GYRO.n, SPEED.n, *(columns.n for columns in MEANS.values()), WHEEL_SPREAD.n,
    ACCEL.bad, GYRO.bad, SPEED.bad,
)  # fmt: skip
_EMPTY = [0.0 if i in _NEVER_NAN else math.nan for i in range(COLUMNS)]


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
