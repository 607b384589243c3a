"""Rails: an axis that cannot go beyond some value, at either end.

A value that a live axis happens to reach as its largest comes once; on a rail it comes again and
again, and stays. What is played twice to the last bit, such as a recording in a loop, comes once.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from imucald.motion.hops import SIDES
from imucald.motion.rail_evidence import AxisHops, Pile, Top

TAIL_HOPS = 120
"""The tail of an axis is that of the largest values of so many hops of driving (a minute) ..."""
LEAST_TAIL_HOPS = 30
"""... and known from so many (15 s)."""
LEAST_STEPS = 8
"""A signal of fewer steps from end to end has no tail."""
SURPRISE = 18.5
"""A rail is believed from this -log of the chance of it without one [nats]: 1e-8, where both ends
of six axes have some 1e7 hops of driving in 100 h."""
BOTH_ENDS = SURPRISE + 4.0
"""A range that ends at both ends: for the sum of two surprises, as x + log(1 + x) has it."""
BROAD = 3
"""The tail is measured from where it holds so many times the arrivals at the extreme."""
LONG_STAY = 4
"""Fewer samples on a value that is reached for the first time say nothing."""
USUAL_CHANGE = 4.0
"""A rail is left as the axis goes, by so many times its mean change from sample to sample at most
(three deviations of noise); a contact that closes again jumps."""
REMEMBERED = 64
"""Values that nothing has gone beyond since; they fall, so there are few of them."""


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
        self._tops: list[Top] = []  # their values fall
        self.recent: deque[float] = deque(maxlen=TAIL_HOPS)
        self._rail = -math.inf
        self._changed = False
        self.found = False
        self.surprise, self.value = 0.0, math.inf

    def step(self, at: AxisHops, h: int, hop: int) -> bool:
        """Take hop h of the axis, the `hop`th of driving; -1 where the vehicle stands.

        Returns whether the surprise has to be weighed again.
        """
        value, tops = at.tops[self._side][h], self._tops
        if self.found and value > self._rail + 0.5 * at.step[h]:
            self.found = False
        if value > self.value:
            self.surprise, self.value = 0.0, math.inf
        if hop < 0:
            while tops and tops[-1].value < value:
                del tops[-1]
            return self._changed
        self.recent.append(value)
        top = self.reached(value, at.on_tops[self._side][h], at.step[h], hop)
        if top is not None:
            self.pile_up(top, at, h, hop)
        return self._changed

    @property
    def is_clear(self) -> bool:
        """Whether nothing speaks for a rail: then a hop's value is but to be `reached`."""
        return not (self._changed or self.found) and self.value == math.inf

    def stick(self, value: float) -> None:
        """The axis is stuck at a value: what stays there is the axis, and no rail holds it."""
        top = self._tops[-1] if self._tops else None
        if top is not None and top.value == value and top.pile is not None:
            top.pile.count_stay_once()

    def is_held(self, value: float, left_by: float) -> bool:
        """Whether an axis that was stuck at a value is held there by a rail.

        What sticks does so anywhere; the end of a range is the largest value of a minute's drive.
        left_by: how far the axis is from it now, and less than it goes beyond.
        """
        known = len(self.recent) >= LEAST_TAIL_HOPS
        return known and left_by > 0.0 and value >= max(self.recent)

    def weigh(self, at: AxisHops, h: int) -> None:
        """Of the values that may be a rail the one for which most speaks, after hop h."""
        last = float(at.rows.samples[self._axis, at.rows.edges[h + 1] - 1])
        now = last if self._side == 0 else -last
        # once it is left, nothing changes before the next arrival
        self._changed = bool(self._tops) and now == self._tops[-1].value
        piles = [
            (one.pile.surprise, one.value)
            for one in self._tops
            if one.pile is not None
            and one.is_piled_up
            and now < one.value
            and not self._is_apart(one.value)
        ]
        self.surprise, self.value = max(piles, default=(0.0, math.inf))

    def on_rail(self, value: float | None = None) -> None:
        """A value is a rail; None: the one for which most speaks."""
        self.found, self._rail = True, self.value if value is None else value

    def _is_apart(self, value: float) -> bool:
        """Whether a value lies further beyond all other peaks than they lie apart.

        The end of a range cuts a tail off, so that other peaks are close by; a contact that opens
        jumps, to zero for example, over values that never come.
        """
        below = np.sort([peak for peak in self.recent if peak < value])
        n = len(below)
        return bool(n >= LEAST_TAIL_HOPS and value - below[-1] > below[-1] - below[n // 2])

    def reached(self, value: float, on: int, step: float, hop: int) -> Top | None:
        """Take a value as the latest top; those that it goes beyond are no longer watched.

        on: samples of the hop on it. Returns the top where its samples have to be weighed: they
        stay long, or it was reached before.
        """
        tops, one_below, two_below = self._tops, 0, 0
        two_steps = 2.5 * step
        while tops:
            last = tops[-1]
            lower = value - last.value
            if lower <= 0.0:
                break
            del tops[-1]
            if lower < two_steps:
                if lower < 1.5 * step:
                    one_below += last.on
                    two_below += last.one_below
                else:
                    two_below += last.on
        else:
            lower = -math.inf
        if lower == 0.0:
            last.on += on  # those below it were added when they came
            return last
        if -lower < two_steps:
            if -lower < 1.5 * step:
                last.one_below += on
            else:
                last.two_below += on
        if len(tops) == REMEMBERED:
            del tops[next((k for k, one in enumerate(tops) if one.pile is None), 0)]
        new = Top(value, hop, on, one_below, two_below)
        tops.append(new)
        return new if on >= LONG_STAY else None

    def pile_up(self, top: Top, at: AxisHops, h: int, hop: int) -> None:
        """Count the samples of hop h that are on its top."""
        self._changed = True
        pile = top.pile
        if pile is None:
            pile = top.pile = Pile(at.runs.rate())
        pile.rate = pile.rate or at.runs.rate()
        is_arrival = hop - pile.last > 1
        if is_arrival:
            pile.before = pile.at_it, pile.stays
        fresh = pile.count(at, h, self._axis, self._side, top.value)
        pile.last = hop
        if not fresh:
            return
        if is_arrival:
            pile.arrivals += 1
            if pile.arrivals > 1:
                pile.met += self._coincidence(top, at.step[h], hop)

    def _coincidence(self, top: Top, step: float, hop: int) -> float:
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


class AxisRails:
    """Both rails of an axis."""

    def __init__(self, axis: int) -> None:
        self._axis = axis
        self._high, self._low = (Rail(side, axis) for side in range(SIDES))
        self._hops = 0
        self._usual = 0.0  # mean change from sample to sample while driving

    def step(self, at: AxisHops, h: int, moving: bool, stuck: bool) -> bool:
        """Take hop h, which has samples; return whether the axis is on a rail.

        stuck: whether it was stuck when the hop began; such a hop says nothing of rails.
        """
        high, low = self._high, self._low
        hop = -1
        if stuck:
            high.stick(at.tops[0][h])
            low.stick(at.tops[1][h])
            self._look_at_end(at, h)
        elif moving:
            hop = self._drive(at.level[h])
        return self._weigh(at, h, high.step(at, h, hop), low.step(at, h, hop))

    def step_through(self, at: AxisHops, hops: Sequence[int], moving: Sequence[bool]) -> list[bool]:
        """As `step`, for hops that have samples, in none of which the axis is stuck.

        moving: of all hops of the rows. Most hops only lie below values that were reached before.
        """
        high, low, steps = self._high, self._low, at.step
        (highest, lowest), (on_high, on_low) = at.tops, at.on_tops
        found: list[bool] = []
        is_clear = high.is_clear and low.is_clear
        for h in hops:
            if not (is_clear and moving[h]):
                found.append(self.step(at, h, moving[h], stuck=False))
                is_clear = high.is_clear and low.is_clear
                continue
            hop, value, other = self._drive(at.level[h]), highest[h], lowest[h]
            high.recent.append(value)
            low.recent.append(other)
            top = high.reached(value, on_high[h], steps[h], hop)
            bottom = low.reached(other, on_low[h], steps[h], hop)
            if top is None and bottom is None:
                found.append(False)
                continue
            if top is not None:
                high.pile_up(top, at, h, hop)
            if bottom is not None:
                low.pile_up(bottom, at, h, hop)
            found.append(self._weigh(at, h, top is not None, bottom is not None))
            is_clear = high.is_clear and low.is_clear
        return found

    def _drive(self, level: float) -> int:
        """Take a hop of driving with this mean change; return its number."""
        hop = self._hops
        self._hops += 1
        self._usual += (level - self._usual) / (hop + 1 if hop < TAIL_HOPS else TAIL_HOPS)
        return hop

    def _weigh(self, at: AxisHops, h: int, is_high: bool, is_low: bool) -> bool:
        """Whether the axis is on a rail after hop h; which of them have to be weighed again."""
        high, low = self._high, self._low
        if (is_high or is_low) and self._has_tail(at.step[h]):
            if is_high:
                high.weigh(at, h)
            if is_low:
                low.weigh(at, h)
        if high.surprise > 0.0 or low.surprise > 0.0:
            both = high.surprise + low.surprise > BOTH_ENDS
            for rail in (high, low):
                is_sure = rail.surprise > SURPRISE or (both and rail.surprise > 0.0)
                if is_sure and not rail.found:
                    rail.on_rail()
        return high.found or low.found

    def _has_tail(self, step: float) -> bool:
        high, low = self._high.recent, self._low.recent
        return bool(high) and max(high) + max(low) >= LEAST_STEPS * step

    def _look_at_end(self, at: AxisHops, h: int) -> None:
        """The axis was stuck: has that ended, and was it a rail that held it?"""
        rows, first = at.rows, at.rows.edges[h]
        own = rows.samples[self._axis, first : rows.edges[h + 1]]
        value = float(rows.previous(first)[self._axis])
        other = np.flatnonzero(own != value)
        if not len(other) or not self._has_tail(at.step[h]):
            return
        change = float(own[other[0]]) - value
        if abs(change) > USUAL_CHANGE * max(self._usual, at.step[h]):
            return
        if self._high.is_held(value, -change):
            self._high.on_rail(value)
        if self._low.is_held(-value, change):
            self._low.on_rail(-value)
