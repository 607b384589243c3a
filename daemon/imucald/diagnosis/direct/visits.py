"""Test whether a signal reaches a value too often for chance, compared with neighbouring values."""

from __future__ import annotations

from scipy.stats import binom

from imucald.core.arrays import true_runs
from imucald.diagnosis.signals import Mask
from imucald.motion.rail_evidence import PILE


def visited_too_often(is_there: Mask, beside: int, levels: int, chance: float) -> bool:
    """True if k visits to a value are too many for m samples in n levels next to it.

    If all levels are equally likely, k of k + m is binomial with p <= 1/(n + 1). Visits are counted
    instead of samples, since a slow signal stays at any value for several samples.

    is_there: (N,) samples at the value, in order of time; beside: m; levels: n; chance: allowed
    chance of a false answer.
    """
    visits = len(true_runs(is_there))
    return bool(binom.sf(visits - 1, visits + beside, PILE / (PILE + levels)) < chance)
