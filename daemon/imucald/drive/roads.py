"""Slopes of roads, and the mean slope of a stretch of road with its variance."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, inverse

SLOPE, SLOPE_M = 0.02, 400.0
"""Standard deviation of a road's slope (tangent), and distance [m] between two independent slopes.
This distance is twice the correlation length of the slope.
"""
LONGER_ABOVE = 15.0
"""Speed [m/s] above which the length of slopes grows in proportion to the speed.

The length of crests and sags is designed for the sight distance at the design speed (assumption).
In the rules of AASHTO, the length grows more than in proportion to the speed.
"""
PRIOR_SEGMENTS = 5.0
"""Weight of the expected spread between road segments against the measured spread, in segments.

The value was chosen on the drives that are listed in `mount.joint.state.Priors`.
"""


Speed = TypeVar("Speed", float, Array)


def slope_way(speed: Speed) -> Speed:
    """Return the distance per second [m/s] that counts for the number of independent slopes. It is
    shorter than the driven distance at high speed, because slopes of fast roads are longer.
    """
    passed: Speed = abs(speed) / (1.0 + (speed / LONGER_ABOVE) ** 2) ** 0.5
    return passed


def mean_slopes(blocks: Array, parts: NDArray[np.int_], slope: float) -> tuple[Array, Array]:
    """Return the mean slopes of roads (K, 2), and the variances of these means (K, 2).

    blocks: (n, 4) for each block the weighted sum of slopes along the vehicle, the weighted sum of
    slopes across the vehicle, the weight, and the distance [m]. parts: (K, 2) index of the first
    block of each mean, and index after the last block. slope: expected deviation of a road's slope.
    If slopes last longer than expected, the spread between road segments is larger than expected.
    The variance is then multiplied by the measured ratio.
    """
    sums = np.zeros((len(blocks) + 1, 4))
    np.cumsum(blocks, axis=0, out=sums[1:])
    starts, stops = parts[:, :1], parts[:, 1:]
    level, weight, metres = np.split(sums[parts[:, 1]] - sums[parts[:, 0]], (2, 3), axis=1)
    mean = level / np.maximum(weight, 1e-9)
    expected = slope**2 / (1.0 + metres / SLOPE_M)
    at = np.arange(len(blocks))
    inside = (at >= starts) & (at < stops)
    off = (blocks[:, :2].T - mean[:, :, None] * blocks[:, 2]) * inside[:, None]
    passed = np.where(inside, sums[1:, 3] - sums[starts, 3], 0.0)
    rows = np.arange(2 * len(parts)).reshape(-1, 2, 1)
    grow = np.ones(mean.shape)
    for length in (SLOPE_M, 4.0 * SLOPE_M):
        place = (passed / length).astype(int)
        n = place.max(axis=1)[:, None] + 1.0
        most = int(n.max())
        at_place = (rows * most + place[:, None]).ravel()
        each = np.bincount(at_place, off.ravel(), rows.size * most).reshape(-1, 2, most)
        found = (each**2).sum(axis=2) + (each[:, :, 1:] * each[:, :, :-1]).sum(axis=2)
        ratio = found * n / np.maximum(n - 1.0, 1.0) / np.maximum(weight, 1e-9) ** 2 / expected
        found_grow = (PRIOR_SEGMENTS + n * ratio) / (PRIOR_SEGMENTS + n)
        grow = np.where(n > 1.0, np.maximum(grow, found_grow), grow)
    return mean, expected * grow


def without_bend(blocks: Array, variance: float, bend: float) -> tuple[float, float]:
    """Return the mean slope across the vehicle, and the variance of this mean, for a path whose
    curvature has an unknown zero error.

    blocks: (n, 5) columns as in `mean_slopes`, and the weighted sum of squares of the speed divided
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
