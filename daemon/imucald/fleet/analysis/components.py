"""Variance components of one axis, by restricted maximum likelihood, with their intervals.

The method is REML (Patterson and Thompson, Biometrika 58, 1971) with known, unequal variances of
the single values. Each component is estimated separately. D is estimated from the differences
between the drives in a segment (the means of the segments are free). T is estimated from the
differences between the vehicles of a type.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize_scalar
from scipy.special import digamma, polygamma
from scipy.stats import chi2

from imucald.core.arrays import Array, Index

LARGEST = 180.0**2
"""Upper limit of a mount's variance [deg^2]."""


class VarianceComponent(NamedTuple):
    """A variance [deg^2] with its 95 % interval (profile likelihood) and its degrees of freedom."""

    value: float
    low: float
    high: float
    freedom: int


def between_drives(y: Array, P: Array, segment: Index) -> VarianceComponent:
    """Return the variance D between drives for one axis. y: (n,) angles of the drives [deg]. P:
    (n,) variances of y. segment: (n,) index of the segment, ascending."""
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    freedom = len(y) - len(starts)
    if freedom < 1:
        return VarianceComponent(0.0, 0.0, LARGEST, 0)

    def deviance(D: float) -> float:
        w = 1.0 / (D + P)
        total = np.add.reduceat(w, starts)
        mean = np.add.reduceat(w * y, starts) / total
        left = y - np.repeat(mean, np.diff(starts, append=len(y)))
        return float(-np.log(w).sum() + np.log(total).sum() + (w * left * left).sum())

    return _found(deviance, freedom)


def between_vehicles(m: Array, V: Array) -> VarianceComponent:
    """Return the variance T between vehicles for one axis. m: (n,) angles of the vehicles of a type
    [deg]. V: (n,) variances of m."""
    if len(m) < 2:
        return VarianceComponent(0.0, 0.0, LARGEST, 0)

    def deviance(T: float) -> float:
        w = 1.0 / (T + V)
        mean = float(w @ m) / float(w.sum())
        return float(-np.log(w).sum() + np.log(w.sum()) + (w * (m - mean) ** 2).sum())

    return _found(deviance, len(m) - 1)


def _found(deviance: Callable[[float], float], freedom: int) -> VarianceComponent:
    """Return the value with the smallest deviance. The ends of its interval are the values at which
    the deviance is larger by 3.84."""

    def of_root(x: float) -> float:
        return deviance(x * x)

    # the search is bounded: from zero to three times the best value on a grid
    grid = np.concatenate([[0.0], np.geomspace(1e-3, LARGEST**0.5, 60)])
    values = [of_root(float(x)) for x in grid]
    k = int(np.argmin(values))
    low, high = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, len(grid) - 1)])
    best = minimize_scalar(of_root, bounds=(low, high), method="bounded", options={"xatol": 1e-6})
    x, least = (
        (float(best.x), float(best.fun)) if best.fun < values[k] else (float(grid[k]), values[k])
    )

    within_95 = float(chi2.ppf(0.95, 1))

    def above(other: float) -> float:
        return of_root(other) - least - within_95

    left = 0.0 if above(0.0) <= 0.0 else float(brentq(above, 0.0, x))
    top = float(grid[-1])
    right = top if above(top) <= 0.0 else float(brentq(above, x, top))
    return VarianceComponent(x * x, left * left, right * right, freedom)


def robust_variance(squares: Array, known: Array) -> float:
    """Return the variance D for which the median of squares / (D + known) equals the median of
    chi-square with one degree of freedom.

    squares: (n,) [deg^2], squares of normal variables with the variances D + known. If a tenth of
    the values are gross errors, the result changes by about a tenth. The result is used only as a
    start value.
    """
    if not len(squares):
        return 0.0

    def surplus(D: float) -> float:
        return float(np.median(squares / (D + known))) - float(chi2.median(1))

    return 0.0 if surplus(0.0) <= 0.0 else float(brentq(surplus, 0.0, LARGEST))


def moderated(T: Sequence[Sequence[VarianceComponent]], V: Array) -> tuple[Array, Array]:
    """Return the moderated variance T between vehicles (kinds, 3) [deg^2] for tests and shrinkage,
    and the degrees of freedom (kinds,) of T + V.

    V: (kinds, 3) usual variance of a vehicle's mean. A type with one vehicle gets the common T.

    Each variance is combined with the common distribution of all types (empirical Bayes; Smyth,
    Stat. Appl. Genet. Mol. Biol. 3, 2004). The logarithm of a variance with d degrees of freedom
    has a random scatter with the variance trigamma(d / 2). The additional scatter between types
    determines the weight of the common variance, as a number of degrees of freedom.
    """
    own = np.array([[axis.value for axis in kind] for kind in T]).reshape(-1, 3)
    freedom = np.array([kind[0].freedom for kind in T], dtype=float)
    judged = freedom > 0
    if judged.sum() < 2:
        fallback = own[judged][0] if judged.any() else np.zeros(3)
        return np.where(judged[:, None], own, fallback), np.maximum(freedom, 1.0)
    d = freedom[judged, None]
    s2 = np.maximum(own[judged] + V[judged], 1e-6)
    e = np.log(s2) - digamma(d / 2.0) + np.log(d / 2.0)
    common = e.mean(axis=0)
    spread = ((e - common) ** 2).sum() / (3.0 * (len(e) - 1))
    beyond = float(spread - polygamma(1, d / 2.0).mean())
    worth = min(_freedom(beyond), float(freedom.sum()))
    # with an infinitely strong prior the mean of the logarithms is the logarithm of the variance
    # itself
    s0 = (
        np.exp(common + digamma(worth / 2.0) - np.log(worth / 2.0))
        if beyond > 0
        else np.exp(common)
    )
    total = freedom[:, None] + worth
    mixed = (worth * s0 + freedom[:, None] * np.maximum(own + V, 1e-6)) / total
    return np.maximum(mixed - V, 0.0), total[:, 0]


def _freedom(beyond: float) -> float:
    """Return the degrees of freedom d for which trigamma(d / 2) equals `beyond`; a very large
    number if there is no additional scatter."""
    most = 1e6
    if beyond <= float(polygamma(1, most / 2.0)):
        return most
    return 2.0 * float(brentq(lambda x: float(polygamma(1, x)) - beyond, 1e-3, most))
