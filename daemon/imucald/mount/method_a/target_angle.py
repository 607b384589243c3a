"""Manoeuvres: the evidence of one braking or one acceleration about the target angle, and the
combination of all manoeuvres.

A published sample angle with v*r subtracted is lambda_i = atan2(v r, dv/dt) - atan2(R'y, R'x), with
speed v and yaw rate r. The circular mean of such angles, weighted by |R'| |(dv/dt, v r)|, is the
argument of the sum of conj(R') (dv/dt + i v r). A manoeuvre stores that sum in sensor axes, before
levelling. If the tilt becomes better later, the angle of every earlier manoeuvre becomes better
too. The uncertainty is computed from the differences between manoeuvres, because all samples of one
manoeuvre have the same slope, the same bank and the same driver.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3
from imucald.motion.speed import SpeedInterval

Pointers = NDArray[np.complex128]

PRIOR_SPREAD = math.radians(4.0)
"""Expected spread of single manoeuvres about the true angle [rad]."""
PRIOR_MANOEUVRES = 2.0
"""Weight of `PRIOR_SPREAD`, in manoeuvres."""
MIN_SPREAD = math.radians(0.8)
"""Smallest spread for the robust limit [rad]."""
ROBUST_SPREADS = 1.5
"""Distance from the mean, in spreads, above which a manoeuvre gets less weight (Huber)."""
ROBUST_ROUNDS = 4
COUNTED_LIMITS = 2.0
"""Largest deviation of a manoeuvre that is used for the uncertainty, in robust limits.

A manoeuvre that disagrees then widens the interval to a limited extent.
"""
MIN_AGREEMENT = 0.6
"""Smallest resultant of manoeuvres that agree. Below this value, the manoeuvres contradict each
other, for example because some of them are turns. The spread of such manoeuvres about the mean is
meaningless.
"""
TWO_MINDS_STD = math.radians(45.0)
FLOOR_STD = math.radians(0.15)
"""Standard deviation of errors that all manoeuvres have in common [rad]: cross-axis error and
delay. A larger number of manoeuvres does not reduce these errors.
"""
MEDIAN_TO_STD = 1.4826
"""Ratio of standard deviation to median absolute deviation for a normal distribution."""


class Manoeuvre:
    """Sums over the intervals of one straight braking or acceleration, in sensor axes.

    sums: f dv/dt (3), f v r (3), f f' as xx, yy, zz, xy, xz, yz (6), each
    times dt and the interval's weight. signed: True if the speed shows which way is forward. peak:
    largest dv/dt of the manoeuvre [m/s^2].
    """

    def __init__(self, start: float, signed: bool) -> None:
        self.start = self.stop = start
        self.signed = signed
        self.peak = 0.0
        self.seconds = 0.0
        self.sums = [0.0] * 12

    def add_interval(
        self,
        interval: SpeedInterval,
        f: Sequence[float],
        dvdt: float,
        lateral: float,
        weight: float,
    ) -> None:
        """Process an interval: force (3,), dv/dt and v r (speed times yaw rate), each minus its
        offset [m/s^2].
        """
        dt = interval.t1 - interval.t0
        x, y, z = f
        motion = (
            x * dvdt, y * dvdt, z * dvdt, x * lateral, y * lateral, z * lateral,
            x * x, y * y, z * z, x * y, x * z, y * z,
        )  # fmt: skip
        self.sums = [
            total + weight * dt * value for total, value in zip(self.sums, motion, strict=True)
        ]
        self.seconds += dt
        self.stop = interval.t1


class ManoeuvreBook:
    """The last manoeuvres, at most `kept`. The oldest manoeuvre is dropped first."""

    def __init__(self, kept: int) -> None:
        self._sums: deque[list[float]] = deque(maxlen=kept)

    def __len__(self) -> int:
        return len(self._sums)

    def add_manoeuvre(self, manoeuvre: Manoeuvre) -> None:
        """Store a finished manoeuvre."""
        self._sums.append(manoeuvre.sums)

    def pointers(self, R_level_from_sensor: Matrix3) -> Pointers:
        """Return the sum of conj(R') (dv/dt + i v r) of each manoeuvre.

        The argument of this sum is the manoeuvre's lambda.
        """
        sums = np.array(self._sums).reshape(-1, 12)
        along = sums[:, 0:3] @ R_level_from_sensor[:2].T
        lateral = sums[:, 3:6] @ R_level_from_sensor[:2].T
        x, y = along[:, 0] + lateral[:, 1], lateral[:, 0] - along[:, 1]
        result: Pointers = x + 1j * y
        return result

    def axis_pointers(self, R_level_from_sensor: Matrix3) -> Pointers:
        """Return the sum of conj(R')^2 of each manoeuvre.

        Half of its argument is lambda or lambda + 180 deg. Isotropic noise cancels out.
        """
        moments = np.array(self._sums).reshape(-1, 12)[:, 6:]
        a, b = R_level_from_sensor[0], R_level_from_sensor[1]
        squares = moments @ (_products(a, a) - _products(b, b))
        result: Pointers = squares - 2j * (moments @ _products(a, b))
        return result


def _products(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the coefficients of a' M b for the elements xx, yy, zz, xy, xz, yz of M."""
    i, j = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    both = np.where(np.arange(6) < 3, 0.5, 1.0) * (a[i] * b[j] + a[j] * b[i])
    return np.asarray(both, dtype=np.float64)


class CombinedAngle(NamedTuple):
    """A combined angle [rad], its standard deviation [rad], and the number of combined
    manoeuvres."""

    value: float
    std: float
    manoeuvres: int


def combined(pointers: Pointers, turns: float = 1.0, robust: bool = True) -> CombinedAngle | None:
    """Combine pointers (N,) into one angle; None if there are no pointers.

    turns: number of turns of a pointer while the angle makes one turn (2 for an axis). The variance
    is the variance between manoeuvres, with a prior, divided by the effective number of manoeuvres.
    robust: use Huber weights, so that a manoeuvre that disagrees cannot decide the result.
    """
    sizes = np.abs(pointers)
    if len(sizes) == 0 or not float(sizes.max()) > 0.0:
        return None
    units = pointers / np.where(sizes > 0.0, sizes, 1.0)
    weights = sizes
    away = np.zeros(len(sizes))
    mean = complex(np.sum(pointers))
    limit = math.pi
    for _ in range(ROBUST_ROUNDS):
        away = np.angle(units * mean.conjugate())
        typical = MEDIAN_TO_STD * float(np.median(np.abs(away)))
        limit = ROBUST_SPREADS * max(turns * MIN_SPREAD, typical)
        if robust:
            weights = sizes * np.minimum(1.0, limit / np.maximum(np.abs(away), 1e-12))
        mean = complex(np.sum(units * weights))
    total = float(np.sum(weights))
    effective = total * total / float(weights @ weights)
    spread = np.minimum(np.abs(away), COUNTED_LIMITS * limit)
    square = float(sizes @ (spread * spread)) / float(np.sum(sizes))
    freedom = PRIOR_MANOEUVRES + effective - 1.0
    variance = (PRIOR_MANOEUVRES * (turns * PRIOR_SPREAD) ** 2 + effective * square) / freedom
    std = math.sqrt(variance / effective / turns**2 + FLOOR_STD**2)
    if abs(complex(np.sum(pointers))) < MIN_AGREEMENT * float(np.sum(sizes)):
        std = max(std, TWO_MINDS_STD)
    return CombinedAngle(math.atan2(mean.imag, mean.real) / turns, std, len(sizes))


def combined_axis(pointers: Pointers, robust: bool = True) -> CombinedAngle | None:
    """Combine axis pointers (see `ManoeuvreBook`). The resulting angle may be wrong by 180 deg."""
    return combined(pointers, 2.0, robust)
