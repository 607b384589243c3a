"""Rails: the values at the two ends of an axis's range.

An axis within its range reaches its largest value only once, by chance. A rail is reached again and
again, and the axis stays there. Data that repeat to the last bit, such as a recording in a loop,
are counted only once.

For each side of an axis, the extremes that no later value has exceeded are stored, from high to
low. The number of samples on a value, and one and two steps below this value, shows whether the
value is the end of a range. A whole recording shows more of a rail than the samples so far: see
`recorded_health`. The compiled code (`core/kernels/rails.c`) processes successive hops up to the
first hop (half a second) that needs further tests. `rail_hops` does the same.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from imucald.core import compiled
from imucald.core.arrays import Array, Flags, Index
from imucald.core.compiled import Kernel
from imucald.motion.hops import SIDES
from imucald.motion.rail_evidence import LEAST_AT_EXTREME, AxisHops, Pile

LONG_STAY = 4
"""Smallest number of samples on a value that is reached for the first time. With fewer samples, the
value is ignored."""
TAIL_HOPS = 120
"""Number of driving hops (a minute) whose largest values form the tail of an axis's
distribution."""
REMEMBERED = 64
"""Largest number of stored values that no later value has exceeded. Each value is lower than the
value stored before, so few values are needed."""


class Top(Struct):
    """A value that no later value has exceeded.

    born: hop (half a second) in which the value was reached. on: number of samples on the value.
    one_below,
    two_below: number of samples one and two steps below the value, as far as they are the largest
    values of their hops.
    """

    value: float
    born: int
    on: int
    one_below: int
    two_below: int


class TopRows:
    """The stored extremes of one side: rows of an array (`REMEMBERED` + 1, 6), of which depth (1,)
    are used.

    The sixth column is 1 if the samples with the extreme value are counted in `piles`, by value.
    recent: (`TAIL_HOPS`,) ring buffer with the largest values of the last driving hops (half a
    second each). hops: (1,) number of driving hops.
    """

    def __init__(self, rows: Array, depth: Index, recent: Array, hops: Index) -> None:
        self._rows, self._depth = rows, depth
        self._recent, self._hops = recent, hops
        self.piles: dict[float, Pile] = {}

    @property
    def recent(self) -> Sequence[float]:
        """Largest values of the last driving hops (half a second each)."""
        hops = int(self._hops[0])
        ring: list[float] = self._recent.tolist()
        at = hops % TAIL_HOPS
        return ring[:hops] if hops < TAIL_HOPS else ring[at:] + ring[:at]

    @property
    def newest(self) -> float:
        """Largest value of the last driving hop (half a second)."""
        return self._recent.item((int(self._hops[0]) - 1) % TAIL_HOPS)

    def _top(self, k: int) -> Top:
        value, born, on, one_below, two_below, _ = self._rows[k].tolist()
        return Top(value, int(born), int(on), int(one_below), int(two_below))

    @property
    def last(self) -> Top | None:
        """The lowest stored extreme; None if there is none."""
        depth = int(self._depth[0])
        return self._top(depth - 1) if depth else None

    def drop_below(self, value: float) -> None:
        """Drop the stored extremes below a value that was reached."""
        _drop_below(self._rows, self._depth, value)
        self.forget_below(value)

    def forget_below(self, value: float) -> None:
        """Stop counting the samples on values below this value."""
        for one in [one for one in self.piles if one < value]:
            del self.piles[one]

    def below(self, value: float) -> tuple[int, int]:
        """Return the number of samples one step and two steps below a stored extreme."""
        top = self._top(int(np.argmax(self._rows[: self._depth[0], 0] == value)))
        return top.one_below, top.two_below

    def add_pile(self, top: Top, pile: Pile) -> None:
        """Begin to count the samples on the lowest stored extreme."""
        self.piles[top.value] = pile
        self._rows[self._depth[0] - 1, 5] = 1.0


class AxisTops:
    """The stored extremes of both sides of an axis."""

    def __init__(self) -> None:
        self._rows = np.zeros((SIDES, REMEMBERED + 1, 6))
        self._depth = np.zeros(SIDES, np.int64)
        self._usual, self._hops = np.zeros(1), np.zeros(1, np.int64)
        self._recent = np.zeros((SIDES, TAIL_HOPS))
        self._found = np.empty(3 * SIDES)
        self.sides = [
            TopRows(self._rows[k], self._depth[k : k + 1], self._recent[k], self._hops)
            for k in range(SIDES)
        ]

    @property
    def usual(self) -> float:
        """Mean change from sample to sample while driving."""
        return self._usual.item(0)

    @property
    def hops(self) -> int:
        """Number of driving hops (half a second each)."""
        return self._hops.item(0)

    def take_hops(
        self, at: AxisHops, hops: Index, begin: int, moving: Flags
    ) -> tuple[int, list[Top | None]]:
        """Process hops from index `begin` on, up to the first hop (half a second) whose largest
        values need further tests.

        moving: flags of all hops. Returns the index of this hop and, for each side, the extreme to
        be tested. If no hop needs further tests, the index is that of the first hop that was not
        taken.
        """
        kernel: Kernel = rail_hops if compiled.kernels is None else compiled.kernels.rail_hops
        stopped: int = kernel(
            hops, begin, moving, *at.in_rows,
            self._rows, self._depth, self._usual, self._hops, self._recent, self._found,
        )  # fmt: skip
        high, low, *largest = self._found.tolist()
        reached: list[Top | None] = []
        for side, is_reached, value, dropped in zip(
            self.sides, (high, low), largest[:2], largest[2:], strict=True
        ):
            if side.piles:
                side.forget_below(value)
                side.piles.pop(dropped, None)
            reached.append(side.last if is_reached else None)
        return stopped, reached


def rail_hops(
    hops: Index,
    begin: int,
    moving: Flags,
    tops: Array,
    on_tops: Index,
    steps: Array,
    levels: Array,
    rows: Array,
    depth: Index,
    usual: Array,
    count: Index,
    recent: Array,
    found: Array,
) -> int:
    """Do the same as `core/kernels/rails.c`, where the arguments are documented."""
    found[:] = (0.0,) * SIDES + (-math.inf,) * SIDES + (math.nan,) * SIDES
    weighed, largest, dropped = found.reshape(3, SIDES)
    for k in range(begin, len(hops)):
        h = hops[k]
        largest[:] = np.maximum(largest, tops[:, h])
        if not moving[h]:
            for side in range(SIDES):
                _drop_below(rows[side], depth[side : side + 1], tops[side, h])
            continue
        hop = int(count[0])
        count[0] += 1
        usual[0] += (levels[h] - usual[0]) / (hop + 1 if hop < TAIL_HOPS else TAIL_HOPS)
        recent[:, hop % TAIL_HOPS] = tops[:, h]
        for side in range(SIDES):
            value, on = float(tops[side, h]), float(on_tops[side, h])
            own = rows[side], depth[side : side + 1]
            weighed[side], let_go = _reach(*own, value, on, float(steps[h]), hop)
            if not math.isnan(let_go):
                dropped[side] = let_go
        if weighed.any():
            return k
        if not np.isnan(dropped).all():
            return k + 1
    return len(hops)


def _drop_below(rows: Array, depth: Index, value: float) -> None:
    while depth[0] and rows[depth[0] - 1, 0] < value:
        depth[0] -= 1


def _reach(
    rows: Array, depth: Index, value: float, on: float, step: float, hop: int
) -> tuple[bool, float]:
    """Store a value as the latest extreme of a side. Stored extremes below this value are dropped.

    on: number of samples of the hop (half a second) with this value. The first result is True if
    the value needs further tests, because many samples have it or it was reached before. The second
    result is the value whose pile was dropped for lack of room; NaN if there is none.
    """
    n, one_below, two_below, lower = int(depth[0]), 0.0, 0.0, -math.inf
    while n:
        top, _, on_it, below_it, *_ = rows[n - 1].tolist()
        lower = value - top
        if lower <= 0.0:
            break
        n, lower = n - 1, -math.inf if n == 1 else lower
        if value - top < 1.5 * step:
            one_below, two_below = one_below + on_it, two_below + below_it
        elif value - top < 2.5 * step:
            two_below += on_it
    depth[0] = n
    if lower == 0.0:
        rows[n - 1, 2] += on  # those below it were added when they came
        return True, math.nan
    if -lower < 2.5 * step:
        rows[n - 1, 3 if -lower < 1.5 * step else 4] += on
    let_go = math.nan
    if n == REMEMBERED:
        free = np.flatnonzero(rows[:n, 5] == 0.0)
        k = int(free[0]) if len(free) else 0
        let_go = math.nan if len(free) else float(rows[k, 0])
        rows[k : n - 1] = rows[k + 1 : n]
        n -= 1
    rows[n] = value, hop, on, one_below, two_below, 0.0
    depth[0] = n + 1
    return on >= LONG_STAY, let_go


LEAST_TAIL_HOPS = 30
"""Number of driving hops (15 s) after which the tail of an axis's distribution is known."""
LEAST_STEPS = 8
"""Smallest range of an axis in steps, from end to end. A signal with a smaller range has no
tail."""
SURPRISE = 18.5
"""-log of the probability of the data without a rail, from which a rail is accepted [nats]: a
chance of 1e-8. Six axes with two ends have about 1e7 driving hops (half a second each) in 100 h.
"""
BOTH_ENDS = 4.0
"""Additional surprise that the sum of two surprises needs if both ends of the range are reached.
The value follows from x + log(1 + x).
"""
BROAD = 3
"""Number of peaks that form the tail of the distribution, as a multiple of the number of peaks at
the largest value. The scale of the tail is measured over these peaks."""
UNTOUCHED = TAIL_HOPS, 5 * TAIL_HOPS
"""Smallest and largest number of driving hops (half a second each) without contact after which a
rail is dropped: one minute and five minutes. Between one and five minutes, a rail is dropped after
`SURPRISE` times its usual pause. The probability that a true rail has so long a pause equals the
chance of a false rail. One minute of driving is enough to know the tail of the values.
"""
USUAL_CHANGE = 4.0
"""Largest change with which an axis leaves a rail, as a multiple of its mean change from sample to
sample (three standard deviations of noise). A contact that closes again causes a larger change.
"""


class Rail:
    """Decides whether the largest value of one side of an axis is the end of its range.

    Without a rail, it is improbable that the peaks of a tail fall into the same step, or that
    samples stay there while other axes move. On a rail, such peaks and stays are usual. Every value
    that no later value has exceeded is watched, so that a value reached before the rail existed
    does not hide the rail. Only driving counts. The rail is dropped when a value lies beyond it, or
    when driving no longer reaches it. surprise: -log of the probability of the data without a rail
    [nats]. A stay is counted only when it has ended. A stuck axis is not a rail, and its stay
    counts as one arrival.
    value: value to which the surprise belongs. least: surprise from which the value is a rail.
    """

    def __init__(self, side: int, axis: int, tops: TopRows, least: float) -> None:
        self._side, self._axis, self._tops, self._least = side, axis, tops, least
        self._rail = -math.inf
        self._changed = False
        self._untouched, self._pauses, self._touches = 0, 0.0, 0
        self.found = False
        self.surprise, self.value = 0.0, math.inf

    @property
    def last(self) -> float:
        """Value of the last rail, negated on the lower side; -inf if there was none."""
        return self._rail

    def go_on(self, at: AxisHops, h: int, moving: bool) -> None:
        """Update the rail with hop h (half a second).

        The rail is dropped if a value lies beyond it.
        """
        value = at.tops[self._side][h]
        if self.found:
            half = 0.5 * at.smallest_change[h]
            if value > self._rail + half:
                self.found = False
            elif value >= self._rail - half:
                self._touch(self._untouched)
            elif moving:
                self._untouched += 1
                if self._is_left():
                    self._forget()
        if value > self.value:
            self.surprise, self.value = 0.0, math.inf

    def stand(self, at: AxisHops, h: int) -> None:
        """Process hop h (half a second), in which the vehicle stands or the axis is stuck."""
        self._tops.drop_below(at.tops[self._side][h])

    @property
    def recent(self) -> Sequence[float]:
        """Largest values of the last driving hops (half a second each)."""
        return self._tops.recent

    @property
    def changed(self) -> bool:
        """True if the surprise must be computed again."""
        return self._changed

    @property
    def is_clear(self) -> bool:
        """True if there is no evidence of a rail.

        The next hops (half a second each) can then be processed together by `AxisTops.take_hops`.
        """
        return not (self._changed or self.found) and self.value == math.inf

    def stick(self, value: float) -> None:
        """Note that the axis is stuck at a value. The stuck axis is the reason for the stay, not a
        rail.
        """
        top = self._tops.last
        if top is not None and top.value == value and value in self._tops.piles:
            self._tops.piles[value].count_stay_once()

    def is_held(self, value: float, left_by: float) -> bool:
        """Return whether a rail holds an axis that was stuck at a value.

        An axis can stick at any value, but the end of a range is the largest value of a minute's
        drive. left_by: present distance of the axis from the value, negative if the axis is beyond
        the value.
        """
        recent = self.recent
        return len(recent) >= LEAST_TAIL_HOPS and left_by > 0.0 and value >= max(recent)

    def weigh(self, at: AxisHops, h: int) -> None:
        """Choose the most likely rail among the watched values, after hop h (half a second)."""
        last = float(at.rows.samples[self._axis, at.rows.edges[h + 1] - 1])
        now = last if self._side == 0 else -last
        # Once the value is left, nothing changes before the next arrival.
        top = self._tops.last
        self._changed = top is not None and now == top.value
        piles = [
            (pile.surprise, value)
            for value, pile in self._tops.piles.items()
            if pile.at_it >= LEAST_AT_EXTREME
            and now < value
            and pile.is_higher(*self._tops.below(value))
            and not self._is_apart(value)
        ]
        self.surprise, self.value = max(piles, default=(0.0, math.inf))

    def on_rail(self, value: float | None = None) -> None:
        """Set the value of the rail; None: the most likely value."""
        self.found, self._rail = True, self.value if value is None else value
        self._pauses, self._touches = 0.0, 0
        pile = self._tops.piles.get(self._rail)
        if pile is None or pile.arrivals < 2:  # its pauses are not known yet
            self._touch(UNTOUCHED[1])
        else:
            self._touch(pile.last - pile.first, pile.arrivals - 1)

    def _touch(self, pause: int, touches: int = 1) -> None:
        """Note that the value is reached again.

        pause: number of driving hops (half a second each) since the last arrivals. touches: number
        of arrivals in this time.
        """
        self._pauses += pause
        self._touches += touches
        self._untouched = 0

    def _is_left(self) -> bool:
        least, most = UNTOUCHED
        allowed = self._least * self._pauses / self._touches
        return self._untouched > min(max(allowed, least), most)

    def _forget(self) -> None:
        """Forget all evidence for the rail."""
        self.found = self._changed = False
        self.surprise, self.value = 0.0, math.inf
        self._tops.piles.clear()

    def _is_apart(self, value: float) -> bool:
        """Return whether a value is further from all other peaks than these peaks are from each
        other.

        The end of a range cuts a tail off, so other peaks are close to the end. A contact that
        opens causes a jump, for example to zero, over values that never occur.
        """
        below = np.sort([peak for peak in self.recent if peak < value])
        n = len(below)
        return bool(n >= LEAST_TAIL_HOPS and value - below[-1] > below[-1] - below[n // 2])

    def pile_up(self, top: Top, at: AxisHops, h: int, hop: int) -> None:
        """Count the samples of hop h (half a second) that have the value `top`."""
        self._changed = True
        pile = self._tops.piles.get(top.value)
        if pile is None:
            pile = Pile(at.rate(h), first=hop)
            self._tops.add_pile(top, pile)
        pile.rate = pile.rate or at.rate(h)
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
                pile.met += self._coincidence(top, at.smallest_change[h], hop)

    def _coincidence(self, top: Top, step: float, hop: int) -> float:
        """Return -log of the probability that one more peak of the tail falls into the same step
        [nats]."""
        n = min(hop - top.born + 1, TAIL_HOPS)
        if n < LEAST_TAIL_HOPS:
            return 0.0
        peaks = np.array(self._tops.recent)[-n:]
        on = int(np.count_nonzero(peaks == top.value))
        broad = min(BROAD * on, n)
        low = float(np.partition(peaks, n - broad)[n - broad])
        if low >= top.value:
            return 0.0
        scale = (top.value - low) / math.log(broad / on)
        return -math.log(-math.expm1(-step / scale))


class AxisRails:
    """Both rails of an axis. least: surprise from which a value is a rail [nats]."""

    def __init__(self, axis: int, least: float = SURPRISE) -> None:
        self._axis, self._least = axis, least
        self._tops = AxisTops()
        self._high, self._low = (
            Rail(side, axis, own, least) for side, own in enumerate(self._tops.sides)
        )

    @property
    def ends(self) -> tuple[float, float]:
        """Values of the last rails, the upper and the lower; infinite if there was none."""
        return self._high.last, -self._low.last

    def take_hop(self, at: AxisHops, h: int, moving: bool, stuck: bool) -> bool:
        """Process hop h (half a second), which has samples. Returns whether the axis is on a rail.

        stuck: True if the axis was stuck when the hop began. Such a hop is no evidence about rails.
        """
        high, low = self._high, self._low
        if stuck:
            high.stick(at.tops[0][h])
            low.stick(at.tops[1][h])
            self._look_at_end(at, h)
        for rail in (high, low):
            rail.go_on(at, h, moving)
        if stuck or not moving:
            for rail in (high, low):
                rail.stand(at, h)
        else:
            hops, always = np.array([h]), np.ones(len(at.levels), dtype=bool)
            _, tops = self._tops.take_hops(at, hops, 0, always)
            self._pile_up(at, h, tops)
        return self._weigh(at, h, high.changed, low.changed)

    def take_hops(self, at: AxisHops, hops: Sequence[int], moving: Flags) -> list[bool]:
        """Do the same as `take_hop` for hops (half a second each) with samples, if the axis is
        stuck in none of them.

        moving: (H,) flags of all hops of the rows. This function is fast if the values of most hops
        are below values that were reached before.
        """
        high, low = self._high, self._low
        moves: list[bool] = moving.tolist()
        places = np.array(hops, np.int64)
        found: list[bool] = []
        is_clear = high.is_clear and low.is_clear
        while (done := len(found)) < len(hops):
            if not is_clear:
                h = hops[done]
                found.append(self.take_hop(at, h, moves[h], stuck=False))
            else:
                stopped, tops = self._tops.take_hops(at, places, done, moving)
                found += [False] * (stopped - done)
                if tops == [None, None]:
                    continue
                h = hops[stopped]
                self._pile_up(at, h, tops)
                found.append(self._weigh(at, h, tops[0] is not None, tops[1] is not None))
            is_clear = high.is_clear and low.is_clear
        return found

    def _pile_up(self, at: AxisHops, h: int, tops: Sequence[Top | None]) -> None:
        """Count the samples with the values `tops` in the driving hop h (half a second)."""
        for rail, top in zip((self._high, self._low), tops, strict=True):
            if top is not None:
                rail.pile_up(top, at, h, self._tops.hops - 1)

    def _weigh(self, at: AxisHops, h: int, is_high: bool, is_low: bool) -> bool:
        """Return whether the axis is on a rail after hop h (half a second).

        is_high, is_low: True for a side that must be tested again.
        """
        high, low = self._high, self._low
        if (is_high or is_low) and self._has_tail(at.smallest_change[h]):
            if is_high:
                high.weigh(at, h)
            if is_low:
                low.weigh(at, h)
        if high.surprise > 0.0 or low.surprise > 0.0:
            both = high.surprise + low.surprise > self._least + BOTH_ENDS
            for rail in (high, low):
                is_sure = rail.surprise > self._least or (both and rail.surprise > 0.0)
                if is_sure and not rail.found:
                    rail.on_rail()
        return high.found or low.found

    def _has_tail(self, step: float) -> bool:
        if self._tops.hops == 0:
            return False
        high, low = self._tops.sides
        least = LEAST_STEPS * step
        if high.newest + low.newest >= least:
            return True
        return max(high.recent) + max(low.recent) >= least

    def _look_at_end(self, at: AxisHops, h: int) -> None:
        """Check whether an axis that was stuck is free again, and whether a rail held it."""
        rows, first = at.rows, at.rows.edges[h]
        own = rows.samples[self._axis, first : rows.edges[h + 1]]
        value = float(rows.previous(first)[self._axis])
        other = np.flatnonzero(own != value)
        if not len(other) or not self._has_tail(at.smallest_change[h]):
            return
        change = float(own[other[0]]) - value
        if abs(change) > USUAL_CHANGE * max(self._tops.usual, at.smallest_change[h]):
            return
        if self._high.is_held(value, -change):
            self._high.on_rail(value)
        if self._low.is_held(-value, change):
            self._low.on_rail(-value)
