"""Rails: the values at the two ends of an axis's range.

An axis within its range reaches its largest value only once, by chance. A rail is reached again and
again, and the axis stays there. Data that repeat to the last bit, such as a recording in a loop,
are counted only once.

For each side of an axis, the extremes that no later value has exceeded are stored, from high to
low. The number of samples on a value, and one and two steps below this value, shows whether the
value is the end of a range. A whole recording shows more of a rail than the samples so far: see
`recorded_health`.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from msgspec import Struct, field

from imucald.motion.hops import AxisHops
from imucald.motion.sensor_judges import rate_of

LONG_STAY = 4
"""Smallest number of samples on a value that is reached for the first time. With fewer samples, the
value is ignored."""
TAIL_HOPS = 120
"""Number of driving hops (a minute) whose largest values form the tail of an axis's
distribution."""
REMEMBERED = 64
"""Largest number of stored values that no later value has exceeded. Each value is lower than the
value stored before, so few values are needed."""


LEAST_AT_EXTREME = 5
PILE = 1.3
"""Ratio of samples from which an extreme is a rail (end of the range): samples on the extreme to
samples on each of the two steps below it.

The codes of a converter differ in width by about 30 % (differential nonlinearity of 0.3 LSB).
"""
STAYS_COUNT = 0.5
"""Weight of the evidence from samples that equal the sample before. The weight is below 1 because
neighbouring samples are not independent."""
MOST_SAMPLES = 512


LEAST_TAIL_HOPS = 30
"""Number of driving hops (15 s) after which the tail of an axis's distribution is known."""
LEAST_STEPS = 8
"""Smallest range of an axis in steps, from end to end. A signal with a smaller range has no
tail."""
SURPRISE = 18.5
"""-log of the probability of the data without a rail, from which a rail is accepted [nats]: a
chance of 1e-8. Six axes with two ends have about 1e7 driving hops (half a second each) in 100 h.
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


class Pile(Struct):
    """Evidence that a value is a rail (end of the range).

    rate: -log of the probability that a sample equals the sample before [nats], known from earlier
    samples. at_it: number of samples with the value. stays: number of these samples that equal the
    sample before. met: -log of the probability that the axis arrives again and again within the
    same step [nats]. first, last: first and last hop (half a second) of driving in which the value
    was reached. seen: samples, each with the sample before, so that data that repeat to the last
    bit count once.
    before: at_it and stays at the last arrival.
    """

    rate: float
    at_it: int = 0
    stays: int = 0
    arrivals: int = 0
    first: int = -2
    last: int = -2
    met: float = 0.0
    seen: dict[bytes, None] = field(default_factory=dict)  # in the order in which they came
    before: tuple[int, int] = (0, 0)

    def is_higher(self, one_below: float, two_below: float) -> bool:
        """Return whether the value has more samples than the tail of a distribution would have.

        one_below, two_below: number of samples one and two steps below the value.
        """
        return self.at_it >= LEAST_AT_EXTREME and self.at_it > PILE * max(one_below, two_below)

    @property
    def surprise(self) -> float:
        """-log of the probability of all observations if the value is not a rail [nats]."""
        return self.met + STAYS_COUNT * more_often(self.stays, self.at_it, self.rate)

    def count(self, at: AxisHops, h: int, sample: float) -> bool:
        """Count the new samples of hop h (half a second) with the value `sample`. Returns True if
        there are new samples. A sample that was sent twice is not new.
        """
        rows, at_it, seen = at.rows, self.at_it, self.seen
        for k in (rows.edges[h] + np.flatnonzero(at.samples(h) == sample)).tolist():
            if len(seen) == MOST_SAMPLES:
                break
            two = np.stack([rows.previous(k), rows.samples[:, k]], 1)
            of_axes = two.tolist()
            if all(before == now for before, now in of_axes):
                continue
            known = len(seen)
            seen[two.tobytes()] = None
            if len(seen) > known:
                self.at_it += 1
                self.stays += of_axes[at.axis][0] == sample
        return self.at_it > at_it

    def count_stay_once(self) -> None:
        """Count all samples since the last arrival as a single sample."""
        at_it, self.stays = self.before
        self.at_it = min(self.at_it, at_it + 1)
        while len(self.seen) > self.at_it:
            self.seen.popitem()


def more_often(stays: int, of: int, rate: float) -> float:
    """Return -log of the probability of at least this many stays [nats].

    stays: number of samples that equal the sample before. of: number of all samples. rate: each
    sample equals the sample before with the probability exp(-rate). The result is Chernoff's bound
    of the binomial distribution's tail; 0 if the stays are not more frequent than this probability.
    """
    chance = math.exp(-rate)
    share = stays / of if of else 0.0
    if share <= chance:
        return 0.0
    left = (1.0 - share) * math.log((1.0 - share) / (1.0 - chance)) if share < 1.0 else 0.0
    return of * (share * (math.log(share) + rate) + left)


class Extreme(Struct):
    """A watched value: no later value has exceeded it.

    hop: driving hop (half a second) in which it was reached first. on, one_below, two_below: number
    of samples on it, and one and two steps below it, as far as these are the largest values of
    their hops. pile: evidence that it is a rail; None while nothing was counted.
    """

    value: float
    hop: int
    on: int
    one_below: int = 0
    two_below: int = 0
    pile: Pile | None = None


class Rail:
    """Decides whether the largest value of one side of an axis is the end of its range.

    Without a rail, it is improbable that the peaks of a tail fall into the same step, or that
    samples stay there while other axes move. On a rail, such peaks and stays are usual. Every value
    that no later value has exceeded is watched, so that a value reached before the rail existed
    does not hide the rail. Only driving counts. The rail is dropped when a value lies beyond it, or
    when driving no longer reaches it. A stay is counted only when it has ended. A stuck axis is not
    a rail, and its stay counts as one arrival.

    A *surprise* is -log of the probability that the observed peaks and stays come from an axis
    without a rail [nats]. A large surprise therefore means a rail.

    - sign: 1 for the upper side, -1 for the lower side. All values of the lower side are negated.
    - least: smallest surprise of a rail [nats].
    - hops: number of driving hops (half a second each).
    - recent: largest values of the last driving hops.
    - surprise: surprise of the most likely rail [nats].
    - value: value of this rail; inf if there is no evidence.
    - rail: value of the last rail that was found; -inf if there was none.
    - found: True while the axis has a rail.
    - changed: True if the surprise must be computed again.
    """

    def __init__(self, sign: float, least: float) -> None:
        self.sign, self._least = sign, least
        self._extremes: list[Extreme] = []  # from high to low
        self.hops = 0
        self.recent: deque[float] = deque(maxlen=TAIL_HOPS)
        self.rail = -math.inf
        self._untouched, self._pauses, self._touches = 0, 0.0, 0
        self.found = self.changed = False
        self.surprise, self.value = 0.0, math.inf

    def go_on(self, value: float, step: float, moving: bool) -> None:
        """Update the rail with the largest value of a hop (half a second).

        The rail is dropped if the value lies beyond it. step: smallest change so far.
        """
        if self.found:
            half = 0.5 * step
            if value > self.rail + half:
                self.found = False
            elif value >= self.rail - half:
                self._touch(self._untouched)
            elif moving:
                self._untouched += 1
                if self._is_left():
                    self._forget()
        if value > self.value:
            self.surprise, self.value = 0.0, math.inf

    def stand(self, value: float) -> None:
        """Process the largest value of a hop (half a second) in which the vehicle stands or the
        axis is stuck."""
        while self._extremes and self._extremes[-1].value < value:
            self._extremes.pop()

    def drive(self, at: AxisHops, h: int, value: float, on: int) -> None:
        """Process the largest value of driving hop h (half a second), and its number of samples.

        The samples are counted if there are many, or if the value was reached before.
        """
        self.recent.append(value)
        self.hops += 1
        step, known, new = at.step[h], self._extremes, Extreme(value, self.hops - 1, on)
        while known and known[-1].value < value:
            below = known.pop()
            if value - below.value < 1.5 * step:
                new.one_below += below.on
                new.two_below += below.one_below
            elif value - below.value < 2.5 * step:
                new.two_below += below.on
        if known and known[-1].value == value:
            known[-1].on += on  # those below it were added when they came
            self._pile_up(known[-1], at, h)
            return
        if known and known[-1].value - value < 1.5 * step:
            known[-1].one_below += on
        elif known and known[-1].value - value < 2.5 * step:
            known[-1].two_below += on
        if len(known) == REMEMBERED:
            known.pop(next((k for k, one in enumerate(known) if one.pile is None), 0))
        known.append(new)
        if on >= LONG_STAY:
            self._pile_up(new, at, h)

    def stick(self, value: float) -> None:
        """Note that the axis is stuck at a value. The stuck axis is the reason for the stay, not a
        rail.
        """
        last = self._extremes[-1] if self._extremes else None
        if last is not None and last.value == value and last.pile is not None:
            last.pile.count_stay_once()

    def is_held(self, value: float, left_by: float) -> bool:
        """Return whether a rail holds an axis that was stuck at a value.

        An axis can stick at any value, but the end of a range is the largest value of a minute's
        drive. left_by: present distance of the axis from the value, negative if the axis is beyond
        the value.
        """
        recent = self.recent
        return len(recent) >= LEAST_TAIL_HOPS and left_by > 0.0 and value >= max(recent)

    def weigh(self, last: float) -> None:
        """Choose the most likely rail among the watched values. last: the last sample."""
        now = self.sign * last
        # Once the value is left, nothing changes before the next arrival.
        self.changed = bool(self._extremes) and now == self._extremes[-1].value
        piles = [
            (one.pile.surprise, one.value)
            for one in self._extremes
            if one.pile is not None
            and now < one.value
            and one.pile.is_higher(one.one_below, one.two_below)
            and not self._is_apart(one.value)
        ]
        self.surprise, self.value = max(piles, default=(0.0, math.inf))

    def on_rail(self, value: float | None = None) -> None:
        """Set the value of the rail; None: the most likely value."""
        self.found, self.rail = True, self.value if value is None else value
        self._pauses, self._touches = 0.0, 0
        pile = next((one.pile for one in self._extremes if one.value == self.rail), None)
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
        self.found = self.changed = False
        self.surprise, self.value = 0.0, math.inf
        for one in self._extremes:
            one.pile = None

    def _is_apart(self, value: float) -> bool:
        """Return whether a value is further from all other peaks than these peaks are from each
        other.

        The end of a range cuts a tail off, so other peaks are close to the end. A contact that
        opens causes a jump, for example to zero, over values that never occur.
        """
        below = np.sort([peak for peak in self.recent if peak < value])
        n = len(below)
        return bool(n >= LEAST_TAIL_HOPS and value - below[-1] > below[-1] - below[n // 2])

    def _pile_up(self, extreme: Extreme, at: AxisHops, h: int) -> None:
        """Count the samples of hop h (half a second), the last driving hop, on the lowest watched
        value."""
        self.changed = True
        hop, rate = self.hops - 1, rate_of(*at.runs[h])
        pile = extreme.pile = extreme.pile or Pile(rate, first=hop)
        pile.rate = pile.rate or rate
        is_arrival = hop - pile.last > 1
        if is_arrival:
            pile.before = pile.at_it, pile.stays
        fresh = pile.count(at, h, self.sign * extreme.value)
        pile.last = hop
        if not fresh:
            return
        if is_arrival:
            pile.arrivals += 1
            if pile.arrivals > 1:
                pile.met += self._coincidence(extreme.value, hop - extreme.hop, at.step[h])

    def _coincidence(self, value: float, age: int, step: float) -> float:
        """Return -log of the probability that one more peak of the tail falls into the same step
        [nats]. age: number of driving hops (half a second each) since the value was reached first.
        """
        n = min(age + 1, TAIL_HOPS)
        if n < LEAST_TAIL_HOPS:
            return 0.0
        peaks = np.array(self.recent)[-n:]
        on = int(np.count_nonzero(peaks == value))
        broad = min(BROAD * on, n)
        low = float(np.partition(peaks, n - broad)[n - broad])
        if low >= value:
            return 0.0
        scale = (value - low) / math.log(broad / on)
        return -math.log(-math.expm1(-step / scale))


class AxisRails:
    """Both rails of an axis. least: surprise from which a value is a rail [nats]."""

    def __init__(self, least: float = SURPRISE) -> None:
        self._least = least
        self._usual = 0.0  # mean change from sample to sample while driving
        self.sides = Rail(1.0, least), Rail(-1.0, least)

    @property
    def ends(self) -> tuple[float, float]:
        """Upper and lower end of the range, as the axis shows them (the lower end is not negated).
        Each is the value of the last rail that was found; -inf (upper) or inf (lower) if there was
        none."""
        high, low = self.sides
        return high.rail, -low.rail

    def take_hop(self, at: AxisHops, h: int, moving: bool, stuck: bool) -> bool:
        """Process hop h (half a second), which has samples. Returns whether the axis is on a rail.

        stuck: True if the axis was stuck when the hop began. Such a hop is no evidence about rails.
        """
        both = tuple(zip(self.sides, at.tops, at.on_tops, strict=True))
        if stuck:
            for rail, tops, _ in both:
                rail.stick(tops[h])
            self._look_at_end(at, h)
        for rail, tops, on_tops in both:
            rail.go_on(tops[h], at.step[h], moving)
            if moving and not stuck:
                rail.drive(at, h, tops[h], on_tops[h])
            else:
                rail.stand(tops[h])
        if moving and not stuck:
            self._usual += (at.level[h] - self._usual) / min(self.sides[0].hops, TAIL_HOPS)
        high, low = self.sides
        if (high.changed or low.changed) and self._has_tail(at.step[h]):
            last = float(at.samples(h)[-1])
            for rail in self.sides:
                if rail.changed:
                    rail.weigh(last)
        for rail in self.sides:
            if rail.surprise > self._least and not rail.found:
                rail.on_rail()
        return high.found or low.found

    def _has_tail(self, step: float) -> bool:
        if not self.sides[0].recent:
            return False
        return sum(max(rail.recent) for rail in self.sides) >= LEAST_STEPS * step

    def _look_at_end(self, at: AxisHops, h: int) -> None:
        """Check whether an axis that was stuck is free again, and whether a rail held it."""
        own, value = at.samples(h), at.previous(h)
        other = np.flatnonzero(own != value)
        if not len(other) or not self._has_tail(at.step[h]):
            return
        change = float(own[other[0]]) - value
        if abs(change) > USUAL_CHANGE * max(self._usual, at.step[h]):
            return
        for rail in self.sides:
            if rail.is_held(rail.sign * value, -rail.sign * change):
                rail.on_rail(rail.sign * value)
