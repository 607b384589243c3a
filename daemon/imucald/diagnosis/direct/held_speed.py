"""Find a speed signal that is constant although the inertial sensors show that the speed changes.

The speed is predicted from accelerometer and gyroscope. The residual contains noise and the effect
of the road. The size of this residual is about the same throughout a drive. If the speed signal
repeats an old value, the residual is as large as the hidden change of speed. The mount is not known
here. The relation between the speed and the three axes is therefore fitted to the drive. The fit
includes the rotation of gravity, which is computed from the gyroscope.
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
"""Smallest number of windows of the same length with which an interval is compared."""
APART = 4
"""Divisor of the window length: if a window contains a stop, the next window begins 1/APART of a
length later."""


def chances_of_sensors(samples: Samples, spans: Spans) -> Array:
    """Return the chance (S,) of the sensors' signals in each interval of constant speed, assuming
    that the true speed is constant. NaN if the sensors do not cover an interval.

    The logarithm of the interval's residual is compared with the residuals of windows of the same
    length in motion (Student's t distribution of one further value). No window contains part of
    another interval.
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
    """Return the time grid (N,), and on this grid the speed and its regressors (N, 1 + 3 or 6). The
    regressors are the integral of the force, and the double integral of the angular rate for the
    rotation of gravity."""
    speed, accel = samples["speed"], samples["accel"]
    t = np.arange(max(speed.t[0], accel.t[0]), min(speed.t[-1], accel.t[-1]), STEP_S)
    columns = [np.interp(t, speed.t, speed.values)[:, None], _integral(_means(accel, t))]
    if "gyro" in samples:
        columns.append(_integral(_integral(_means(samples["gyro"], t))))
    return t, np.concatenate(columns, axis=1)


def _means(series: Series, t: Array) -> Array:
    """Return means (N, width) over one grid step around each time."""
    rows = series.values.reshape(len(series.t), -1)
    steps = 0.5 * (rows[1:] + rows[:-1]) * np.diff(series.t)[:, None]
    area = np.concatenate([np.zeros_like(rows[:1]), np.cumsum(steps, axis=0)])
    ends = [np.interp(t[:, None] + [-0.5 * STEP_S, 0.5 * STEP_S], series.t, x) for x in area.T]
    return np.column_stack([(x[:, 1] - x[:, 0]) / STEP_S for x in ends])


def _integral(x: Array) -> Array:
    area = np.cumsum(0.5 * (x[1:] + x[:-1]), axis=0) * STEP_S
    return np.concatenate([np.zeros_like(x[:1]), area])


def _windows(t: Array, v: Array, n: int, spans: Spans) -> list[int]:
    """Return the first rows of consecutive windows of n rows in motion. No window contains part of
    an interval."""
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
    """Return the rows without mean and slope. Mean and slope contain the start value, and the
    effects of a zero error and of a constant road slope."""
    line = np.column_stack([np.ones(len(rows)), np.linspace(-1.0, 1.0, len(rows))])
    return np.asarray(rows - line @ np.linalg.lstsq(line, rows, rcond=None)[0])


def _left(windows: Array, own: Array) -> Array:
    """Return the rms residual (W + 1,) of the speed. The regression is fitted to the windows (W, n,
    P). The last residual belongs to the tested interval."""
    gram = np.einsum("wni,wnj->ij", windows, windows)
    ridge = 1e-9 * np.diag(np.diag(gram)[1:]) + 1e-30 * np.eye(len(gram) - 1)
    b = np.linalg.solve(gram[1:, 1:] + ridge, gram[1:, 0])
    rows = np.concatenate([windows, own])
    left = rows[:, :, 0] - rows[:, :, 1:] @ b
    return np.asarray(np.maximum(np.sqrt(np.mean(left**2, axis=1)), 1e-9))
