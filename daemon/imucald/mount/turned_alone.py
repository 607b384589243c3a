"""Does the sensor turn about the vertical while the vehicle does not?

Between two times at which both hardly turn, gyroscope and vehicle have turned by the same angle,
however late one of them is. Where the gyroscope turned further, the sensor was taken or knocked.
The vehicle's turning is shown by its yaw rate, or at speed by the force to the left (v r).

A gyroscope that sends seldom walks by itself (`gyro_walk`): a phone that shakes in its holder was
seen to turn by 29 deg within 2 s at five samples a second, and had not.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core import compiled
from imucald.core.arrays import Array
from imucald.motion.ticks import TICK_S

Flags = NDArray[np.bool_]

APART = 20
"""Ticks between the two times (2 s): a knock is shorter, a hand takes a second."""
STILL_RATE = 0.05
"""Below this both hardly turn [rad/s]: with 0.2 s between them that is 0.6 deg."""
MIN_SPEED = 10.0
"""From this speed on the force shows a turn [m/s]: one by 6 deg in 2 s takes 0.5 m/s^2 there."""


class Witness(Struct, frozen=True):
    """What says how the vehicle turns.

    least: a turn that the gyroscope makes alone is one from so much on [rad]. gain_share: both
    differ by so much of what was turned in between.
    """

    least: float
    gain_share: float

    def beside(self, walk: float) -> Witness:
        """The same with a gyroscope whose angle walks by so much variance a second [rad^2/s].

        least: of `DEVIATIONS` that it may differ by, of which walking makes more.
        """
        own = DEVIATIONS * math.sqrt(walk * APART * TICK_S)
        return Witness(math.hypot(self.least, own), self.gain_share)


DEVIATIONS = 6.0
"""A turn is one from so many standard deviations on: of a normal variable 2e-9, two-sided."""
YAW_RATE = Witness(math.radians(3.0), 0.1)
"""Offsets of 0.3 deg/s of both make 1.2 deg in that time."""
FORCE = Witness(math.radians(6.0), 0.3)
"""A gust of 0.3 m/s^2 for that long makes 3.4 deg; the body leans."""


class TurnedAlone:
    """Holds the gyroscope's turning against the vehicle's, across the ends of blocks."""

    def __init__(self) -> None:
        self._before: Array = np.zeros((2, 0))

    def restart(self) -> None:
        """Nothing is held against what comes before."""
        self._before = np.zeros((2, 0))

    def add(self, turn_rate: Array, vehicle: Array, ok: Flags, by: Witness = YAW_RATE) -> float:
        """Take a block (N,) [rad/s]; return by how much the sensor turned alone [rad], or 0."""
        if compiled.kernels is not None:
            n = len(ok)
            both, used, alone = np.empty((2, APART + n)), np.empty(1, np.int64), np.empty(1)
            numbers = np.array([STILL_RATE, TICK_S, by.gain_share, by.least])
            flags = compiled.kernels.turned_alone(
                self._before, turn_rate, vehicle, ok, numbers, both, used, alone
            )
            if flags:
                compiled.note(flags)
            found = float(alone[0])
            self._before = both[:, max(int(used[0]) - APART, 0) : used[0]]
        else:
            found = self._alone(turn_rate, vehicle, ok, by)
        if found:
            self.restart()
        return found

    def _alone(self, turn_rate: Array, vehicle: Array, ok: Flags, by: Witness) -> float:
        known = self._before.shape[1]
        both = np.empty((2, known + len(ok)))
        both[:, :known], both[0, known:], both[1, known:] = self._before, turn_rate, vehicle
        if np.count_nonzero(ok) < len(ok):
            both = both[:, known + int(np.flatnonzero(~ok)[-1]) + 1 :]
        self._before = both[:, -APART:]
        if both.shape[1] <= APART:
            return 0.0
        sizes = np.abs(both)
        hardly = sizes < STILL_RATE
        still = hardly[0] & hardly[1]
        use = still[APART:] & still[:-APART]
        turned = (both[0] - both[1]).cumsum() * TICK_S
        alone = turned[APART:] - turned[:-APART]
        path = sizes[1].cumsum() * TICK_S
        excess = np.abs(alone) - by.gain_share * (path[APART:] - path[:-APART])
        excess[~use] = 0.0
        k = int(excess.argmax())
        if excess[k] < by.least:
            return 0.0
        own = float(both[0, k + 1 : k + APART + 1].sum()) * TICK_S
        if own * float(alone[k]) < 0.0 or abs(own) < by.least:  # the vehicle's signal is odd
            return 0.0
        return float(alone[k])
