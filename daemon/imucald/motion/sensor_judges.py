"""What makes a sensor's samples unfit to be used: one judge a kind of fault, hop by hop.

Each learns from the sensor itself what is usual for it. A judge says whether the fault is there
now; how long it is believed to last is the business of `sample_health`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.motion.hops import HOP_S
from imucald.motion.physical_limits import ROAD_FORCE

Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]

SURPRISE = 25.0
"""A fault is believed from this -log of the chance of it without one on [nats]: 1e-11, of some 1e8
runs that six axes have in 100 h."""
SHORTEST_HOPS = 2
"""No run shorter than two whole hops is stuck (1 s): senders repeat a value that is late."""
MIN_RUNS = 50
"""Runs from which their lengths are known."""
LEAST_TIMES = 3.0
"""No run shorter than so many times the longest before is stuck, however many there were. Runs of
an axis whose step is coarser than its noise last as long as its motion is small: on a straight
road they are of another scale than in town. The scale may change by as much again as it has."""
FINE_STEP = 0.6
"""At rest a step of at most so much of the noise is needed: room for a sensor 1.7 times quieter."""
DEAD_HOPS = 40
"""An axis that never changed is dead after so many hops of driving (20 s): no road is that smooth,
whatever the sensor's step."""
FORCE_HOPS = 2
"""Hops of a mean force unlike gravity (1 s)."""
MAX_RATE = math.radians(150.0)
RATE_HOPS = 3
"""No road vehicle turns at that rate [rad/s] for so many hops (1.5 s): that is over half a turn."""
UNIT_HOPS = 5
"""Two hops are held against two before, with one between in which the unit may have changed."""
UNIT_LEEWAY = 2.2
"""Factor by which the noise of a second may be off: 1.3 with 10 samples, and what the road adds."""
UNIT_CHANGES = 8
"""A second's noise is known from so many changes of the axis, to a factor of 1.4: one that is
coarser than its noise, or that comes seldom, has a few, and how many is chance."""
OTHER_CHANGE = 4.0
"""A road that became rough is felt by the other sensor too: then it is no unit."""
SOME_CHANGES = 3
"""Of a quieter axis fewer are left: one alone is that of a sender that had stopped."""
USUAL_HOPS = 20
"""Hops of driving (10 s) whose mean noise is that of a unit: a road is up to four times as rough as
another, and half way to the nearest unit, as a ratio, is 7.6 times."""


class Runs:
    """Lengths of the runs of equal values that ended by themselves."""

    def __init__(self) -> None:
        self.count = self.longest = self._samples = 0

    def add(self, count: int, longest: int, samples: int) -> None:
        """Take so many runs that ended, the longest of them, and all samples in them.

        A sensor's first sample ends a run of none: that is no run.
        """
        if not samples:
            return
        self.count += count
        if longest > self.longest:
            self.longest = longest
        self._samples += samples

    def rate(self) -> float:
        """-log of the chance that a run goes on, for one more sample [nats]; 0: not known."""
        return rate_of(self.count, self.longest)

    def limit(self) -> float:
        """A run of more samples is stuck."""
        rate = self.rate()
        if rate == 0.0:
            return math.inf
        # of runs that noise makes, the mean times log N is no shorter than the longest
        wandered = self.longest * self.count / (self._samples * math.log(self.count))
        return max(SURPRISE / rate, max(LEAST_TIMES, wandered) * self.longest)


def rate_of(count: int, longest: int) -> float:
    """The rate of `Runs` from how many ended, and the longest.

    The longest of N lengths, spread exponentially as those of noise are, is near log N times their
    scale.
    """
    return 0.0 if count < MIN_RUNS else math.log(count) / max(longest, 1)


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
        self._moved_run = self._moved_hops = self._hops = self._run = 0
        self._rested = False
        self._rest_hops = 0
        self.stuck = False

    def restart(self) -> None:
        """Time jumped."""
        self._moved_run = self._moved_hops = self._hops = self._run = 0
        self._rested = False

    def usual(self, moving: bool) -> Runs:
        """The runs that ended so far, in motion or at rest."""
        return self.moving if moving else self._resting

    def step(self, moving: bool, runs: tuple[int, int, int, int], q: float, jumped: bool) -> bool:
        """Take a hop; whether the axis is stuck at its end.

        runs, q: of the axis count, ended, longest, run and step, as `HopRows` has them.
        jumped: the longest lies between jumps, and is no usual run.
        """
        count, ended, longest, run = runs
        self._rest_hops += not (moving or self.stuck)  # noise is counted in the others only
        open_before, self._run = self._run, run
        if ended:
            if not self.stuck and not jumped:  # else the longest is the one that was stuck
                is_old = longest > count and self._rested
                pool = self.moving if moving and not is_old else self._resting
                pool.add(ended, longest, open_before + count - run)
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
        if self._hops < SHORTEST_HOPS or not self._rest_hops:
            return False
        # noise changes twice in its bandwidth, which a filter in the sensor makes less
        bandwidth = 0.5 * self._resting.count / (self._rest_hops * HOP_S)
        if q > FINE_STEP * self._noise * math.sqrt(bandwidth):
            return False
        return run > self._resting.limit()


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
    sensor too, a unit is not. It lasts until the opposite is seen, or until the noise of driving is
    what it was before: a sensor that was taken in hand has the unit it had.
    """

    def __init__(self, factor: float, axes: int) -> None:
        self._low, self._high = factor / UNIT_LEEWAY, factor * UNIT_LEEWAY
        self._axes = axes
        self._wait = 0
        self._changed = 0
        self._half_way = 0.5 * math.log(factor)
        self._usual, self._now = _MeanLog(), _MeanLog()
        self.restart()

    def restart(self) -> None:
        """Time jumped: nothing is compared across it."""
        self._before = tuple(np.zeros((UNIT_HOPS - 1, n)) for n in (self._axes, self._axes, 2, 1))

    def step(self, level: Array, changes: Counts, other: Array, moving: Flags) -> Flags:
        """Take the mean changes from sample to sample of hops (H, axes), and how many there were.

        other: (H, 2) both of the other sensor, 0 where there is none; moving: (H,) whether the
        vehicle moved in all of a hop. Returns whether the unit is another one than at first.
        """
        sizes = [
            sum(row) if moves else 0.0
            for row, moves in zip(level.tolist(), moving.tolist(), strict=True)
        ]
        new = level, changes, other, moving[:, None]
        level, count, other, moved = (
            np.concatenate(pair) for pair in zip(self._before, new, strict=True)
        )
        self._before = tuple(rows[1 - UNIT_HOPS :] for rows in (level, count, other, moved))
        up, (early, late), (_, some) = _ratio(level), _enough(count), _enough(count, SOME_CHANGES)
        lowest, highest = _within_five(moved[:, 0])
        more = early & late & ((self._low < up) & (up < self._high)).all(axis=1)
        less = early & some & ((up > 0.0) & (up < 1.0 / self._low)).all(axis=1)
        sign = more.astype(np.int64) - less.astype(np.int64)
        out = np.zeros(len(up), dtype=bool)
        if not sign.any() and not self._changed:
            self._wait = max(0, self._wait - len(up))
            for size in sizes:
                self._usual.add(size)
            return out
        same = np.abs(np.log(np.maximum(_ratio(other)[:, 0], 1e-9))) < math.log(OTHER_CHANGE)
        # a sensor that cannot say whether a vehicle moves off does not say that it does not
        felt = np.where(np.logical_and(*_enough(other[:, 1:])), ~same, lowest != highest)
        # At rest a hand lets go, or the body ceases to rock: the noise of driving is made less by a
        # unit alone.
        drives = (lowest > 0.0).tolist()
        for h, found in enumerate((sign * ~felt).tolist()):
            is_change = found > 0 or (found < 0 and (drives[h] or self._changed > 0))
            if is_change and not self._wait:
                # Not more than one step away from the unit of the first samples.
                self._changed = max(-1, min(1, self._changed + found))
                self._wait = UNIT_HOPS
            self._wait = max(0, self._wait - 1)
            self._hold_against_usual(sizes[h])
            out[h] = self._changed != 0
        return out

    def _hold_against_usual(self, size: float) -> None:
        """Take the noise of a hop of driving, or 0: does it look like another unit's?"""
        if not self._changed:
            self._usual.add(size)
            self._now = _MeanLog()
            return
        self._now.add(size)
        if min(self._now.count, self._usual.count) < USUAL_HOPS:
            return
        if abs(self._now.mean - self._usual.mean) < self._half_way:
            self._changed = 0
        self._now = _MeanLog()


class _MeanLog:
    """Mean of the logarithms of sizes above zero."""

    def __init__(self) -> None:
        self.count, self.mean = 0, 0.0

    def add(self, size: float) -> None:
        """Take a size; 0 is none."""
        if size > 0.0:
            self.count += 1
            self.mean += (math.log(size) - self.mean) / self.count


def _enough(count: Array, least: int = UNIT_CHANGES) -> tuple[Flags, Flags]:
    """Whether every axis changed often enough in two hops, and in two later, one left out."""
    early, late = count[:-4] + count[1:-3], count[3:-1] + count[4:]
    return np.all(early >= least, axis=1), np.all(late >= least, axis=1)


def _within_five(moved: Array) -> tuple[Array, Array]:
    """Smallest and largest of every five hops: both 1 where the vehicle moved in all of them."""
    five = np.lib.stride_tricks.sliding_window_view(moved, UNIT_HOPS)
    return five.min(axis=1), five.max(axis=1)


def _ratio(level: Array) -> Array:
    """Two hops against two before, one between left out; 0 where there is nothing."""
    early = level[:-4] + level[1:-3]
    late = level[3:-1] + level[4:]
    return np.asarray(np.where(early > 0.0, late / np.where(early > 0.0, early, 1.0), 0.0))
