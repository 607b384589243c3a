"""The vehicles of a population with their mounts, and the weights for robust means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import t as t_distribution

from imucald.core.arrays import Array, Index

MAX_Q = 0.05
"""Expected share of false findings among all reported findings (Benjamini, Hochberg 1995)."""
T_FREEDOM = 4.0
"""Degrees of freedom of the t distribution that gives the weights of robust means (Lange et al., J.
Am. Stat. Assoc. 84, 1989: 4 is suitable for most data)."""


@dataclass(frozen=True)
class Units:
    """One row for each of n vehicles. rotation: mount in the first segment of the vehicle. V: (n,
    3, 3) covariance of this mount without the road crown [deg^2]. kind: (n,) index of the vehicle
    type; there are `kinds` types."""

    rotation: Rotation
    V: Array
    kind: Index
    kinds: int

    def __len__(self) -> int:
        """Return the number of vehicles."""
        return len(self.kind)

    @property
    def v(self) -> Array:
        """Variances about the three axes (n, 3)."""
        return np.diagonal(self.V, axis1=1, axis2=2)


def sums_by(values: Array, index: Index, length: int) -> Array:
    """Return the sums (length, m) of the rows of `values` (n, m) with the same index (n,)."""
    total = np.zeros((length, values.shape[1]))
    np.add.at(total, index, values)
    return total


def t_quantile(freedom: float) -> float:
    """Half width of the 95 % interval of a t distribution, in standard deviations."""
    return float(t_distribution.ppf(0.975, max(freedom, 1.0)))


def t_weights(e: Array, variance: Array) -> Array:
    """Return the weights (n,) of the t distribution in three dimensions. A weight is at most 1."""
    squares = (e * e / variance).sum(axis=1)
    return np.asarray(np.minimum((T_FREEDOM + 3.0) / (T_FREEDOM + squares), 1.0))
