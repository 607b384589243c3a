"""Slopes of roads, and the mean slope of a stretch of road with its variance."""

from __future__ import annotations

from typing import Final, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, Flags, inverse
from imucald.motion.ticks import TICK_S

SLOPE, SLOPE_M = 0.02, 400.0
"""Standard deviation of a road's slope (tangent), and distance [m] between two independent slopes.
This distance is twice the correlation length of the slope.

Roads in rolling terrain have grades up to 3 to 5 %, normal cross slopes of 1.5 to 2 %, and 4 to 8 %
in bends. Vertical curves at 50 to 100 km/h are 60 to 400 m long (AASHTO, A Policy on Geometric
Design, ch. 3 and 4).
"""
LONGER_ABOVE = 15.0
"""Speed [m/s] above which the length of slopes grows in proportion to the speed.

The length of crests and sags is designed for the sight distance at the design speed (assumption).
In the rules of AASHTO, the length grows more than in proportion to the speed.
"""
LENGTHS: Final = SLOPE_M * np.array([1.0, 4.0, 16.0])
"""Possible distances [m] between two independent slopes: usual roads, hills, mountains."""
CHANCES: Final = np.array([0.9, 0.08, 0.02])
"""Prior probabilities of `LENGTHS` (assumption). The measured drives css_canmod_164 and
kingston_2008, 25 and 18 km, have the first length with a probability of 0.98 and more.

These values, `FREEDOM` and `PLACE_M` were chosen on simulated drives with the seeds 1930000 to
1932219. These drives are not used to judge results.
"""
FREEDOM = 10.0
"""Degrees of freedom of the prior of the slope's variance (assumption).

The standard deviation is above 0.03 in one drive of thirty, and above 0.04 in one of three hundred.
"""
PLACE_M = 100.0
"""Distance [m] over which a slope is averaged before the process of slopes is fitted."""


Speed = TypeVar("Speed", float, Array)


def slope_way(speed: Speed) -> Speed:
    """Return the distance per second [m/s] that counts for the number of independent slopes. It is
    shorter than the driven distance at high speed, because slopes of fast roads are longer.
    """
    passed: Speed = abs(speed) / (1.0 + (speed / LONGER_ABOVE) ** 2) ** 0.5
    return passed


def road_weight(speed: Array, use: Flags) -> Array:
    """Return the weights (N,) of ticks in a mean over the road [m]. A tick at rest counts a little,
    because a long stop is still one place. speed: (N,) [m/s]. use: (N,) flags of usable ticks."""
    return np.asarray(slope_way(speed) * use * TICK_S + 0.05 * TICK_S * use)


class Slopes(NamedTuple):
    """Slopes of the roads of a drive, along and across the vehicle.

    mean, mean_variance: (2,) mean slope, and variance of the difference between this mean and the
    mean of all roads. chances: (2, L) probability of each of the L `LENGTHS`. variances: (2, L)
    variance of a slope for each length.
    """

    mean: Array
    mean_variance: Array
    chances: Array
    variances: Array

    def over(self, metres: Array) -> Array:
        """Return the variances (n, 2) of the mean slope over distances (n,) [m]."""
        shares = self.chances * self.variances
        return np.asarray((shares / (1.0 + metres[:, None, None] / LENGTHS)).sum(axis=2))

    @property
    def density(self) -> Array:
        """Variances (2,) of the mean slope over a long distance, multiplied by the distance [m]."""
        return np.asarray((self.chances * self.variances * LENGTHS).sum(axis=1))


def road_slopes(blocks: Array, slope: float) -> Slopes:
    """Estimate the mean and the spread of the roads' slopes.

    The slope is a first-order Gauss-Markov process about its mean. The distance between two
    independent slopes is one of `LENGTHS`. The variance of the slope has an inverse gamma prior
    with `FREEDOM` degrees of freedom, so it is eliminated in closed form (Gelman et al., Bayesian
    Data Analysis, 3rd ed., ch. 3.2). The result is the mean over the lengths, weighted by their
    probabilities.

    blocks: (n, 4) for each block the weighted sum of slopes along the vehicle, the weighted sum of
    slopes across the vehicle, the weight, and the distance [m]. slope: expected deviation of a
    slope.
    """
    passed = np.cumsum(blocks[:, 3])
    metres = float(passed[-1]) if len(passed) else 0.0
    places = max(round(metres / PLACE_M), 1)
    middles = (passed - 0.5 * blocks[:, 3]) * (places / max(metres, 1e-9))
    at = np.minimum(middles.astype(int), places - 1)
    sums = np.array([np.bincount(at, x, places) for x in blocks[:, :3].T])
    sums = sums[:, sums[2] > 0.0]
    n = sums.shape[1]
    if n == 0:
        variances = np.full((2, len(LENGTHS)), slope**2)
        return Slopes(np.zeros(2), variances[:, 0], np.tile(CHANCES, (2, 1)), variances)
    x = sums[:2] / sums[2]
    rho = np.exp(-2.0 * max(metres / n, 1.0) / LENGTHS)[:, None]  # of two neighbouring places
    free, step = 1.0 - rho**2, np.sqrt((1.0 - rho) / (1.0 + rho))
    change = (x[:, 1:] - rho[..., None] * x[:, :-1]) / np.sqrt(free)[..., None]  # (L, 2, n - 1)
    known = 1.0 + (n - 1) * step**2
    mean = (x[:, 0] + step * change.sum(axis=2)) / known
    left = np.square(x[:, 0]) + np.square(change).sum(axis=2) - known * np.square(mean)
    squares = slope**2 * (FREEDOM - 2.0) + np.maximum(left, 0.0)
    freedom = FREEDOM + n - 1
    log = np.log(CHANCES)[:, None] - 0.5 * (np.log(known) + (n - 1) * np.log(free))
    log = log - 0.5 * freedom * np.log(squares)
    chances = np.exp(log - log.max(axis=0))
    chances /= chances.sum(axis=0)
    variances = squares / (freedom - 2.0)
    found = (chances * mean).sum(axis=0)
    spread = (chances * (variances / known + np.square(mean - found))).sum(axis=0)
    return Slopes(found, spread, chances.T, variances.T)


def mean_slopes(blocks: Array, parts: NDArray[np.int_]) -> tuple[Array, Array]:
    """Return the mean slopes (K, 2) of parts of the drive, and the distances (K,) of the parts [m].

    blocks: (n, 4) columns as in `road_slopes`. parts: (K, 2) index of the first block of each part,
    and index after the last block.
    """
    sums = np.zeros((len(blocks) + 1, 4))
    np.cumsum(blocks, axis=0, out=sums[1:])
    level, weight, metres = np.split(sums[parts[:, 1]] - sums[parts[:, 0]], (2, 3), axis=1)
    return level / np.maximum(weight, 1e-9), metres[:, 0]


def without_bend(blocks: Array, variance: float, bend: float) -> tuple[float, float]:
    """Return the mean slope across the vehicle, and the variance of this mean, for a path whose
    curvature has an unknown zero error.

    blocks: (n, 5) columns as in `road_slopes`, and the weighted sum of squares of the speed divided
    by g. variance: variance of the mean without a zero error. bend: deviation of the curvature's
    zero error [1/m].
    """
    weight = blocks[:, 2]
    share, square = weight / weight.sum(), blocks[:, 4] / np.maximum(weight, 1e-9)
    rows = np.column_stack([np.ones(len(blocks)), square])
    information = rows.T @ (share[:, None] * rows) / variance
    information[1, 1] += bend**-2
    across = np.divide(blocks[:, 1], weight, out=np.zeros(len(blocks)), where=weight > 1e-9)
    score = rows.T @ (share * across) / variance
    covariance = inverse(information)
    return float(covariance[0] @ score), float(covariance[0, 0])
