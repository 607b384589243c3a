"""Vehicles as the units of a population, and the weights for robust means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import t as t_distribution

from imucald.core.arrays import Array, Index

MAX_Q = 0.05
"""Expected share of false findings among those reported (Benjamini, Hochberg 1995)."""
T_FREEDOM = 4.0
"""Degrees of freedom of the t distribution whose weights make the centre robust (Lange et al., J.
Am. Stat. Assoc. 84, 1989: 4 serves most data)."""


@dataclass(frozen=True)
class Units:
    """One row for each vehicle. rotation: its first segment's mount. V: (n, 3, 3) its covariance
    without the crown's part [deg^2]. kind: (n,) index of its type; there are `kinds` types."""

    rotation: Rotation
    V: Array
    kind: Index
    kinds: int

    def __len__(self) -> int:
        """Return the number of vehicles."""
        return len(self.kind)

    @property
    def v(self) -> Array:
        """Variances (n, 3)."""
        return np.diagonal(self.V, axis1=1, axis2=2)


def t_quantile(freedom: float) -> float:
    """Half width of a 95 % interval in standard deviations."""
    return float(t_distribution.ppf(0.975, max(freedom, 1.0)))


def t_weights(e: Array, variance: Array) -> Array:
    """Weights (n,), at most 1, of the t distribution in three dimensions."""
    squares = (e * e / variance).sum(axis=1)
    return np.asarray(np.minimum((T_FREEDOM + 3.0) / (T_FREEDOM + squares), 1.0))
