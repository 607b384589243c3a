"""Evidence for a value at which an axis stays exactly: the end of the range, or the value to which
a loose contact jumps.

An axis with a loose contact jumps to a value, keeps exactly this value, and jumps back. The time at
the value is shorter than with a stuck sensor. A sender may also repeat a value because the next
value is late, which gives a run of equal values that noise never causes. Such repeated values are
usual values of the drive, so the axis does not jump to them and away from them.
"""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.motion.hops import HopRows
from imucald.motion.sensor_judges import Runs, rate_of

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


class AxisHops(Struct, frozen=True, dict=True):
    """Statistics of the hops of one axis.

    runs: for each hop (half a second), the number of runs of equal values that ended before the
    hop, and the length of the longest of these runs. levels, steps: (H,) level and step of each
    hop, as in `HopRows`.
    entries: result of `HopRows.entries`. top_values, top_counts: (2, H) top and on_top as in
    `HopRows`, first the upper side, then the lower side. The lists of these arrays are made when
    they are first used.
    """

    axis: int
    rows: HopRows
    entries: Array
    runs: list[tuple[int, int]]

    def rate(self, h: int) -> float:
        """Return the rate of `Pile` from the runs before hop h (half a second)."""
        return rate_of(*self.runs[h])

    @cached_property
    def in_rows(self) -> tuple[NDArray[Any], ...]:
        """top_values, top_counts, steps and levels as contiguous arrays."""
        of = self.top_values, self.top_counts, self.steps, self.levels
        return tuple(np.ascontiguousarray(one) for one in of)

    @property
    def levels(self) -> Array:
        """Level of each hop (H,)."""
        return self.rows.level[:, self.axis]

    @property
    def steps(self) -> Array:
        """Step of each hop (H,)."""
        return self.rows.step[:, self.axis]

    @property
    def top_values(self) -> Array:
        """Largest value of each hop (half a second), and largest negated value (2, H)."""
        return self.rows.top[:, :, self.axis].T

    @property
    def top_counts(self) -> NDArray[np.int64]:
        """Number of samples with the values of `top_values` (2, H)."""
        return self.rows.on_top[:, :, self.axis].T

    @cached_property
    def level(self) -> list[float]:
        """Mean size of the change from sample to sample, for each hop (half a second)."""
        return _listed(self.levels)

    @cached_property
    def entry(self) -> list[float]:
        """Size of the change at which the run at the end of each hop (half a second) began, see
        `HopRows.entries`."""
        return _listed(self.entries[:, self.axis])

    @cached_property
    def smallest_change(self) -> list[float]:
        """Smallest change so far, for each hop (half a second)."""
        return _listed(self.steps)

    @cached_property
    def tops(self) -> list[list[float]]:
        """Largest value of each hop (half a second), and largest negated value, as lists by side
        and hop.
        """
        found: list[list[float]] = self.top_values.tolist()
        return found


def _listed(figures: Array) -> list[float]:
    found: list[float] = figures.tolist()
    return found


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

    def is_higher(self, one_below: int, two_below: int) -> bool:
        """Return whether the value has more samples than the tail of a distribution would have.

        one_below, two_below: number of samples one and two steps below the value.
        """
        return self.at_it >= LEAST_AT_EXTREME and self.at_it > PILE * max(one_below, two_below)

    @property
    def surprise(self) -> float:
        """-log of the probability of all observations if the value is not a rail [nats]."""
        return self.met + STAYS_COUNT * more_often(self.stays, self.at_it, self.rate)

    def count(self, at: AxisHops, h: int, axis: int, side: int, value: float) -> bool:
        """Count the new samples of hop h (half a second) on the value. Returns True if there are
        new samples.

        A sample that was sent twice is not new. side: 0 for the largest value, 1 for the smallest
        value, which is negated.
        """
        samples, first, stop = at.rows.samples, at.rows.edges[h], at.rows.edges[h + 1]
        sample = value if side == 0 else -value
        at_it, seen = self.at_it, self.seen
        for k in (first + np.flatnonzero(samples[axis, first:stop] == sample)).tolist():
            if len(seen) == MOST_SAMPLES:
                break
            two = samples[:, k - 1 : k + 1] if k else np.stack([at.rows.before, samples[:, 0]], 1)
            of_axes = two.tolist()
            if all(before == now for before, now in of_axes):
                continue
            known = len(seen)
            seen[two.tobytes()] = None
            if len(seen) > known:
                self.at_it += 1
                self.stays += of_axes[axis][0] == sample
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


JUMP = 5.0
"""Smallest jump, as a multiple of the mean non-zero change of the axis: four standard deviations of
normal changes. (An axis that is coarser than its noise changes seldom, and then by its step.) The
chance that a repeated value begins and ends with such a change is 4e-9. There are about 1e5 late
values in 100 h.
"""
MIN_RUN = 3
"""Shortest run of equal values that is used. Noise causes shorter runs."""


class LostContact:
    """Detects a loose contact of one axis, hop by hop (half a second each)."""

    def __init__(self) -> None:
        self._open = 0  # samples of the run at the end of the last hop
        self._entry = 0.0  # the change with which it began
        self._change = 0.0
        self._changes = 0

    def restart(self) -> None:
        """Restart after a jump of time."""
        self._open, self._entry = 0, 0.0

    def take_hop(
        self, at: AxisHops, h: int, axis: int, counts: tuple[int, int, int, int], usual: Runs
    ) -> tuple[bool, bool]:
        """Process hop h (half a second) of an axis.

        counts: count, ended, longest and run of the axis, as in `HopRows`. usual: the runs of equal
        values of this axis so far. The first result is True if a run between two jumps ended in the
        hop and was longer than the usual runs. The second result is True if the longest run of the
        hop must not be used for learning.
        """
        count, ended, longest, run = counts
        found = jumped = False
        if longest >= MIN_RUN and longest > usual.longest:
            lasted = self._between_jumps(at.rows, h, axis)
            jumped = longest == lasted
            found = lasted > usual.limit()
        if not jumped:
            self._change += at.level[h] * count
            self._changes += ended
        if run <= count:  # it began in this hop
            self._entry = at.entry[h]
        self._open = run
        return found, jumped

    def _between_jumps(self, rows: HopRows, h: int, axis: int) -> int:
        """Return the length of the longest run between two jumps that ended in the hop (half a
        second) [samples]."""
        first, last = int(rows.edges[h]), int(rows.edges[h + 1])
        values = rows.samples[axis, first:last]
        change = np.abs(np.diff(values, prepend=rows.previous(first)[axis]))
        new = np.flatnonzero(change)
        lasted = np.diff(new, prepend=-self._open)
        size: NDArray[np.float64] = change[new]
        entry = np.append(self._entry, size[:-1])
        jump = JUMP * self._change / self._changes if self._changes else math.inf
        return int(lasted[(entry > jump) & (size > jump)].max(initial=0))
