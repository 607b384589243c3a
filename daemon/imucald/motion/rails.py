"""Rails: an axis that cannot go beyond some value, at either end.

A value that a live axis happens to reach as its largest comes once; on a rail it comes again and
again, from far below too, and stays. What is played twice to the last bit, such as a recording in
a loop, comes once.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from imucald.motion.hops import SIDES, HopRows
from imucald.motion.sensor_judges import Runs

Array = NDArray[np.float64]

TAIL_HOPS = 120
"""The tail of an axis is that of the largest values of so many hops of driving (a minute) ..."""
LEAST_TAIL_HOPS = 30
"""... and known from so many (15 s)."""
LEAST_STEPS = 8
"""A signal of fewer steps from end to end has no tail."""
LEAST_AT_EXTREME = 5
PILE = 1.3
"""An extreme is a rail where more samples are on it than on the steps below, so many times."""
STAYS_COUNT = 0.5
"""Neighbouring samples are not independent: each counts for so much."""
LEAST_RISE = 3.0
"""A rise of so many steps from one sample to the next goes anywhere; a smooth peak that is rounded
comes back to its top from one or two below."""
SURPRISE = 18.5
"""A rail is believed from this -log of the chance of it without one [nats]: 1e-8, where both ends
of six axes have some 1e7 hops of driving in 100 h."""
BOTH_ENDS = SURPRISE + 4.0
"""A range that ends at both ends: for the sum of two surprises, as x + log(1 + x) has it."""
BROAD = 3
"""The tail is measured from where it holds so many times the arrivals at the extreme."""
LONG_STAY = 4
"""Fewer samples on a value that is reached for the first time say nothing."""
REMEMBERED = 64
"""Values that nothing has gone beyond since; they fall, so there are few of them."""
MOST_SAMPLES = 512


class _Pile(Struct):
    """What speaks for a value as a rail.

    rate: -log of the chance that a sample equals the one before, as it was known before [nats].
    at_it: samples on the value; stays: of them, those that equal the one before. met: -log of the
    chance that its arrivals meet in one step [nats], risen: that steep rises do. seen: samples,
    each with the one before it, so that what comes again to the last bit counts once. before:
    at_it, stays and risen at the last arrival.
    """

    rate: float
    at_it: int = 0
    stays: int = 0
    arrivals: int = 0
    last: int = -2
    met: float = 0.0
    risen: float = 0.0
    seen: dict[bytes, None] = field(default_factory=dict)  # in the order in which they came
    before: tuple[int, int, float] = (0, 0, 0.0)

    @property
    def surprise(self) -> float:
        """-log of the chance of all that was seen [nats]."""
        stays = _more_often(self.stays, self.at_it, self.rate)
        return self.met + STAYS_COUNT * (self.risen + stays)

    def count_stay_once(self) -> None:
        """Of all samples since the last arrival let one count."""
        at_it, self.stays, self.risen = self.before
        self.at_it = min(self.at_it, at_it + 1)
        while len(self.seen) > self.at_it:
            self.seen.popitem()


class _Top(Struct):
    """A value that nothing has gone beyond since hop `born`.

    on: samples on it, one_below, two_below: as many steps below, as far as they are tops of their
    hops.
    """

    value: float
    born: int
    on: int
    one_below: int
    two_below: int
    pile: _Pile | None = None

    @property
    def is_piled_up(self) -> bool:
        """Whether more samples are on it than a tail has there."""
        at_it = 0 if self.pile is None else self.pile.at_it
        return at_it >= LEAST_AT_EXTREME and at_it > PILE * max(self.one_below, self.two_below)


class Rail:
    """Whether the largest value of an axis, of one side, is the end of its range.

    Peaks that meet in one step of a tail, and samples that stay there while other axes move, are
    improbable; on a rail they are the rule. Watched is every value that nothing has gone beyond
    since it came, so what was reached before the rail was there does not hide it. Only driving
    counts. It is no rail when a value lies beyond.

    surprise: -log of the chance of what is seen if there is none [nats], as far as it has been
    left again: an axis that sticks is none, and has arrived once when that has ended. value: for
    which it is. recent: tops of the last hops of driving.
    """

    def __init__(self, side: int, axis: int) -> None:
        self._side, self._axis = side, axis
        self._tops: list[_Top] = []  # their values fall
        self.recent: deque[float] = deque(maxlen=TAIL_HOPS)
        self._rail = -math.inf
        self._changed = False
        self.found = False
        self.surprise, self.value = 0.0, math.inf

    def step(
        self, value: float, on: int, rows: HopRows, h: int, hop: int, step: float, runs: Runs
    ) -> bool:
        """Take hop h of the rows, the `hop`th of driving; -1 where the vehicle stands.

        value, on: its top, and the samples on it. step: smallest change of the axis so far, runs:
        its runs. Returns whether the surprise has to be weighed anew.
        """
        if self.found and value > self._rail + 0.5 * step:
            self.found = False
        if value > self.value:
            self.surprise, self.value = 0.0, math.inf
        if hop < 0:
            while self._tops and self._tops[-1].value < value:
                self._tops.pop()
            return self._changed
        self.recent.append(value)
        top = self._reached(value, on, step, hop)
        if top.pile is not None or top.born < hop or top.on >= LONG_STAY:
            if top.pile is None:
                top.pile = _Pile(runs.rate())
            self._take(top, top.pile, rows, h, hop, step, runs)
            self._changed = True
        return self._changed

    def stick(self, value: float) -> None:
        """The axis is stuck at a value: what stays there is the axis, and no rail holds it."""
        top = self._tops[-1] if self._tops else None
        if top is not None and top.value == value and top.pile is not None:
            top.pile.count_stay_once()

    def weigh(self, rows: HopRows, h: int) -> None:
        """Of the values that may be a rail the one for which most speaks."""
        last = float(rows.samples[self._axis, rows.edges[h + 1] - 1])
        now = last if self._side == 0 else -last
        # once it is left, nothing changes before the next arrival
        self._changed = bool(self._tops) and now == self._tops[-1].value
        piles = [
            (one.pile.surprise, one.value)
            for one in self._tops
            if one.pile is not None and one.is_piled_up and now < one.value
        ]
        self.surprise, self.value = max(piles, default=(0.0, math.inf))

    def on_rail(self) -> None:
        """The value for which most speaks is a rail."""
        self.found, self._rail = True, self.value

    def _reached(self, value: float, on: int, step: float, hop: int) -> _Top:
        """A value as the latest top; those that it goes beyond are no longer watched.

        on: samples of the hop on it.
        """
        tops, one_below, two_below = self._tops, 0, 0
        one_step, two_steps = 1.5 * step, 2.5 * step
        while tops and tops[-1].value < value:
            old = tops.pop()
            lower = value - old.value
            if lower < one_step:
                one_below += old.on
                two_below += old.one_below
            elif lower < two_steps:
                two_below += old.on
        if tops:
            last = tops[-1]
            if last.value == value:
                last.on += on  # those below it were added when they came
                return last
            lower = last.value - value
            if lower < one_step:
                last.one_below += on
            elif lower < two_steps:
                last.two_below += on
        new = _Top(value, hop, on, one_below, two_below)
        if len(tops) == REMEMBERED:
            del tops[next((k for k, one in enumerate(tops) if one.pile is None), 0)]
        tops.append(new)
        return new

    def _take(
        self, top: _Top, pile: _Pile, rows: HopRows, h: int, hop: int, step: float, runs: Runs
    ) -> None:
        """Weigh the samples of a hop that are on its top."""
        pile.rate = pile.rate or runs.rate()
        is_arrival = hop - pile.last > 1
        if is_arrival:
            pile.before = pile.at_it, pile.stays, pile.risen
        fresh = self._fresh(rows, h, top.value, pile, step)
        pile.last = hop
        if not fresh:
            return
        if is_arrival:
            pile.arrivals += 1
            if pile.arrivals > 1:
                pile.met += self._coincidence(top, step, hop)

    def _fresh(self, rows: HopRows, h: int, value: float, pile: _Pile, step: float) -> bool:
        """Count the samples of a hop on the value that are new, not those that were sent twice."""
        first, stop = rows.edges[h], rows.edges[h + 1]
        before = rows.samples[:, first - 1] if first else rows.before
        hop = np.column_stack([before, rows.samples[:, first:stop]])
        own = hop[self._axis] if self._side == 0 else -hop[self._axis]
        at_it, seen = pile.at_it, pile.seen
        for k in np.flatnonzero(own[1:] == value).tolist():
            two = hop[:, k : k + 2]
            if len(seen) == MOST_SAMPLES or (two[:, 0] == two[:, 1]).all():
                continue
            known = len(seen)
            seen[two.tobytes()] = None
            if len(seen) > known:
                pile.at_it += 1
                pile.stays += bool(own[k] == value)
                rise = value - float(own[k])
                if rise >= LEAST_RISE * step and pile.at_it > pile.before[0] + 1:
                    # of those that go as far, rises of that size, spread exponentially, end in
                    # this very step; the first of an arrival is weighed with its peak
                    pile.risen -= math.log(-math.expm1(-step / rise))
        return pile.at_it > at_it

    def _coincidence(self, top: _Top, step: float, hop: int) -> float:
        """-log of the chance that one more peak of the tail meets the same step [nats]."""
        n = min(hop - top.born + 1, TAIL_HOPS)
        if n < LEAST_TAIL_HOPS:
            return 0.0
        peaks = np.array(self.recent)[-n:]
        on = int(np.count_nonzero(peaks == top.value))
        broad = min(BROAD * on, n)
        low = float(np.partition(peaks, n - broad)[n - broad])
        if low >= top.value:
            return 0.0
        scale = (top.value - low) / math.log(broad / on)
        return -math.log(-math.expm1(-step / scale))


def _more_often(stays: int, of: int, rate: float) -> float:
    """-log of the chance that so many of so many samples stay, where exp(-rate) do [nats].

    Chernoff's bound of the binomial's tail; 0 where they do not stay more often than that.
    """
    chance = math.exp(-rate)
    share = stays / of if of else 0.0
    if share <= chance:
        return 0.0
    left = (1.0 - share) * math.log((1.0 - share) / (1.0 - chance)) if share < 1.0 else 0.0
    return of * (share * (math.log(share) + rate) + left)


class AxisRails:
    """Both rails of an axis."""

    def __init__(self, axis: int) -> None:
        self._high, self._low = (Rail(side, axis) for side in range(SIDES))
        self._hops = 0

    def step(
        self,
        rows: HopRows,
        h: int,
        moving: bool,
        stuck: bool,
        runs: Runs,
        step: float,
        tops: tuple[float, float],
        on_tops: tuple[int, int],
    ) -> bool:
        """Take hop h, which has samples; return whether the axis is on a rail.

        stuck: whether it was stuck when the hop began; such a hop says nothing of rails.
        runs, step, tops, on_tops: of the axis, as `HopRows` has step, top and on_top.
        """
        high, low = self._high, self._low
        hop = -1
        if stuck:
            high.stick(tops[0])
            low.stick(tops[1])
        elif moving:
            hop = self._hops
            self._hops += 1
        is_high = high.step(tops[0], on_tops[0], rows, h, hop, step, runs)
        is_low = low.step(tops[1], on_tops[1], rows, h, hop, step, runs)
        if (is_high or is_low) and max(high.recent) + max(low.recent) >= LEAST_STEPS * step:
            if is_high:
                high.weigh(rows, h)
            if is_low:
                low.weigh(rows, h)
        if high.surprise > 0.0 or low.surprise > 0.0:
            both = high.surprise + low.surprise > BOTH_ENDS
            for rail in (high, low):
                is_sure = rail.surprise > SURPRISE or (both and rail.surprise > 0.0)
                if is_sure and not rail.found:
                    rail.on_rail()
        return high.found or low.found
