"""Does the sensor turn about the vertical while the vehicle, by its own yaw rate, does not?

Between two times at which both hardly turn, gyroscope and yaw rate have turned by the same angle,
however late one of them is. Where the gyroscope turned further, the sensor was taken or knocked.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.motion.ticks import TICK_S

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

APART = 20
"""Ticks between the two times (2 s): a knock is shorter, a hand takes a second."""
STILL_RATE = 0.05
"""Below this both hardly turn [rad/s]: with 0.2 s between them that is 0.6 deg."""
LEAST = math.radians(3.0)
"""A turn by so much is one [rad]; offsets of 0.3 deg/s of both make 1.2 in that time ..."""
GAIN_SHARE = 0.1
"""... and their gains differ by so much of what was turned in between."""


class TurnedAlone:
    """Holds the gyroscope's turning against the vehicle's, across the ends of blocks."""

    def __init__(self) -> None:
        self._before: Array = np.zeros((2, 0))

    def restart(self) -> None:
        """Nothing is held against what comes before."""
        self._before = np.zeros((2, 0))

    def add(self, turn_rate: Array, yaw_rate: Array, ok: Flags) -> float:
        """Take a block (N,) [rad/s]; return by how much the sensor turned alone [rad], or 0."""
        both = np.concatenate([self._before, np.stack([turn_rate, yaw_rate])], axis=1)
        if not ok.all():
            both = both[:, both.shape[1] - len(ok) + int(np.flatnonzero(~ok)[-1]) + 1 :]
        self._before = both[:, -APART:]
        if both.shape[1] <= APART:
            return 0.0
        still = (np.abs(both) < STILL_RATE).all(axis=0)
        use = still[APART:] & still[:-APART]
        turned = np.cumsum(both[0] - both[1]) * TICK_S
        alone = turned[APART:] - turned[:-APART]
        path = np.cumsum(np.abs(both[1])) * TICK_S
        excess = np.abs(alone) - GAIN_SHARE * (path[APART:] - path[:-APART])
        excess[~use] = 0.0
        k = int(np.argmax(excess))
        if excess[k] < LEAST:
            return 0.0
        self.restart()
        return float(alone[k])
