"""Find single values of a sensor that are no measurement: lost readings, and values that it holds.

A lost reading is the value that a sensor outputs when a connector opens. A true signal reaches a
value through neighbouring values; a lost reading jumps to the invalid value and back from any other
value. A held value is one that the sensor shows far more often than the neighbouring values,
because of a dead zone, a default value, or missing codes of a converter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binom

from imucald.core.arrays import Array, true_runs
from imucald.core.samples import INERTIAL, QUANTITIES, Samples, Series
from imucald.diagnosis.cause_keys import TRIADS
from imucald.diagnosis.fit.chance import Answer
from imucald.diagnosis.result import Kind, Structure
from imucald.diagnosis.signals import CHANCE, DRIVING_MPS, DriveSignals, Mask

LEAST_ROWS = 100
RARE = 0.01
"""Largest share of a sensor's usual steps that may be as large as a jump."""
PASSES_HALF = 0.25
"""Share for the test of a value that is reached through its neighbours. When a signal comes within
half its usual distance of a value, it reaches the value in at most this share of the cases. The
reason is that the tails of a distribution with a finite variance fall faster than 1/x^2
(Chebyshev)."""
BESIDE = 3
"""Smallest number of neighbouring levels on each side of a value. The value is compared with the
most frequent of these levels."""
WINDOW, LEAST_WINDOWS = 100, 10
"""Number of samples in a window for the noise, which gives the noise to 10 %; smallest number of
windows."""
LEAST_SHOWN = 300


@dataclass(frozen=True)
class Lost:
    """Lost readings of one signal: the signal jumps to one value and back."""

    value: Array
    """Value (W,) of the lost readings, in sensor axes."""
    rows: Mask
    """Flags (N,): True for the lost readings."""
    visits: int

    def kept(self, series: Series) -> Series:
        """Return the readings that are not lost."""
        return Series(series.t[~self.rows], series.values[~self.rows])


def all_lost(samples: Samples) -> dict[str, Lost]:
    """Return the lost readings by signal, for the signals that have lost readings."""
    asked = [name for name in INERTIAL if name in samples and len(samples[name].t) >= LEAST_ROWS]
    found = {name: lost_readings(samples[name], len(asked)) for name in asked}
    return {name: lost for name, lost in found.items() if lost is not None}


def as_structure(name: str, lost: Lost) -> Structure:
    """Return the finding as a `Structure`, with a text and the number of visits to the value."""
    unit = QUANTITIES[name].unit
    value = " ".join(f"{x + 0.0:.3g}" for x in lost.value)
    text = (
        f"it jumps to {value} {unit} and back {lost.visits} times, from very different "
        "values: readings are lost (a loose contact, or a default value)"
    )
    signal = f"{name}_x" if len(lost.value) > 1 else name
    return Structure(signal, Kind.READINGS_LOST, float(lost.visits), text)


def lost_readings(series: Series, signals: int) -> Lost | None:
    """Find the value that a sensor shows when readings are lost; None without such a value.
    signals: number of tested signals."""
    table = series.values.reshape(len(series.t), -1)
    first = np.flatnonzero(np.concatenate([[True], (np.diff(table, axis=0) != 0.0).any(axis=1)]))
    if len(first) < 3:
        return None
    runs = table[first]
    size = np.linalg.norm(np.diff(runs, axis=0), axis=1)
    far = size > np.quantile(size, 1.0 - RARE)
    jumps = np.flatnonzero(far[:-1] & far[1:]) + 1
    if not len(jumps):
        return None
    ends = runs.min(), runs.max()
    if table.shape[1] == 1 and all((runs[jumps, 0] == end).sum() > 1 for end in ends):
        return None  # shocks beyond both ends of the range; lost readings have one value
    values, index = np.unique(runs[jumps], axis=0, return_inverse=True)
    counts = np.bincount(index.ravel())
    best = int(np.argmax(counts))
    value, jumped = values[best], int(counts[best])
    there = (runs == value).all(axis=1)
    visits = int(there.sum())
    # A step to the value and one back, each among the largest hundredth of all steps.
    if binom.sf(jumped - 1, visits, RARE) >= CHANCE / signals:
        return None
    away = np.linalg.norm(runs - value, axis=1)
    near = ~there & (away < 0.5 * float(np.median(size[jumps[index.ravel() == best] - 1])))
    passing = len(true_runs(near))
    if binom.sf(visits - 1, visits + passing, PASSES_HALF) >= CHANCE / signals:
        return None
    return Lost(value, (table == value).all(axis=1), visits)


def held_values(drives: Sequence[DriveSignals]) -> Iterator[Answer]:
    """Yield the values that a sensor holds and no found fault explains. A signal is reported once,
    for its first drive."""
    found: dict[str, Answer] = {}
    for drive in drives:
        for name in TRIADS:
            if drive.has(name):
                for one in _of_sensor(name, drive, len(drives)):
                    found.setdefault(one.signal, one)
    return iter(found.values())


def _of_sensor(name: str, drive: DriveSignals, drives: int) -> Iterator[Answer]:
    channel = drive.channels[name]
    moving = np.interp(channel.t, drive.knots.t, np.abs(drive.knots.values)) > DRIVING_MPS
    # A fault that was found, such as the end of a range, explains its own values.
    table = channel.values[moving & channel.good()]
    if len(table) < LEAST_SHOWN:
        return
    # A complete repeat of the frame before is another fault.
    fresh = np.ones(len(table), dtype=bool)
    fresh[1:] = (np.diff(table, axis=0) != 0.0).any(axis=1)
    table = table[fresh]
    questions = len(TRIADS) * 3 * drives
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
        return float(np.sqrt(np.quantile(sums[full] / there[full], 0.1)))
    return float(np.sqrt(steps[away].mean())) if away.sum() >= LEAST_SHOWN else 0.0
