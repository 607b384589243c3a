"""Find invalid readings: the value that a sensor outputs when a connector opens, or a default
value.

A true signal reaches a value through neighbouring values. A lost reading jumps to the invalid value
and back from any other value, without values in between.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binom

from imucald.core.arrays import Array, true_runs
from imucald.core.samples import INERTIAL, QUANTITIES, Samples, Series
from imucald.diagnosis.result import READINGS_LOST, Structure
from imucald.diagnosis.signals import Mask

LEAST_ROWS = 100
CHANCE = 0.01
"""Chance of a false finding in one drive. This chance is divided among the signals of the drive."""
RARE = 0.01
"""Largest share of a sensor's usual steps that may be as large as a jump."""
PASSES_HALF = 0.25
"""Share for the test of a value that is reached through its neighbours. When a signal comes within
half its usual distance of a value, it reaches the value in at most this share of the cases. The
reason is that the tails of a distribution with a finite variance fall faster than 1/x^2
(Chebyshev)."""


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
    return Structure(signal, READINGS_LOST, float(lost.visits), text)


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
    if table.shape[1] == 1 and _ends_both_ways(runs[:, 0], jumps):
        return None
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


def _ends_both_ways(runs: Array, jumps: NDArray[np.intp]) -> bool:
    """True if jumps lead repeatedly to both ends of the range. Such jumps are shocks beyond the
    range, because lost readings have one value only. runs: (N,) values of a signal with one
    component."""
    return all(int((runs[jumps] == end).sum()) > 1 for end in (runs.min(), runs.max()))
