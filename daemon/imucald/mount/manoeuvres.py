"""What was driven so far: launches, brakings, turns to either side."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

Array = NDArray[np.float64]

HARD_ACCEL = 1.0
"""Acceleration or braking of that size [m/s^2] counts as a manoeuvre."""
HARD_TURN = 0.8
"""A turn of that lateral acceleration [m/s^2] counts."""
HARD_TICKS = 5
"""It must last that long."""


class _Counter(Struct):
    """Counts intervals of time above a level that last; the level must be left in between."""

    level: float
    count: int = 0
    run: int = 0
    over: bool = False

    def feed(self, values: Array) -> None:
        if not np.count_nonzero(values > self.level) and not self.over:
            self.run = 0
            return
        for value in values.tolist():
            if value > self.level:
                self.run += 1
                if self.run == HARD_TICKS and not self.over:
                    self.count += 1
                    self.over = True
            elif value < 0.5 * self.level:
                self.run = 0
                self.over = False


class Manoeuvres:
    """What was driven: launches, brakings, turns to either side."""

    def __init__(self) -> None:
        self._launches = _Counter(HARD_ACCEL)
        self._brakings = _Counter(HARD_ACCEL)
        self._lefts = _Counter(HARD_TURN)
        self._rights = _Counter(HARD_TURN)

    def add(self, accel: Array, turn: Array) -> None:
        """Take a block of dv/dt and v r, zero where not to be trusted."""
        self._launches.feed(accel)
        self._brakings.feed(-accel)
        self._lefts.feed(turn)
        self._rights.feed(-turn)

    @property
    def straight(self) -> int:
        """Launches and brakings."""
        return self._launches.count + self._brakings.count

    @property
    def lefts(self) -> int:
        """Left turns."""
        return self._lefts.count

    @property
    def rights(self) -> int:
        """Right turns."""
        return self._rights.count
