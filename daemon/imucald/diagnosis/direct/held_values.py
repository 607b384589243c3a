"""Find a value within a sensor's range that the sensor shows far more often than the neighbouring
values.

Causes are a dead zone, a default value that is sent without a measurement, or missing codes of a
converter. Such a sensor does not show the true motion, and no parameter describes its error.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.stats import binom

from imucald.core.arrays import Array
from imucald.core.samples import QUANTITIES
from imucald.diagnosis.fit.chance import Answer
from imucald.diagnosis.signals import DriveSignals

SENSORS = ("accel", "gyro")
MOVING_MPS = 2.0
BESIDE = 3
"""Smallest number of neighbouring levels on each side of a value. The value is compared with the
most frequent of these levels."""
WINDOW, LEAST_WINDOWS = 100, 10
"""Number of samples in a window for the noise, which gives the noise to 10 %; smallest number of
windows."""
QUIETEST = 0.1
"""Quantile of the windows' noise that is used as the noise of the sensor."""
CHANCE = 0.01
LEAST_ROWS = 300


def held_values(drives: Sequence[DriveSignals]) -> Iterator[Answer]:
    """Yield the values that a sensor holds. A signal is reported once, for its first drive."""
    found: dict[str, Answer] = {}
    for drive in drives:
        for name in SENSORS:
            if drive.has(name):
                for one in _of_sensor(name, drive, len(drives)):
                    found.setdefault(one.signal, one)
    return iter(found.values())


def _of_sensor(name: str, drive: DriveSignals, drives: int) -> Iterator[Answer]:
    channel = drive.channels[name]
    moving = np.interp(channel.t, drive.knots.t, np.abs(drive.knots.values)) > MOVING_MPS
    table = channel.values[moving]
    if len(table) < LEAST_ROWS:
        return
    # A complete repeat of the frame before is another fault.
    fresh = np.ones(len(table), dtype=bool)
    fresh[1:] = (np.diff(table, axis=0) != 0.0).any(axis=1)
    table = table[fresh]
    questions = len(SENSORS) * 3 * drives
    for axis in range(table.shape[1]):
        held = _held(table[:, axis], questions)
        if held is None:
            continue
        value, share, times = held
        unit = QUANTITIES[name].unit
        text = (
            f"it shows {value:.3g} {unit} in {100.0 * share:.2g} % of its samples while "
            f"driving, {times:.0f} times as often as any neighbouring value: at this value, "
            "it does not follow the motion"
        )
        yield Answer(f"{name}_{'xyz'[axis]}", times, 1.0, CHANCE, text)


def _held(x: Array, questions: int) -> tuple[float, float, float] | None:
    """Return a value, its share of the samples, and the ratio of its frequency to the frequency of
    its neighbours; None if no value is too frequent.

    Gaussian noise with deviation s smooths every distribution, so the density f of the values obeys
    f(0) <= exp(d^2/2s^2) (f(-d) + f(d))/2, because cosh is at least 1. Consider only the samples on
    one level and on the most frequent level at distance d. At most the share e/(1 + e) of these
    samples is on the first level, with e = exp(d^2/2s^2).
    """
    levels, counts = np.unique(x, return_counts=True)
    if len(levels) < 4 * BESIDE:
        return None
    at = int(np.argmax(counts))
    value, count = levels[at], int(counts[at])
    # Unused codes leave gaps; no two levels are closer than one code.
    width = float(np.quantile(np.diff(levels), 0.1))
    noise = noise_about(x, float(value))
    # Readings that were rotated after rounding lie in clusters narrower than the noise.
    near = np.abs(levels - value) <= max((BESIDE + 0.5) * width, noise)
    near[at] = False
    if noise == 0.0 or not near.any():
        return None
    fullest = int(np.argmax(np.where(near, counts, 0)))
    more = float(np.exp(0.5 * min(abs(levels[fullest] - value) / noise, 30.0) ** 2))
    beside = int(counts[fullest])
    # Visits are counted, because a sensor that hardly moves stays at any value for some samples.
    visits = int((np.diff((x == value).astype(int)) == 1).sum())
    chance = CHANCE / (questions * len(levels))
    if binom.sf(visits - 1, visits + beside, more / (1.0 + more)) >= chance:
        return None
    return float(value) + 0.0, count / len(x), count / max(beside, 1)


def noise_about(x: Array, value: float = np.nan) -> float:
    """Return the noise of a sensor in its quietest windows, from differences of successive samples.
    0 if too few samples differ from `value`. A difference contains the noise twice."""
    steps = np.diff(x) ** 2 / 2.0
    away = (x[1:] != value) & (x[:-1] != value)
    size = len(steps) // WINDOW * WINDOW
    there = away[:size].reshape(-1, WINDOW).sum(axis=1)
    sums = (steps * away)[:size].reshape(-1, WINDOW).sum(axis=1)
    full = there > WINDOW // 2
    if full.sum() >= LEAST_WINDOWS:
        return float(np.sqrt(np.quantile(sums[full] / there[full], QUIETEST)))
    return float(np.sqrt(steps[away].mean())) if away.sum() >= LEAST_ROWS else 0.0
