"""Tests of a sensor's samples: one test for each kind of fault, hop by hop (half a second each).

Each test learns the usual behaviour from the sensor itself. A test decides whether the fault is
present now. `sample_health` decides how long the fault lasts.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, Flags
from imucald.motion.hops import HOP_S, AxisHops
from imucald.motion.physical_limits import ROAD_FORCE

Counts = NDArray[np.int64]

SURPRISE = 25.0
"""-log of the probability of the data without a fault, from which a fault is accepted [nats]: a
chance of 1e-11. Six axes have about 1e8 runs in 100 h.
"""
SHORTEST_HOPS = 2
"""Shortest stuck run in whole hops (1 s). Senders repeat a value if the next value is late."""
MIN_RUNS = 50
"""Number of runs after which the usual length of runs is known."""
LEAST_TIMES = 3.0
"""Smallest ratio of a stuck run to the longest run before, for any number of runs. If the step of
an axis is coarser than its noise, its runs last as long as its motion is small. On a straight road
the runs are longer than in town. With this factor, the usual length may grow to three times its
value.
"""
FINE_STEP = 0.6
"""Largest ratio of step to noise at which an axis is tested at rest. The margin allows a sensor
with 1.7 times less noise.
"""
DEAD_HOPS = 40
"""Number of driving hops (20 s) after which an axis that never changed is dead. With any step size,
no road is smooth enough for that.
"""
FORCE_HOPS = 2
"""Number of hops (1 s) in which the mean force must differ from gravity."""
MAX_RATE = math.radians(150.0)
RATE_HOPS = 3
"""Number of hops (1.5 s) in which the rate must be impossible for a road vehicle. At such a rate,
this is more than half a turn.
"""
UNIT_HOPS = 5
"""Number of hops in a comparison. Two hops are compared with two earlier hops, and the unit may
have changed in the hop (half a second) between them."""
UNIT_LEEWAY = 2.2
"""Tolerance of the noise measured in a second, as a factor: a factor of 1.3 with 10 samples, and
the effect of the road.
"""
UNIT_CHANGES = 8
"""Number of changes of an axis after which its noise in a second is known to a factor of 1.4.

An axis that is coarser than its noise, or whose samples are seldom, has few changes, and their
number is random.
"""
OTHER_CHANGE = 4.0
"""Factor by which the noise of the other sensor changes if the road became rough. In this case, the
unit has not changed.
"""
USUAL_HOPS = 20
"""Number of driving hops (10 s) whose mean noise identifies a unit.

Roads differ in roughness by a factor of up to four. The middle between two units is at a factor of
7.6.
"""


JUMP = 5.0
"""Smallest jump, as a multiple of the mean non-zero change of the axis: four standard deviations of
normal changes. (An axis that is coarser than its noise changes seldom, and then by its step.) The
chance that a repeated value begins and ends with such a change is 4e-9. There are about 1e5 late
values in 100 h.
"""
MIN_RUN = 3
"""Shortest run of equal values that is used. Noise causes shorter runs."""


class Runs:
    """Lengths of the runs of equal values that have ended."""

    def __init__(self) -> None:
        self.count = self.longest = self._samples = 0

    def add_runs(self, count: int, longest: int, samples: int) -> None:
        """Add the number of runs that ended, the length of the longest of them, and the number of
        their samples.

        A sensor's first sample ends an empty run. An empty run does not count.
        """
        if not samples:
            return
        self.count += count
        if longest > self.longest:
            self.longest = longest
        self._samples += samples

    def rate(self) -> float:
        """Return -log of the probability that a run continues for one more sample [nats]; 0: not
        known."""
        return rate_of(self.count, self.longest)

    def limit(self, surprise: float = SURPRISE) -> float:
        """Return the length [samples] above which a run is stuck. surprise: -log of the probability
        of a run of this length [nats]."""
        rate = self.rate()
        if rate == 0.0:
            return math.inf
        # For runs that noise makes, the mean times log N is at least the longest.
        wandered = self.longest * self.count / (self._samples * math.log(self.count))
        return max(surprise / rate, max(LEAST_TIMES, wandered) * self.longest)


def rate_of(count: int, longest: int) -> float:
    """Return the rate of `Runs` from the number of ended runs and the longest.

    The lengths of runs caused by noise have an exponential distribution. The longest of N runs is
    near log N times the scale of this distribution.
    """
    return 0.0 if count < MIN_RUNS else math.log(count) / max(longest, 1)


class AxisRuns:
    """Tests the runs of equal values of an axis: a stuck axis, and a loose contact.

    Stuck: A run of equal values is compared with earlier runs, at rest and in motion separately. At
    rest with the engine off, only the sensor's noise changes a value. At rest, the test therefore
    needs an axis whose step is finer than its noise.

    Loose contact: An axis jumps to a value, keeps exactly this value, and jumps back. The time at
    the value is shorter than with a stuck sensor. A sender may also repeat a value because the next
    value is late, which gives a run of equal values that noise never causes. Such repeated values
    are usual values of the drive, so the axis does not jump to them and away from them.

    noise: noise of a usual sensor of this kind, in SI units per root of hertz; 0: no test at rest.
    surprise: -log of the probability of a stuck run without a fault [nats]. moving: runs that have
    ended in motion. stuck: True if the axis is stuck now.
    """

    def __init__(self, noise: float, surprise: float = SURPRISE) -> None:
        self._noise, self._surprise = noise, surprise
        self.moving, self._resting = Runs(), Runs()
        self._rest_hops = 0
        self._change, self._changes = 0.0, 0
        self.stuck = False
        self.restart()

    def restart(self) -> None:
        """Restart after a jump of time."""
        self._moved_run = self._moved_hops = self._hops = 0
        self._run, self._entry = 0, 0.0  # the open run, and the change with which it began
        self._rested = False

    def take_hop(self, at: AxisHops, h: int, moving: bool) -> tuple[bool, bool]:
        """Process hop h (half a second), which has samples.

        Returns whether the axis is stuck at the end of the hop, and whether a run between two jumps
        that was longer than the usual runs ended in the hop.
        """
        count, ended, longest, run = at.counts[h]
        lost, jumped = self._lost_contact(at, h, self.moving if moving else self._resting)
        self._rest_hops += not (moving or self.stuck)  # noise is counted in the others only
        open_before, self._run = self._run, run
        if run <= count:  # it began in this hop
            self._entry = at.entry[h]
        if ended:
            if not self.stuck and not jumped:  # else the longest is the stuck run
                is_old = longest > count and self._rested
                pool = self.moving if moving and not is_old else self._resting
                pool.add_runs(ended, longest, open_before + count - run)
            if self._hops:
                self._moved_run = self._moved_hops = self._hops = 0
            self._rested = not moving
            self.stuck = False
            return False, lost
        self._hops += 1
        if moving:
            self._moved_run += count
            self._moved_hops += 1
        else:
            self._rested = True
        self.stuck = self.stuck or self._is_stuck(run, at.step[h])
        return self.stuck, lost

    def _is_stuck(self, run: int, step: float) -> bool:
        if self._moved_hops >= SHORTEST_HOPS:
            if self._moved_run > self.moving.limit(self._surprise):
                return True
            if self.moving.count < MIN_RUNS and self._moved_hops >= DEAD_HOPS:
                return True
        if self._hops < SHORTEST_HOPS or not self._rest_hops:
            return False
        # Noise changes twice in its bandwidth. A filter in the sensor reduces the bandwidth.
        bandwidth = 0.5 * self._resting.count / (self._rest_hops * HOP_S)
        if step > FINE_STEP * self._noise * math.sqrt(bandwidth):
            return False
        return run > self._resting.limit(self._surprise)

    def _lost_contact(self, at: AxisHops, h: int, usual: Runs) -> tuple[bool, bool]:
        """Return whether a run between two jumps ended in hop h (half a second) and was longer than
        the usual runs, and whether the longest run of the hop lies between jumps and is therefore
        not usual."""
        count, ended, longest, _ = at.counts[h]
        found = jumped = False
        if longest >= MIN_RUN and longest > usual.longest:
            lasted = self._between_jumps(at, h)
            jumped = longest == lasted
            found = lasted > usual.limit()
        if not jumped:
            self._change += at.level[h] * count
            self._changes += ended
        return found, jumped

    def _between_jumps(self, at: AxisHops, h: int) -> int:
        """Return the length of the longest run between two jumps that ended in hop h (half a
        second) [samples]."""
        change = np.abs(np.diff(at.samples(h), prepend=at.previous(h)))
        new = np.flatnonzero(change)
        lasted = np.diff(new, prepend=-self._run)
        size: Array = change[new]
        entry = np.append(self._entry, size[:-1])
        jump = JUMP * self._change / self._changes if self._changes else math.inf
        return int(lasted[(entry > jump) & (size > jump)].max(initial=0))


class Lasting:
    """Detects that a condition has lasted for a number of hops (half a second each) in a row."""

    def __init__(self, hops: int) -> None:
        self._hops, self._run = hops, 0

    def take_hops(self, flags: Flags) -> Flags:
        """Process hops (H,), half a second each.

        Returns flags of the hops at which the condition has lasted long enough."""
        if not flags.any():
            self._run = 0
            return flags
        out = np.zeros(len(flags), dtype=bool)
        for h, flag in enumerate(flags.tolist()):
            self._run = self._run + 1 if flag else 0
            out[h] = self._run >= self._hops
        return out


def unlike_gravity(mean: Array) -> Flags:
    """Return flags (H,) of the mean forces (3, H) whose magnitude no drive keeps for long."""
    (low, high), size2 = ROAD_FORCE, (mean * mean).sum(axis=0)
    return np.asarray((size2 < low * low) | (size2 > high * high))


def turning_wildly(mean: Array) -> Flags:
    """Return flags (H,) of the mean rates (3, H) whose magnitude no vehicle keeps for long."""
    return np.asarray((mean * mean).sum(axis=0) > MAX_RATE * MAX_RATE)


class UnitChange:
    """Detects that all axes have become noisier, or quieter, by the factor between two units.

    factor: ratio of the two units, such as 57.3 between deg/s and rad/s. The other sensor also
    measures a motion of the vehicle, but it does not measure a change of unit. The fault lasts
    until the opposite change is seen, or until the noise of driving is as before. The noise of
    driving shows whether a sensor was only held in a hand: its unit is then unchanged.
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
        """Restart after a jump of time: no comparison extends across the jump."""
        self._before = tuple(np.zeros((UNIT_HOPS - 1, n)) for n in (self._axes, self._axes, 2, 1))

    def take_hops(self, level: Array, changes: Counts, other: Array, moving: Flags) -> Flags:
        """Process the mean changes from sample to sample of hops (H, axes), half a second each,
        and the number of changes.

        other: (H, 2) mean change and number of changes of the other sensor, 0 if there is no other
        sensor. moving: (H,) True if the vehicle moved during the whole hop. Returns flags (H,):
        whether the unit differs from the first unit.
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
        up, often = _ratio(level), _enough(count)
        lowest, highest = _within_five(moved[:, 0])
        more = often & ((self._low < up) & (up < self._high)).all(axis=1)
        less = often & ((up > 0.0) & (up < 1.0 / self._low)).all(axis=1)
        sign = more.astype(np.int64) - less.astype(np.int64)
        out = np.zeros(len(up), dtype=bool)
        if not sign.any() and not self._changed:
            self._wait = max(0, self._wait - len(up))
            for size in sizes:
                self._usual.add_size(size)
            return out
        same = np.abs(np.log(np.maximum(_ratio(other)[:, 0], 1e-9))) < math.log(OTHER_CHANGE)
        # A sensor that cannot show whether a vehicle moves off does not show that it stands.
        felt = np.where(_enough(other[:, 1:]), ~same, lowest != highest)
        # At rest the noise may fall because a hand lets go or the body stops rocking. The noise of
        # driving falls only by a unit.
        drives = (lowest > 0.0).tolist()
        for h, found in enumerate((sign * ~felt).tolist()):
            is_change = found > 0 or (found < 0 and (drives[h] or self._changed > 0))
            if is_change and not self._wait:
                # The unit is at most one step away from that of the first samples.
                self._changed = max(-1, min(1, self._changed + found))
                self._wait = UNIT_HOPS
            self._wait = max(0, self._wait - 1)
            self._hold_against_usual(sizes[h])
            out[h] = self._changed != 0
        return out

    def _hold_against_usual(self, size: float) -> None:
        """Process the noise of a driving hop (half a second), or 0 for a hop without driving.

        End the fault if the noise is again as before.
        """
        if not self._changed:
            self._usual.add_size(size)
            self._now = _MeanLog()
            return
        self._now.add_size(size)
        if min(self._now.count, self._usual.count) < USUAL_HOPS:
            return
        if abs(self._now.mean - self._usual.mean) < self._half_way:
            self._changed = 0
        self._now = _MeanLog()


class _MeanLog:
    def __init__(self) -> None:
        self.count, self.mean = 0, 0.0

    def add_size(self, size: float) -> None:
        """Add a size to the mean. A size of 0 is ignored."""
        if size > 0.0:
            self.count += 1
            self.mean += (math.log(size) - self.mean) / self.count


def _enough(count: Array) -> Flags:
    """Return whether every axis changed often enough in two hops (half a second each), and in two
    later hops. There is one hop between the two pairs.
    """
    early, late = count[:-4] + count[1:-3], count[3:-1] + count[4:]
    return np.asarray((np.minimum(early, late) >= UNIT_CHANGES).all(axis=1))


def _within_five(moved: Array) -> tuple[Array, Array]:
    """Return the smallest and largest of the flags `moving` in every five hops (half a second
    each).

    Both flags are 1 if the vehicle moved in all five hops.
    """
    five = np.lib.stride_tricks.sliding_window_view(moved, UNIT_HOPS)
    return five.min(axis=1), five.max(axis=1)


def _ratio(level: Array) -> Array:
    """Return the ratio of two hops to two earlier hops, with one hop (half a second) between the
    pairs; 0 if the earlier level is 0.
    """
    early = level[:-4] + level[1:-3]
    late = level[3:-1] + level[4:]
    return np.asarray(np.where(early > 0.0, late / np.where(early > 0.0, early, 1.0), 0.0))
