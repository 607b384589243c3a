"""A yaw rate of the vehicle bus that stays as it was while the vehicle turns.

Its value is exactly the same for longer than its runs of equal values usually last, and another
signal, the steering or the gyroscope, has turned in that time by several of its steps. On a
straight road a coarse yaw rate may keep one value for minutes: nothing has turned there.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.motion.stuck import MIN_STUCK_S, TIMES_USUAL, Places, UsualRuns, runs_of
from imucald.motion.ticks import TICK_S, YAW_RATE

Flags = NDArray[np.bool_]

SAME_RATE = 1e-9
"""Means over nine and ten equal samples differ by rounding [rad/s]."""
TURNED = 0.008
"""The other signal moves by so much at least [rad/s]: that comes to 3 deg in the 6.4 s of a block,
which would be taken for a sensor that was turned. A fine yaw rate does not stay the same at all."""
STEPS = 3.0
"""... and by so many steps: rounding holds a value back by one, a sender's dead band by two."""
LARGE = 0.9
"""So many of the changes are no larger than what counts as a step: means over ticks split steps."""
SMOOTH = np.full(10, 0.1)
"""The other signal is taken as means over a second: vibration is no turn."""


class StuckYawRate:
    """Flags ticks at which the yaw rate is stuck while the vehicle turns."""

    def __init__(self) -> None:
        self._ended = UsualRuns()
        """How long was driven in them [ticks], the change after [rad/s]."""
        self.restart()

    def take_usual(self, former: StuckYawRate) -> None:
        """Take the runs that another one has seen end."""
        self._ended = former._ended

    def restart(self) -> None:
        """Time jumped: the run before is over."""
        self._value, self._lasted = math.nan, 0.0
        self._low, self._high = math.nan, math.nan

    def flags(self, rows: Array, turning: Array, driving: Flags, leaving: int) -> Flags:
        """Ticks (N,) with a yaw rate that is stuck; rows: (N, COLUMNS), `leaving` leave next.

        turning: (N,) yaw rate by another signal [rad/s]. driving: (N,) where that is known, and the
        vehicle drives.
        """
        out = np.zeros(len(rows), dtype=bool)
        at = np.flatnonzero(rows[:, YAW_RATE.n] > 0)
        if not len(at):
            return out
        value = rows[at, YAW_RATE.mean]
        first, last, change = runs_of(value, SAME_RATE)
        begins, ends = at[first], at[last]
        turned = np.where(driving, np.convolve(turning, SMOOTH, mode="same"), math.nan)
        driven = np.zeros(len(rows) + 1)
        np.cumsum(driving, out=driven[1:])
        lasted = driven[ends + 1] - driven[begins]
        goes_on = abs(value[0] - self._value) <= SAME_RATE
        if goes_on:
            lasted[0] += self._lasted
        stuck = lasted > MIN_STUCK_S / TICK_S
        if np.count_nonzero(stuck):
            low, high = np.fmin.reduceat(turned, begins), np.fmax.reduceat(turned, begins)
            if goes_on:
                low[0], high[0] = np.fmin(low[0], self._low), np.fmax(high[0], self._high)
            limit, least = self._limits()
            stuck = (lasted > limit) & (high - low > least)
        for begin, end in zip(begins[stuck].tolist(), ends[stuck].tolist(), strict=True):
            out[begin : end + 1] = True
        over = ~stuck & (ends < leaving) & (lasted > 0.0)
        over[-1] = False
        after = last[over]
        self._ended.add(lasted[over] + driven[at[after + 1]] - driven[at[after] + 1], change[after])
        self._carry(value[first], begins, ends, driven, turned, leaving)
        return out

    def take_short_runs(self, first: float, driven: Array, change: Array) -> bool:
        """Take ticks all of which have a yaw rate that keeps no value for long, see `short_runs`.

        first: their first yaw rate [rad/s]. driven: (M,) of the runs while driving [ticks]; change:
        (M,) [rad/s]. False: the first of them goes on from before, and `flags` has to look.
        """
        if abs(first - self._value) <= SAME_RATE:
            return False
        self._ended.add(driven, change)
        self.restart()
        return True

    def _carry(
        self,
        values: Array,
        begins: Places,
        ends: Places,
        driven: Array,
        turned: Array,
        leaving: int,
    ) -> None:
        """Keep what is known of the run that goes on, up to the first tick of the next call."""
        crossing = np.flatnonzero((begins < leaving) & (leaving <= ends))
        if not len(crossing):
            self.restart()
            return
        i = int(crossing[0])
        begin, value = int(begins[i]), float(values[i])
        of_before = i == 0 and abs(value - self._value) <= SAME_RATE
        lasted, low, high = self._lasted, self._low, self._high
        if not of_before:
            lasted, low, high = 0.0, math.nan, math.nan
        gone = turned[begin:leaving]
        self._value, self._lasted = value, lasted + float(driven[leaving] - driven[begin])
        self._low = float(np.fmin(low, np.fmin.reduce(gone)))
        self._high = float(np.fmax(high, np.fmax.reduce(gone)))

    def _limits(self) -> tuple[float, float]:
        """A run of more ticks, with more turning [rad/s], is stuck; none, until it is known."""
        if not self._ended.known:
            return math.inf, math.inf
        least = max(TURNED, STEPS * self._ended.change(LARGE))
        return max(MIN_STUCK_S / TICK_S, TIMES_USUAL * self._ended.usual), least
