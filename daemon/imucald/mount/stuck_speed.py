"""A speed that does not change while the vehicle drives: its sensor or its sender is stuck.

What it says then is wrong by as much as the driver has changed it, and at its end it jumps. How
long a sound speed says the same depends on its resolution: within one step s over T seconds the
vehicle would have to keep its acceleration under s / T. A sender that repeats each value some
times has longer runs all the time; those do not count.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.motion import ticks as tk
from imucald.motion.ticks import TICK_S

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SHORTEST_S = 1.2
"""Nothing shorter is called stuck."""
STEADIEST = 0.01
"""No vehicle on a road keeps its speed better than that [m/s^2]."""
TIMES_USUAL = 4.0
"""And so many times the usual run."""
RUNS_REMEMBERED = 100.0
DRIVING = 1.0
"""Slower than this [m/s] wheels may well not be seen to turn."""
SAME = 1e-6
"""Means over nine and ten equal samples differ by rounding [m/s]."""


class StuckSpeed:
    """Learns how the speed signal steps, and flags ticks at which it is stuck."""

    def __init__(self) -> None:
        self._finest = math.inf
        self._lengths, self._squares = 0.0, 0.0  # of runs, fading sums
        self._value, self._lasted = math.nan, 0.0

    def restart(self) -> None:
        """Time jumped: the run before is over."""
        self._value = math.nan

    def flags(self, rows: Array, hop: int) -> Flags:
        """Ticks (N,) with a speed that is stuck; rows: (N, COLUMNS), of which `hop` leave next."""
        out = np.zeros(len(rows), dtype=bool)
        at = np.flatnonzero(rows[:, tk.SPEED_N] > 0)
        if not len(at):
            return out
        speed = rows[at, tk.SPEED]
        change = np.abs(np.diff(speed))
        ends = np.append(np.flatnonzero(change > SAME), len(at) - 1)
        first, leaving = 0, (math.nan, 0.0)
        limit = self._limit()
        for last in ends.tolist():
            lasted = float(at[last] - at[first]) * TICK_S
            if first == 0 and abs(speed[0] - self._value) <= SAME:
                lasted += self._lasted
            driving = abs(float(speed[first])) > DRIVING
            stuck = driving and lasted > limit
            if stuck:
                out[at[first] : at[last] + 1] = True
            if at[first] < hop <= at[last]:
                before = int(np.searchsorted(at[first : last + 1], hop))
                begun = lasted - float(at[last] - at[first + before]) * TICK_S
                leaving = float(speed[first]), begun
            elif driving and not stuck and at[last] < hop and last < len(change):
                self._remember(max(lasted, TICK_S), float(change[last]))
            first = last + 1
        self._value, self._lasted = leaving
        return out

    def _limit(self) -> float:
        """A run longer than that is stuck [s]; never, until the signal's steps are known."""
        if self._lengths <= 0.0:
            return math.inf
        usual = self._squares / self._lengths  # as seen at any time: long ones weigh more
        return max(SHORTEST_S, self._finest / STEADIEST, TIMES_USUAL * usual)

    def _remember(self, lasted: float, change: float) -> None:
        keep = 1.0 - 1.0 / RUNS_REMEMBERED
        self._lengths = keep * self._lengths + lasted
        self._squares = keep * self._squares + lasted * lasted
        self._finest = min(self._finest, change)
