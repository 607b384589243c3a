"""Gravity: direction of the specific force without the motion, averaged over the road.

At rest, this is the levelling of method A, steps 1-2. A stop shows the slope of one place. While
driving the slope changes, so the mean over D metres of road has the variance of a mean of a
Gauss-Markov process with the correlation length L:

    s^2 * 2 (L / D) (1 - (L / D) (1 - exp(-D / L))),

This variance is s^2 for one place and falls as 2 L / D. Places count, not samples. The bias of the
accelerometer does not average out, and neither does the mean lean of roads.
"""

from __future__ import annotations

import math
import operator

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.block_sums import driven
from imucald.mount.road_segments import ScoreSeries
from imucald.mount.signal_blocks import SignalBlock

STOP_METRES = 12.0
"""A stop counts as at most this many metres of road: it has no motion, but it is one place."""
REST_METRES_PER_TICK = 0.5
MIN_WEIGHT = 20.0
"""A road segment shorter than this [m] gives no gravity evidence."""
ROAD_SHARE = {"roll_gravity": 1.7, "pitch_gravity": 1.5}
"""Factors by which superelevation, squat and leaning of the body widen the spread of slopes."""
SHARE = 0.1
"""Possible relative error of the motion. This error reduces the weight of ticks of hard driving."""
STILL = 0.15
"""Motion force that is small enough to ignore [m/s^2]."""


class GravityEvidence:
    """Sums of force and motion over the road; R and gains may still change."""

    def __init__(self) -> None:
        self._weight = 0.0
        self._force = np.zeros(3)
        self._motion = np.zeros(2)
        self.metres = 0.0
        self.stops = 0
        self._stop_used = 0.0
        self._resting = False
        self._end = [0.0] * 7  # of the last segment: weight, force (3), motion (2), metres
        self._rows = np.zeros((16, 7))  # of segments, see `_row`; the open one behind the others
        self._closed = 0
        self._rows_of: tuple[object, ...] = ()  # roads that the closed ones are for
        self._each: list[list[float]] = []  # sums of closed segments, in the form of `_end`
        self._made: tuple[tuple[object, ...], list[ScoreSeries]] | None = None

    def _sofar(self) -> list[float]:
        return [self._weight, *self._force.tolist(), *self._motion.tolist(), self.metres]

    def _open(self) -> list[float]:
        """Return the sums of the open segment."""
        return [now - end for now, end in zip(self._sofar(), self._end, strict=True)]

    def close_segment(self) -> None:
        """End a road segment, for `series`."""
        self._each.append(self._open())
        self._end = self._sofar()
        self._made = None

    def series(
        self,
        R: Matrix3,
        bias: Array,
        gains: tuple[float, float],
        std: tuple[float, float],
        length: float,
    ) -> list[ScoreSeries]:
        """Return small rotations e_x and e_y about R from gravity, one per road segment including
        the open one.

        std: rms tangent of the roads across and along; length: correlation length of the slope [m].
        """
        key = R, bias, gains, std, length
        if self._made is not None:  # it is called twice per road segment
            known, found = self._made
            if all(map(operator.is_, key[:2], known[:2])) and key[2:] == known[2:]:
                return found
        if self._rows_of != (std, length):
            self._rows_of, self._closed = (std, length), 0
        n = len(self._each)
        if n >= len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        for k in range(self._closed, n):
            self._rows[k] = _row(self._each[k], std, length)
        self._closed = n
        self._rows[n] = _row(self._open(), std, length)
        rows = self._rows[: n + 1]
        F = (rows[:, :3] - bias) @ R.T
        across, along = rows[:, 5].copy(), rows[:, 6].copy()
        e_x = (F[:, 1] - gains[1] * rows[:, 4]) / GRAVITY
        e_y = -(F[:, 0] - gains[0] * rows[:, 3]) / GRAVITY
        found = [
            ScoreSeries("roll_gravity", across * e_x, across),
            ScoreSeries("pitch_gravity", along * e_y, along),
        ]
        self._made = key, found
        return found

    def add(self, p: SignalBlock, turn: Array) -> None:
        """Take a block; turn: (N,) v r [m/s^2]."""
        self._made = None
        sums = _sums(p, turn, self._stop_used)
        weight, x, y, z, accel, across, metres, used, resting, moving, each = sums
        if not used:
            return
        if moving:
            self._stop_used, self._resting = 0.0, False
        if resting:
            if not self._resting:
                self._resting = True
                self.stops += 1
            self._stop_used += each * resting
        if self._weight == 0.0 and weight == 0.0:
            return
        self._weight += weight
        self._force += (x, y, z)
        self._motion += (accel, across)
        self.metres += metres

    @property
    def known(self) -> bool:
        """True if there is any direction of gravity."""
        return self._weight > 0.0

    def mean_force(self) -> Array:
        """Mean specific force in sensor axes, with the motion (3,)."""
        mean: Array = self._force / max(self._weight, 1e-9)
        return mean

    def tilt(self, R: Matrix3, bias: Array, gains: tuple[float, float]) -> tuple[float, float]:
        """Return e_x and e_y [rad] about R from gravity, with the lean of roads included."""
        w = max(self._weight, 1e-9)
        F = R @ (self._force / w - bias)
        x = F[0] - gains[0] * self._motion[0] / w
        y = F[1] - gains[1] * self._motion[1] / w
        return math.atan2(y, F[2]), -math.atan2(x, F[2])

    def variance(self, std: float, length: float, missed: float) -> float:
        """Variance of the mean slope over the road driven [rad^2].

        missed: share of the motion force that may be wrong, 1 where yaw is not known.
        """
        q = self.metres / length
        slope = std * std
        if q > 1e-3:
            slope *= 2.0 / q * (1.0 - (1.0 - math.exp(-q)) / q)
        mean2 = float(self._motion @ self._motion) / max(self._weight, 1e-9) ** 2
        return slope + missed * missed * mean2 / GRAVITY**2


def _row(each: list[float], std: tuple[float, float], length: float) -> list[float]:
    """Return a segment's mean force (3,) and motion (2,), and the informations of the tilts that
    they show.

    each: see `GravityEvidence`; std, length: see `GravityEvidence.series`.
    """
    weight, *sums, metres = each
    w = max(weight, 1e-9)
    mean = [x / w for x in sums]
    q = max(metres / length, 1e-3)
    part = 2.0 / q * (1.0 - (1.0 - math.exp(-q)) / q)
    missed = (SHARE / GRAVITY) ** 2 * (mean[3] * mean[3] + mean[4] * mean[4])
    known = [1.0 / (x * x * part + missed) if weight > MIN_WEIGHT else 0.0 for x in std]
    return [*mean, *known]


def _sums(p: SignalBlock, turn: Array, stop_used: float) -> list[float]:
    """Return the sums of a block: the weight, and the weighted force (3,), dv/dt and v r.

    Also the metres, the numbers of ticks in use, at rest and moving, and the metres for which each
    tick at rest counts.

    turn: (N,) v r [m/s^2]. stop_used: metres for which the stop so far has counted.
    """
    use = driven(p)
    sizes = np.abs(p.speed)
    weight = np.where(p.rest, 0.0, sizes * TICK_S)
    hard2 = p.accel * p.accel + turn * turn
    weight *= use / (1.0 + hard2 * (SHARE / STILL) ** 2)
    moving, resting, each = np.count_nonzero(sizes > 1.0), p.rest & use, 0.0
    n = np.count_nonzero(resting)
    if n:
        left = STOP_METRES - (0.0 if moving else stop_used)
        each = min(REST_METRES_PER_TICK, max(left, 0.0) / n)
        weight[resting] = each
    force = (weight[:, None] * p.force).sum(axis=0).tolist()
    more = (float(one.sum()) for one in (weight * p.accel, weight * turn, sizes * use))
    accel, across, metres = more
    counts = float(np.count_nonzero(use)), float(n), float(moving), each
    return [float(weight.sum()), *force, accel, across, metres * TICK_S, *counts]
