"""Levelling: gravity at rest gives the tilt (method A, steps 2 and 3).

One stop gives the sum of mount tilt, road slope and accelerometer bias. As an addition to the
publication, several stops are averaged. Slopes differ from place to place and average out. The bias
does not average out.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numpy as np

from imucald.core.rotations import Matrix3, Vector
from imucald.core.samples import GRAVITY

PLACES_KEPT = 40
"""Largest number of stored places of rest.

The oldest place is dropped first, so that the tilt follows a slow creep of the mount.
"""
SLOPE_PRIOR_PLACES = 4.0
"""Weight of the preset slope spread relative to the observed spread, in places."""
OUTLIER_SPREADS = 2.5
"""Distance from the mean, in spreads, above which a place (a ramp, a kerb) gets less weight."""


def rotation_about_up(angle: float) -> Matrix3:
    """Return Rz(lambda), levelled -> vehicle axes (steps 5 and 6); (3, 3).

    L'x = Lx cos(lambda) - Ly sin(lambda), L'y = Lx sin(lambda) + Ly cos(lambda). Lambda is not the
    mount's Z-Y-X yaw angle, but the two are equal for a level sensor.
    """
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Tilt(NamedTuple):
    """Unit vector up in sensor axes, its standard deviation per axis [rad], and the number of
    places.
    """

    up: Vector
    std: float
    places: int


class StopBook:
    """Averages the static windows of several stops into one tilt.

    slope_std: preset spread of the road slope per axis [rad]. bias_std: deviation of the
    accelerometer bias [m/s^2]. average: use all stops; otherwise only the last stop counts, as
    published.
    """

    def __init__(self, slope_std: float, bias_std: float, average: bool = True) -> None:
        self._slope_std = slope_std
        self._bias_std = bias_std / GRAVITY
        self._average = average
        self._sums: deque[list[float]] = deque(maxlen=PLACES_KEPT if average else 1)
        self.seen = 0

    def add_static_window(self, force: Vector, count: float, new_place: bool) -> None:
        """Process a static window: mean force (3,) [m/s^2] of `count` samples.

        new_place: the vehicle has moved since the last window; otherwise both windows belong to one
        stop.
        """
        if new_place or not self._sums:
            self._sums.append([0.0, 0.0, 0.0, 0.0])
            self.seen += 1
        cell = self._sums[-1]
        for i in range(3):
            cell[i] += count * force[i]
        cell[3] += count

    def tilt(self) -> Tilt | None:
        """Return the tilt from all stops so far, or None before the first stop."""
        if not self._sums:
            return None
        sums = np.array(self._sums)[:, :3]
        ups = sums / np.sqrt(np.sum(sums * sums, axis=1))[:, None]
        weights = np.ones(len(ups))
        up, spread = ups[0], self._slope_std
        for _ in range(3):
            mean = weights @ ups
            up = mean / math.sqrt(float(mean @ mean))
            away = np.sqrt(np.maximum(np.sum((ups - up) ** 2, axis=1), 1e-12))
            square = float(weights @ away**2) / 2.0  # two axes
            prior = SLOPE_PRIOR_PLACES
            total = float(np.sum(weights))
            spread = math.sqrt((prior * self._slope_std**2 + square) / (prior + total - 1.0))
            limit = OUTLIER_SPREADS * math.sqrt(2.0) * spread
            weights = np.minimum(1.0, limit / away)
        effective = float(np.sum(weights)) ** 2 / float(np.sum(weights**2))
        std = math.sqrt(spread**2 / effective + self._bias_std**2)
        return Tilt((float(up[0]), float(up[1]), float(up[2])), std, len(ups))


class LongRunLevel:
    """Fall-back without a stop: the mean specific force of a long drive is gravity.

    Over a time T, speed changes add at most dv / T to the mean force, and slopes average out. The
    class also computes the remaining uncertainty.
    """

    SPEED_CHANGE = 30.0
    """Change of velocity [m/s] whose acceleration the mean may contain, in any direction."""
    CORRELATION_S = 30.0
    """Time over which the road slope stays the same [s]."""

    def __init__(self, slope_std: float, bias_std: float) -> None:
        self._slope_std = slope_std
        self._bias_std = bias_std / GRAVITY
        self._x = self._y = self._z = 0.0
        self.seconds = 0.0

    def add_mean_force(self, x: float, y: float, z: float, seconds: float) -> None:
        """Process a mean specific force [m/s^2] over some seconds."""
        self._x += x * seconds
        self._y += y * seconds
        self._z += z * seconds
        self.seconds += seconds

    def tilt(self) -> Tilt | None:
        """Return the tilt from the whole drive, or None if nothing was added."""
        norm = math.sqrt(self._x**2 + self._y**2 + self._z**2)
        if self.seconds <= 0.0 or norm <= 0.0:
            return None
        motion = self.SPEED_CHANGE / (GRAVITY * self.seconds)
        slopes = max(1.0, self.seconds / self.CORRELATION_S)
        variance = motion**2 + 4.0 * self._slope_std**2 / slopes + self._bias_std**2
        return Tilt((self._x / norm, self._y / norm, self._z / norm), math.sqrt(variance), 0)
