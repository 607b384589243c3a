"""What was driven so far: launches, brakings, turns to either side."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.core import compiled
from imucald.core.arrays import Array

HARD_ACCEL = 1.0
"""Acceleration or braking of that size [m/s^2] counts as a manoeuvre."""
HARD_TURN = 0.8
"""A turn of that lateral acceleration [m/s^2] counts."""
HARD_TICKS = 5
"""It must last that long."""


_LEVELS = np.array([HARD_ACCEL, HARD_ACCEL, HARD_TURN, HARD_TURN])
_COUNT, _RUN, _OVER = range(3)


class Manoeuvres:
    """What was driven: launches, brakings, turns to either side.

    Counted are intervals of time above a level that last; the level must be left in between.
    """

    def __init__(self) -> None:
        self._state = np.zeros((4, 3), np.int64)
        """Of launches, brakings, lefts, rights: how many; ticks of the last; whether it counted."""

    def add(self, accel: Array, turn: Array) -> None:
        """Take a block of dv/dt and v r, zero where not to be trusted."""
        if compiled.kernels is not None:
            compiled.kernels.count_manoeuvres(accel, turn, _LEVELS, HARD_TICKS, self._state)
            return
        for k, values in enumerate((accel, -accel, turn, -turn)):
            self._feed(self._state[k], values, float(_LEVELS[k]))

    @staticmethod
    def _feed(state: NDArray[np.int64], values: Array, level: float) -> None:
        count, run, over = state.tolist()
        if not over and not np.count_nonzero(values > level):
            state[_RUN] = 0
            return
        for value in values.tolist():
            if value > level:
                run += 1
                if run == HARD_TICKS and not over:
                    count, over = count + 1, 1
            elif value < 0.5 * level:
                run = over = 0
        state[:] = count, run, over

    @property
    def straight(self) -> int:
        """Launches and brakings."""
        return int(self._state[0, _COUNT] + self._state[1, _COUNT])

    @property
    def lefts(self) -> int:
        """Left turns."""
        return int(self._state[2, _COUNT])

    @property
    def rights(self) -> int:
        """Right turns."""
        return int(self._state[3, _COUNT])
