"""Variances of several vehicle types. Each variance is combined with the common distribution of all
types (moderation).

The method is empirical Bayes (Smyth, Stat. Appl. Genet. Mol. Biol. 3, 2004). The logarithm of a
variance with d degrees of freedom has a random scatter with the variance trigamma(d / 2). The
additional scatter between types determines the weight of the common variance, as a number of
degrees of freedom.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from imucald.core.arrays import Array
from imucald.fleet.analysis.components import VarianceComponent

LEAST = 1e-6
"""Smallest variance whose logarithm is taken [deg^2]."""
MOST_FREEDOM = 1e6


def moderated(T: Sequence[Sequence[VarianceComponent]], V: Array) -> tuple[Array, Array]:
    """Return the moderated variance T between vehicles (kinds, 3) [deg^2] for tests and shrinkage,
    and the degrees of freedom (kinds,) of T + V.

    V: (kinds, 3) usual variance of a vehicle's mean. A type with one vehicle gets the common T.
    """
    own = np.array([[axis.value for axis in kind] for kind in T]).reshape(-1, 3)
    freedom = np.array([kind[0].freedom for kind in T], dtype=float)
    judged = freedom > 0
    if judged.sum() < 2:
        fallback = own[judged][0] if judged.any() else np.zeros(3)
        return np.where(judged[:, None], own, fallback), np.maximum(freedom, 1.0)
    d = freedom[judged, None]
    s2 = np.maximum(own[judged] + V[judged], LEAST)
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
    mixed = (worth * s0 + freedom[:, None] * np.maximum(own + V, LEAST)) / total
    return np.maximum(mixed - V, 0.0), total[:, 0]


def _freedom(beyond: float) -> float:
    """Return the degrees of freedom d for which trigamma(d / 2) equals `beyond`; a very large
    number if there is no additional scatter."""
    if beyond <= float(polygamma(1, MOST_FREEDOM / 2.0)):
        return MOST_FREEDOM
    return 2.0 * float(brentq(lambda x: float(polygamma(1, x)) - beyond, 1e-3, MOST_FREEDOM))
