"""Rails: an axis that cannot go beyond some value, at either end.

A value that a live axis happens to reach as its largest comes once or twice; on a rail it comes
again and again, and stays.
"""

from __future__ import annotations

import math
from bisect import insort

import numpy as np
from numpy.typing import NDArray

from imucald.motion.hops import SIDES, WINDOW_HOPS, HopRows
from imucald.motion.sensor_judges import SURPRISE, Runs, StuckAxis

Flags = NDArray[np.bool_]

MIN_WINDOW_HOPS = 30
"""Hops of driving in a window from which the tail of an axis is known (15 s)."""
LEAST_STEPS = 16
"""A signal of fewer steps from end to end has no tail."""
LEAST_AT_EXTREME = 5
PILE = 1.3
"""An extreme is a rail where more samples are on it than on the steps below, so many times."""
TIES_COUNT = 0.5
"""Neighbouring samples are not independent: each counts for so much."""
BROAD = 3
"""The tail is measured from where it holds so many times the arrivals at the extreme."""
REMEMBERED = 64


class Rail:
    """Whether the largest value of an axis, of one side, is the end of its range.

    Peaks that meet in one step of a tail, and samples that stay there while other axes move, are
    improbable; on a rail they are the rule. Only driving counts, window by window, so that what was
    reached before the rail was there does not hide it; an extreme that comes again in a later one
    goes on counting. It is no rail when a value lies beyond.
    """

    def __init__(self) -> None:
        self._former: dict[float, tuple[int, int, int, list[int]]] = {}
        self._window = -1
        self._extreme = self._rail = -math.inf
        self._at_it = self._ties = self._arrivals = self._before = 0
        self._below = [0, 0]
        self._last = -2
        self._peaks: list[float] = []
        self._is_known = self.found = False

    def _begin(self, window: int) -> None:
        self._window = window
        if self._at_it:
            self._former[self._extreme] = self._at_it, self._ties, self._arrivals, self._below
        self._is_known = False
        self._extreme = -math.inf
        self._at_it = self._ties = self._arrivals = self._before = 0
        self._below = [0, 0]
        self._last = -2
        self._peaks = []

    def least_peak(self, window: int) -> float:
        """A hop's largest value that is lower says nothing in that window."""
        if window != self._window or len(self._peaks) < REMEMBERED:
            return -math.inf
        return self._peaks[0]

    def step(self, rows: HopRows, h: int, side: int, axis: int, hop: int, runs: Runs) -> bool:
        """Take hop h of the rows, the `hop`th of driving; whether its largest value is a rail."""
        at = h, side, axis
        top, extreme = float(rows.top[at]), float(rows.extreme[at])
        step = float(rows.step[h, axis])
        if self.found and top > self._rail + 0.5 * step:
            self.found = False
        if hop < 0:
            return self.found
        if rows.window[h] != self._window:
            self._begin(int(rows.window[h]))
        if extreme > self._extreme:
            self._raise(extreme, step)
        peaks = self._peaks
        if len(peaks) < REMEMBERED or top > peaks[0]:
            insort(peaks, top)
            del peaks[:-REMEMBERED]
        for i in range(2):
            self._below[i] += int(rows.below[h, i, side, axis])
        if at_it := int(rows.at_it[at]):
            self._at_it += at_it
            self._ties += int(rows.ties[at])
            self._arrivals += hop - self._last > 1
            self._last = hop
            steps = float(rows.extreme[h, :, axis].sum()) / step
            if not self.found and steps >= LEAST_STEPS and self._is_rail(step, hop, runs):
                self.found, self._rail = True, extreme
        return self.found

    def _raise(self, extreme: float, step: float) -> None:
        """A larger value: what was the extreme is now so many steps below."""
        higher = extreme - self._extreme
        steps = round(higher / step) if higher < 3.0 * step else 3
        if steps <= 1:
            self._below = [self._at_it, self._below[0]]
        elif steps == 2:
            self._below = [0, self._at_it]
        else:
            self._below = [0, 0]
        self._extreme = extreme
        self._at_it = self._ties = self._arrivals = 0
        self._last = -2
        self._is_known = extreme in self._former
        if self._is_known:
            self._at_it, self._ties, self._arrivals, self._below = self._former[extreme]
        self._former = {v: n for v, n in self._former.items() if v > extreme}
        self._before = self._arrivals

    def _is_rail(self, step: float, hop: int, runs: Runs) -> bool:
        if self._at_it < LEAST_AT_EXTREME or self._at_it <= PILE * max(self._below):
            return False
        surprise = TIES_COUNT * self._ties * runs.rate()
        now = self._arrivals - self._before
        low = self._peaks[-min(BROAD * now, len(self._peaks))]
        scale = (self._extreme - low) / math.log(BROAD)
        is_late = self._is_known or hop % WINDOW_HOPS >= MIN_WINDOW_HOPS
        if self._arrivals > 1 and scale > 0.0 and is_late:
            surprise -= (self._arrivals - 1) * math.log(-math.expm1(-step / scale))
        return surprise > SURPRISE


class Rails:
    """All rails of a sensor."""

    def __init__(self, axes: int) -> None:
        self._rails = [[Rail() for _ in range(axes)] for _ in range(SIDES)]
        self.found = ""

    def due(self, rows: HopRows, moving: Flags) -> list[list[tuple[int, int]]]:
        """Of each hop the sides and axes that `step` has to look at."""
        window = int(rows.window[-1])
        least = np.array([[rail.least_peak(window) for rail in side] for side in self._rails])
        known = np.array([[rail.found for rail in side] for side in self._rails])
        near = (rows.top > least) | (rows.below.sum(axis=1) > 0) | (rows.at_it > 0)
        near &= moving[:, None, None]
        due: list[list[tuple[int, int]]] = [[] for _ in moving]
        for h, side, axis in np.argwhere(near | known).tolist():
            due[h].append((side, axis))
        return due

    def step(
        self, rows: HopRows, h: int, due: list[tuple[int, int]], hop: int, stuck: list[StuckAxis]
    ) -> None:
        """Look at hop h; `found` names the axes that are on a rail."""
        for side, axis in due:
            self._rails[side][axis].step(rows, h, side, axis, hop, stuck[axis].moving)
        either = [any(rails[i].found for rails in self._rails) for i in range(len(stuck))]
        self.found = "".join(name for name, on in zip("xyz", either, strict=False) if on)
