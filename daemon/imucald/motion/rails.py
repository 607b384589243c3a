"""Rails: an axis that cannot go beyond some value, at either end.

A value that a live axis happens to reach as its largest comes once or twice; on a rail it comes
again and again, and stays.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.motion.hops import SIDES, WINDOW_HOPS, HopRows
from imucald.motion.sensor_judges import SURPRISE, Runs, StuckAxis

Array = NDArray[np.float64]
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
"""And from so many peaks of a window at most."""


class AtExtreme(NamedTuple):
    """A hop of driving with samples at the largest value of an axis, or just below.

    Fields as those of `HopRows`; width: from the lower to the upper extreme.
    """

    side: int
    axis: int
    window: int
    extreme: float
    width: float
    step: float
    at_it: int
    ties: int
    below: int
    far_below: int


class Peaks:
    """The largest values of a window's hops of driving."""

    def __init__(self) -> None:
        self._window = -1
        self._tops: list[Array] = []

    def add(self, window: int, top: Array) -> None:
        """Take those of a hop, by side and axis."""
        if window != self._window:
            self._window, self._tops = window, []
        self._tops.append(top)

    def of(self, side: int, axis: int) -> list[float]:
        """In order, the largest last; not more than REMEMBERED."""
        return sorted(float(top[side, axis]) for top in self._tops)[-REMEMBERED:]


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

    def reached(self, top: float, step: float) -> None:
        """Take a hop's largest value, of any hop: a value beyond a rail says that it is none."""
        if top > self._rail + 0.5 * step:
            self.found = False

    def step(self, seen: AtExtreme, hop: int, runs: Runs, peaks: Peaks) -> None:
        """Take the `hop`th hop of driving."""
        if seen.window != self._window:
            self._begin(seen.window)
        if seen.extreme > self._extreme:
            self._raise(seen.extreme, seen.step)
        self._below[0] += seen.below
        self._below[1] += seen.far_below
        if not seen.at_it:
            return
        self._at_it += seen.at_it
        self._ties += seen.ties
        self._arrivals += hop - self._last > 1
        self._last = hop
        is_wide = seen.width / seen.step >= LEAST_STEPS
        if not self.found and is_wide and self._is_rail(seen, hop, runs, peaks):
            self.found, self._rail = True, seen.extreme

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

    def _is_rail(self, seen: AtExtreme, hop: int, runs: Runs, peaks: Peaks) -> bool:
        if self._at_it < LEAST_AT_EXTREME or self._at_it <= PILE * max(self._below):
            return False
        surprise = TIES_COUNT * self._ties * runs.rate()
        now = self._arrivals - self._before
        tops = peaks.of(seen.side, seen.axis)
        low = tops[-min(BROAD * now, len(tops))]
        scale = (self._extreme - low) / math.log(BROAD)
        is_late = self._is_known or hop % WINDOW_HOPS >= MIN_WINDOW_HOPS
        if self._arrivals > 1 and scale > 0.0 and is_late:
            surprise -= (self._arrivals - 1) * math.log(-math.expm1(-seen.step / scale))
        return surprise > SURPRISE


class Rails:
    """All rails of a sensor."""

    def __init__(self, axes: int) -> None:
        self._rails = [[Rail() for _ in range(axes)] for _ in range(SIDES)]
        self._peaks = Peaks()
        self.found = ""

    def due(self, rows: HopRows, moving: Flags) -> dict[int, list[AtExtreme]]:
        """By hop what `step` has to look at."""
        below = rows.below
        busy = (rows.at_it > 0) | (below[:, 0] > 0) | (below[:, 1] > 0)
        h, side, axis = at = np.nonzero(busy & moving[:, None, None])
        due: dict[int, list[AtExtreme]] = {}
        if not len(h):
            return due
        columns = (
            side,
            axis,
            rows.window[h],
            rows.extreme[at],
            rows.extreme[h, 0, axis] + rows.extreme[h, 1, axis],
            rows.step[h, axis],
            rows.at_it[at],
            rows.ties[at],
            below[h, 0, side, axis],
            below[h, 1, side, axis],
        )
        for hop, *seen in zip(h.tolist(), *(c.tolist() for c in columns), strict=True):
            due.setdefault(hop, []).append(AtExtreme(*seen))
        return due

    def step(
        self, rows: HopRows, h: int, due: Sequence[AtExtreme], hop: int, stuck: list[StuckAxis]
    ) -> None:
        """Look at hop h; `found` names the axes that are on a rail. hop: -1 unless driving."""
        top = rows.top[h]
        if self.found:
            for side, rails in enumerate(self._rails):
                for axis, rail in enumerate(rails):
                    if rail.found:
                        rail.reached(float(top[side, axis]), float(rows.step[h, axis]))
        if hop >= 0:
            self._peaks.add(int(rows.window[h]), top)
        for seen in due:
            self._rails[seen.side][seen.axis].step(seen, hop, stuck[seen.axis].moving, self._peaks)
        if due or self.found:
            either = [any(rails[i].found for rails in self._rails) for i in range(len(stuck))]
            self.found = "".join(name for name, on in zip("xyz", either, strict=False) if on)
