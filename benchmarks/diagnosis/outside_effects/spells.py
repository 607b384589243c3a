"""Times at which a fault comes and goes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.diagnosis.real_effects import Array


def in_spells(t: Array, least_s: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """(N,) whether a time lies in a spell of `least_s` to 40 s; 30 to 120 s lie between."""
    inside, at = np.zeros(len(t), dtype=bool), float(t[0]) + rng.uniform(10.0, 60.0)
    while at < t[-1]:
        lasts = rng.uniform(least_s, 40.0)
        inside |= (t >= at) & (t < at + lasts)
        at += lasts + rng.uniform(30.0, 120.0)
    return inside
