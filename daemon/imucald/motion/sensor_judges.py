"""What makes a sensor's samples unfit to be used: one judge a kind of fault, hop by hop.

Each learns from the sensor itself what is usual for it. A judge says whether the fault is there
now; how long it is believed to last is the business of `sample_health`.
"""

from __future__ import annotations

import math
from bisect import insort

import numpy as np
from numpy.typing import NDArray

from imucald.motion.hops import HOP_S, SIDES, WINDOW_HOPS, HopRows
from imucald.motion.physical_limits import ROAD_FORCE

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SURPRISE = 25.0
"""A fault is believed from this -log of the chance of it without one on [nats]: 1e-11, of some 1e8
runs that six axes have in 100 h."""
SHORTEST_HOPS = 2
"""No run shorter than two whole hops is stuck (1 s): senders repeat a value that is late."""
MIN_RUNS = 50
"""Runs from which their lengths are known."""
LEAST_TIMES = 3.0
"""No run shorter than so many times the longest before is stuck, however many there were."""
FINE_STEP = 0.6
"""At rest a step of at most so much of the noise is needed: room for a sensor 1.7 times quieter."""
DEAD_HOPS = 40
"""An axis that never changed is dead after so many hops of driving (20 s): no road is that smooth,
whatever the sensor's step."""
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
FORCE_HOPS = 2
"""Hops of a mean force unlike gravity (1 s)."""
MAX_RATE = math.radians(150.0)
RATE_HOPS = 3
"""No road vehicle turns at that rate [rad/s] for so many hops (1.5 s): that is over half a turn."""
UNIT_HOPS = 5
"""Two hops are held against two before, with one between in which the unit may have changed."""
UNIT_LEEWAY = 2.2
"""Factor by which the noise of a second may be off: 1.3 with 10 samples, and what the road adds."""
OTHER_CHANGE = 4.0
"""A road that became rough is felt by the other sensor too: then it is no unit."""


class Runs:
    """Lengths of the runs of equal values that ended by themselves."""

    def __init__(self) -> None:
        self.count = self.longest = 0

    def rate(self) -> float:
        """-log of the chance that a run goes on, for one more sample [nats]; 0: not known.

        The longest of N lengths, spread exponentially as those of noise are, is near log N times
        their scale.
        """
        return 0.0 if self.count < MIN_RUNS else math.log(self.count) / max(self.longest, 1)

    def limit(self) -> float:
        """A run of more samples is stuck."""
        rate = self.rate()
        if rate == 0.0:
            return math.inf
        return max(SURPRISE / rate, LEAST_TIMES * self.longest)


class StuckAxis:
    """Whether an axis says the same again and again.

    A run of equal values is weighed by the runs before it, at rest and in motion apart. At rest
    only the sensor's noise moves a value, and an engine that stops takes the rest away: there only
    an axis is judged whose step is finer than that noise. noise: of a usual sensor of the kind, in
    SI units per root of hertz.
    """

    def __init__(self, noise: float) -> None:
        self._noise = noise
        self.moving, self._resting = Runs(), Runs()
        self._moved_run = self._moved_hops = self._hops = 0
        self._rested = False
        self._all_hops = 0
        self.stuck = False

    def restart(self) -> None:
        """Time jumped."""
        self._moved_run = self._moved_hops = self._hops = 0
        self._rested = False

    def step(self, moving: bool, count: int, ended: int, longest: int, run: int, q: float) -> bool:
        """Take a hop; whether the axis is stuck at its end.

        count, ended, longest, run, q: of the axis, as `HopRows` has count .. run and step.
        """
        self._all_hops += 1
        if ended:
            if not self.stuck:  # else the longest is the one that was stuck
                is_old = longest > count and self._rested
                pool = self.moving if moving and not is_old else self._resting
                pool.count += ended
                pool.longest = max(pool.longest, longest)
            if self._hops:
                self._moved_run = self._moved_hops = self._hops = 0
            self._rested = not moving
            self.stuck = False
            return False
        self._hops += 1
        if moving:
            self._moved_run += count
            self._moved_hops += 1
        else:
            self._rested = True
        self.stuck = self.stuck or self._is_stuck(run, q)
        return self.stuck

    def _is_stuck(self, run: int, q: float) -> bool:
        if self._moved_hops >= SHORTEST_HOPS:
            if self._moved_run > self.moving.limit():
                return True
            if self.moving.count < MIN_RUNS and self._moved_hops >= DEAD_HOPS:
                return True
        changes = (self.moving.count + self._resting.count) / (self._all_hops * HOP_S)
        if self._hops < SHORTEST_HOPS or q > FINE_STEP * self._noise * math.sqrt(0.5 * changes):
            return False
        return run > self._resting.limit()


class Rail:
    """Whether the largest value of an axis, of one side, is the end of its range.

    Peaks that meet in one step of a tail, and samples that stay there while other axes move, are
    improbable; on a rail they are the rule. Only driving counts, window by window, so that what was
    reached before the rail was there does not hide it; an extreme that comes again in a later one
    goes on counting. It is no rail when a value lies beyond.
    """

    def __init__(self) -> None:
        self._former: dict[float, tuple[int, int, int, list[int]]] = {}
        self._extreme, self._at_it = -math.inf, 0
        self._begin(-1)
        self._rail = -math.inf
        self.found = False

    def _begin(self, window: int) -> None:
        self._window = window
        if self._at_it:
            self._former[self._extreme] = self._at_it, self._ties, self._arrivals, self._below
        self._is_known = False
        self._extreme = -math.inf
        self._at_it = self._ties = self._arrivals = self._before = 0
        self._below = [0, 0]
        self._last = -2
        self._peaks: list[float] = []

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


class Lasting:
    """Whether something has been so for a number of hops in a row."""

    def __init__(self, hops: int) -> None:
        self._hops, self._run = hops, 0

    def step(self, flags: Flags) -> Flags:
        """Take hops (H,); where it has lasted long enough."""
        if not flags.any():
            self._run = 0
            return flags
        out = np.zeros(len(flags), dtype=bool)
        for h, flag in enumerate(flags.tolist()):
            self._run = self._run + 1 if flag else 0
            out[h] = self._run >= self._hops
        return out


def unlike_gravity(mean: Array) -> Flags:
    """Whether mean forces (H, 3) are of a size that no drive has for long (H,)."""
    low, high = ROAD_FORCE
    size2 = mean[:, 0] * mean[:, 0] + mean[:, 1] * mean[:, 1] + mean[:, 2] * mean[:, 2]
    return np.asarray((size2 < low * low) | (size2 > high * high))


def turning_wildly(mean: Array) -> Flags:
    """Whether mean rates (H, 3) are of a size that no vehicle has for long (H,)."""
    size2 = mean[:, 0] * mean[:, 0] + mean[:, 1] * mean[:, 1] + mean[:, 2] * mean[:, 2]
    return np.asarray(size2 > MAX_RATE * MAX_RATE)


class UnitChange:
    """Whether all axes have become noisier, or quieter, by the factor between two units.

    factor: that one, such as 57.3 of deg/s for rad/s. What moves the vehicle is felt by the other
    sensor too, a unit is not. It lasts until the opposite is seen.
    """

    def __init__(self, factor: float, axes: int) -> None:
        self._low, self._high = factor / UNIT_LEEWAY, factor * UNIT_LEEWAY
        self._axes = axes
        self._wait = 0
        self._changed = 0
        self.restart()

    def restart(self) -> None:
        """Time jumped: nothing is compared across it."""
        self._levels = np.zeros((UNIT_HOPS - 1, self._axes))
        self._others = np.zeros((UNIT_HOPS - 1, 1))

    def step(self, level: Array, other: Array) -> Flags:
        """Take the mean changes from sample to sample of hops (H, axes), and of the other sensor.

        other: (H,), 0 where there is none. Returns whether the unit is another one than at first.
        """
        level = np.concatenate([self._levels, level])
        other = np.concatenate([self._others, other[:, None]])
        self._levels, self._others = level[-4:], other[-4:]
        up = _ratio(level)
        sign = (self._low < up).all(axis=1) & (up < self._high).all(axis=1)
        sign = sign.astype(np.int64) - ((up > 0.0) & (up < 1.0 / self._low)).all(axis=1)
        out = np.full(len(up), self._changed != 0)
        if not sign.any():
            self._wait = max(0, self._wait - len(up))
            return out
        same = np.abs(np.log(np.maximum(_ratio(other)[:, 0], 1e-9))) < math.log(OTHER_CHANGE)
        felt = (other[:-4, 0] > 0.0) & ~same
        for h, found in enumerate((sign * ~felt).tolist()):
            if found and not self._wait:
                # Not more than one step away from the unit of the first samples.
                self._changed = max(-1, min(1, self._changed + found))
                self._wait = UNIT_HOPS
            self._wait = max(0, self._wait - 1)
            out[h] = self._changed != 0
        return out


def _ratio(level: Array) -> Array:
    """Two hops against two before, one between left out; 0 where there is nothing."""
    early = level[:-4] + level[1:-3]
    late = level[3:-1] + level[4:]
    return np.asarray(np.where(early > 0.0, late / np.where(early > 0.0, early, 1.0), 0.0))
