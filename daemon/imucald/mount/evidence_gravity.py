"""Gravity: direction of the specific force without the motion, averaged over the road.

At rest, this is the levelling of method A, steps 1 and 2. A stop shows the slope at one place.
While driving, the slope changes. The mean slope over D metres of road therefore has the variance of
the mean of a Gauss-Markov process with the correlation length L:

    s^2 * 2 (L / D) (1 - (L / D) (1 - exp(-D / L))),

This variance is s^2 for one place and decreases as 2 L / D on a long road. The weight of a sample
is the distance driven, so a long stop is still one place. The bias of the accelerometer and the
mean lean of roads do not average out.
"""

from __future__ import annotations

import math

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.block_sums import driven
from imucald.mount.signal_blocks import SignalBlock

STOP_METRES = 12.0
"""Largest length of road [m] that a stop counts as: a stop has no motion, but it is a single
place."""
REST_METRES_PER_TICK = 0.5
ROAD_SHARE = np.array([1.7, 1.5])
"""Factors for roll and pitch on the spread of slopes, because of superelevation, squat and body
roll.
"""
SHARE = 0.1
"""Assumed relative error of the motion. This error reduces the weight of ticks with strong
acceleration."""
STILL = 0.15
"""Force of the motion that is small enough to ignore [m/s^2]."""


def share_of_one_place(metres: float, length: float) -> float:
    """Return the ratio of two variances: of the mean slope over a road, and of the slope at one
    place.

    length: correlation length of the slope [m].
    """
    q = metres / length
    return 2.0 / q * (1.0 - (1.0 - math.exp(-q)) / q) if q > 1e-3 else 1.0


class GravityEvidence:
    """Sums of force and motion over the road."""

    def __init__(self) -> None:
        self._weight = 0.0
        self._force = np.zeros(3)
        self._motion = np.zeros(2)
        self.metres = 0.0
        self.stops = 0
        self._stop_used = 0.0
        self._resting = False

    def add_block(self, p: SignalBlock, turn: Array) -> None:
        """Process a block. turn: (N,) v r (speed times yaw rate) [m/s^2]."""
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
        """True if a direction of gravity is known."""
        return self._weight > 0.0

    def mean_force(self) -> Array:
        """Return the mean specific force (3,) in sensor axes. The force of the motion is
        included."""
        mean: Array = self._force / max(self._weight, 1e-9)
        return mean

    def variance(self, std: float, length: float) -> float:
        """Return the variance of the mean slope over the road driven [rad^2]. The mean motion is
        included as an error, because it cannot be subtracted while the yaw is unknown.
        """
        slope = std * std * share_of_one_place(self.metres, length)
        mean2 = float(self._motion @ self._motion) / max(self._weight, 1e-9) ** 2
        return slope + mean2 / GRAVITY**2


def _sums(p: SignalBlock, turn: Array, stop_used: float) -> list[float]:
    """Return the sums of a block: the weight, the weighted force (3,), the weighted dv/dt and the
    weighted v r (speed times yaw rate).

    The list continues with the distance [m], the number of ticks in use, the number of ticks at
    rest, the number of moving ticks, and the distance that each tick at rest counts as [m].

    turn: (N,) v r [m/s^2]. stop_used: distance that was already counted for the present stop [m].
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
