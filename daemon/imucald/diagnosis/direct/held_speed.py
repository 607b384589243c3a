"""A speed that does not change while the sensors say that it does.

What is left of a speed after what the accelerometer and the gyroscope say of its changes is noise
and the road, and is of one size all along a drive. Where the speed is held instead of measured, it
is as large as the change that is hidden. Nothing is known of the mount: how the speed goes with the
three axes, and with the gravity that the gyroscope turns into them, is fitted to the drive itself.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.core.samples import Samples, Series
from imucald.diagnosis.signals import Spans

STEP_S = 0.2
MOVING_MPS = 2.0
LEAST_WINDOWS = 8
"""Of the same length, to hold a span against."""
APART = 4
"""A window that falls into a stop is tried again this share of its length later."""


def chances_of_sensors(samples: Samples, spans: Spans) -> Array:
    """(S,) chance of what the sensors say in each span in which the speed stays, if it does so by
    itself; none is held against another. NaN where the sensors do not cover it.

    The logarithm of what is left, against that of windows of the same length in motion: Student's t
    for one more of a sample.
    """
    made = np.full(len(spans), np.nan)
    if not spans or "accel" not in samples:
        return made
    t, signals = _signals(samples)
    for k, (low, high) in enumerate(spans):
        n = round((high - low) / STEP_S)
        first = int(np.searchsorted(t, low))
        if not len(t) or low < t[0] - STEP_S or first + n > len(t):
            continue
        starts = _windows(t, signals[:, 0], n, spans)
        if len(starts) < LEAST_WINDOWS or n < 2 * signals.shape[1]:
            continue
        windows = np.array([_detrended(signals[i : i + n]) for i in starts])
        own = _detrended(signals[first : first + n])
        left = _left(windows, own[None])
        usual, here = np.log(left[:-1]), float(np.log(left[-1]))
        spread = float(np.std(usual, ddof=1)) * np.sqrt(1.0 + 1.0 / len(usual))
        made[k] = student.sf((here - usual.mean()) / max(spread, 1e-12), len(usual) - 1)
    return made


def _signals(samples: Samples) -> tuple[Array, Array]:
    """Grid (N,), and the speed on it with what it may go with (N, 1 + 3 or 6): integral of the
    force, and that of the gravity which the gyroscope turns, twice integrated."""
    speed, accel = samples["speed"], samples["accel"]
    t = np.arange(max(speed.t[0], accel.t[0]), min(speed.t[-1], accel.t[-1]), STEP_S)
    columns = [np.interp(t, speed.t, speed.values)[:, None], _integral(_means(accel, t))]
    if "gyro" in samples:
        columns.append(_integral(_integral(_means(samples["gyro"], t))))
    return t, np.concatenate(columns, axis=1)


def _means(series: Series, t: Array) -> Array:
    """(N, width) over the grid's step about each time."""
    rows = series.values.reshape(len(series.t), -1)
    steps = 0.5 * (rows[1:] + rows[:-1]) * np.diff(series.t)[:, None]
    area = np.concatenate([np.zeros_like(rows[:1]), np.cumsum(steps, axis=0)])
    ends = [np.interp(t[:, None] + [-0.5 * STEP_S, 0.5 * STEP_S], series.t, x) for x in area.T]
    return np.column_stack([(x[:, 1] - x[:, 0]) / STEP_S for x in ends])


def _integral(x: Array) -> Array:
    area = np.cumsum(0.5 * (x[1:] + x[:-1]), axis=0) * STEP_S
    return np.concatenate([np.zeros_like(x[:1]), area])


def _windows(t: Array, v: Array, n: int, spans: Spans) -> list[int]:
    """First rows of windows of n rows in motion, one after another, clear of the spans."""
    good = v > MOVING_MPS
    for low, high in spans:
        good &= (t < low) | (t > high)
    bad = np.concatenate([[0], np.cumsum(~good)])
    starts, i = [], 0
    while i + n <= len(t):
        is_clear = bad[i + n] == bad[i]
        if is_clear:
            starts.append(i)
        i += n if is_clear else max(n // APART, 1)
    return starts


def _detrended(rows: Array) -> Array:
    """Less mean and slope: where it starts, and what a zero and an even slope of the road add."""
    line = np.column_stack([np.ones(len(rows)), np.linspace(-1.0, 1.0, len(rows))])
    return np.asarray(rows - line @ np.linalg.lstsq(line, rows, rcond=None)[0])


def _left(windows: Array, own: Array) -> Array:
    """rms (W + 1,) of the speed less what fits it best in the windows (W, n, P); the span last."""
    gram = np.einsum("wni,wnj->ij", windows, windows)
    ridge = 1e-9 * np.diag(np.diag(gram)[1:]) + 1e-30 * np.eye(len(gram) - 1)
    b = np.linalg.solve(gram[1:, 1:] + ridge, gram[1:, 0])
    rows = np.concatenate([windows, own])
    left = rows[:, :, 0] - rows[:, :, 1:] @ b
    return np.asarray(np.maximum(np.sqrt(np.mean(left**2, axis=1)), 1e-9))
