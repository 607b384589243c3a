"""How well a log by itself knows the direction of forward, without the estimator.

The level force is fitted by least squares on dv/dt, v r and a constant, at the delay of the speed
that leaves least over, all smoothed the same; the direction in which it answers to dv/dt is
forward. Its deviation is that of the spread of the scores over pieces of 25 s (sandwich;
White, Econometrica 48, 1980). Gravity is the mean force: slopes stay in what is left over, and
nothing is known of the sensor's own errors. So an estimator may know somewhat more by its
gyroscope, and must state more.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter1d

from benchmarks.public_logs.frames import Array
from imucald.core.samples import Samples, Series
from imucald.diagnosis.recording import read_samples
from imucald.runtime.session import open_config

TICK = 0.1
DELAYS = np.arange(-6, 25)
"""Of the speed, tried [ticks]."""
SMOOTH = (5.0, 10.0, 15.0, 25.0)
"""Widths tried [ticks]; the best is shown."""
PIECE = 250
SLOW = 80.0
"""What is slower than that [ticks] is taken off force and motion: slopes."""


def known_by_itself(folder: Path) -> Iterator[str]:
    """Lines: deviation of yaw, with the delay and the gain of the speed that go with it."""
    recording = read_samples(open_config(folder / "right.yaml"), [folder / "drive.log"])
    if not {"accel", "speed"} <= recording.samples.keys():
        yield "no accelerometer, or no speed"
        return
    std, delay, gain, _ = min(fitted(recording.samples, width) for width in SMOOTH)
    yield f"yaw to {std:.2f} deg at best, speed {delay:+.1f} s late, gain {gain:.2f}"


def fitted(samples: Samples, width: float) -> tuple[float, float, float, float]:
    """Deviation of yaw [deg], delay [s] and gain of the speed, and yaw [deg] in level axes.

    width: of the smoothing of all signals [ticks].
    """
    accel, speed = samples["accel"], samples["speed"]
    t = np.arange(max(accel.t[0], speed.t[0]) + 1.0, min(accel.t[-1], speed.t[-1]) - 1.0, TICK)
    force = _even(accel, t)
    up = force.mean(axis=0) / np.linalg.norm(force.mean(axis=0))
    level = np.linalg.svd(up[None])[2][1:]
    v = np.interp(t, speed.t, speed.values)
    dvdt = np.gradient(gaussian_filter1d(v, width), TICK)
    rate = _even(samples["gyro"], t) @ up if "gyro" in samples else np.zeros(len(t))
    rate -= np.median(rate)
    y = _without_slow(gaussian_filter1d(force @ level.T, width, axis=0))
    best = (np.inf, 0, np.zeros((0, 2)), y, y)
    for delay in DELAYS.tolist():
        columns = [np.roll(dvdt, -delay)]
        if rate.any():
            columns.append(gaussian_filter1d(np.roll(v, -delay) * rate, width))
        x = _without_slow(np.stack(columns, axis=1))
        answer = np.linalg.lstsq(x, y, rcond=None)[0]
        left = y - x @ answer
        if (power := float((left * left).sum())) < best[0]:
            best = (power, delay, answer, x, left)
    _, delay, answer, x, left = best
    gain = float(np.hypot(*answer[0]))
    across = left @ np.array([-answer[0, 1], answer[0, 0]]) / gain
    scores = np.add.reduceat(x * across[:, None], np.arange(0, len(x), PIECE))
    inverse = np.linalg.inv(x.T @ x)
    variance = float((inverse @ scores.T @ scores @ inverse)[0, 0])
    yaw = float(np.degrees(np.arctan2(answer[0, 1], answer[0, 0])))
    return float(np.degrees(np.sqrt(variance) / gain)), delay * TICK, gain, yaw


def _even(series: Series, t: Array) -> Array:
    """Values (N, 3) at even times: means of samples about each, or lines between them."""
    n = max(round(TICK / float(np.median(np.diff(series.t)))), 1)
    of = np.stack([np.convolve(column, np.ones(n) / n, "same") for column in series.values.T])
    return np.stack([np.interp(t, series.t, column) for column in of], axis=1)


def _without_slow(x: Array) -> Array:
    """Columns (N, k) less what is slow in them, ends left out where shifted signals wrap."""
    edge = int(max(abs(DELAYS)))
    out: Array = (x - gaussian_filter1d(x, SLOW, axis=0))[edge:-edge]
    return out
