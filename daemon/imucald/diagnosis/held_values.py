"""A value inside a sensor's range that it shows far oftener than those beside it.

A dead zone, a default that is sent where nothing was measured, a converter that has lost codes:
what such a sensor says between is not what it feels, and no parameter describes it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.stats import binom

from imucald.diagnosis.result import VALUE_HELD, Structure
from imucald.diagnosis.signals import Array, DriveSignals
from imucald.diagnosis.visits import PILE_RATIO, visited_too_often

SENSORS = ("accel", "gyro")
MOVING_MPS = 2.0
BESIDE = 3
"""Levels to each side, at least, of which the fullest is what a value is held against."""
FINE = 3.0
"""From sample to sample a sensor must move by so many of its levels: then each is as likely as the
next, whatever the vehicle does."""
CHANCE = 0.01
LEAST_ROWS = 300


def held_values(drives: Sequence[DriveSignals]) -> list[Structure]:
    """Sensors with a value that is held, of all drives."""
    found: dict[str, Structure] = {}
    for drive in drives:
        for name in SENSORS:
            if drive.has(name):
                for one in _of_sensor(name, drive, len(drives)):
                    found.setdefault(one.signal, one)
    return list(found.values())


def _of_sensor(name: str, drive: DriveSignals, drives: int) -> Iterator[Structure]:
    channel = drive.channels[name]
    moving = np.interp(channel.t, drive.knots.t, np.abs(drive.knots.values)) > MOVING_MPS
    table = channel.values[moving]
    if len(table) < LEAST_ROWS:
        return
    # A frame that repeats the whole one before it is another fault.
    fresh = np.ones(len(table), dtype=bool)
    fresh[1:] = (np.diff(table, axis=0) != 0.0).any(axis=1)
    table = table[fresh]
    questions = len(SENSORS) * 3 * drives
    for axis in range(table.shape[1]):
        held = _held(table[:, axis], questions)
        if held is None:
            continue
        value, share, times = held
        unit = "m/s^2" if name == "accel" else "rad/s"
        text = (
            f"it shows {value:.3g} {unit} in {100.0 * share:.2g} % of its samples while driving, "
            f"{times:.0f} times as often as any value beside it: what it shows between is not "
            "what it feels"
        )
        yield Structure(f"{name}_{'xyz'[axis]}", VALUE_HELD, times, text)


def _held(x: Array, questions: int) -> tuple[float, float, float] | None:
    """Value, its share of the samples, how many times as often as its neighbours; None without."""
    levels, counts = np.unique(x, return_counts=True)
    if len(levels) < 4 * BESIDE:
        return None
    at = int(np.argmax(counts))
    steps = np.abs(np.diff(x))
    value, count = levels[at], int(counts[at])
    width = float(np.median(np.diff(levels)))
    away = (x[1:] != value) & (x[:-1] != value)
    if not away.any() or float(np.median(steps[away])) < FINE * width:
        return None
    near = np.abs(levels - value) <= max(BESIDE * width, float(np.median(steps[away])))
    near[at] = False
    beside = int(counts[near].max()) if near.any() else 0
    chance = CHANCE / (questions * len(levels))
    is_there = x == value
    is_crowded = visited_too_often(is_there, beside, 1, chance)
    again = x[1:] == x[:-1]
    usual = min(PILE_RATIO * float(again[~is_there[:-1]].mean()) + 1.0 / len(x), 1.0)
    stays = int(again[is_there[:-1]].sum())
    is_kept = count > PILE_RATIO * beside and binom.sf(stays - 1, count, usual) < chance
    if not (is_crowded or is_kept):
        return None
    return float(value) + 0.0, count / len(x), count / max(beside, 1)
