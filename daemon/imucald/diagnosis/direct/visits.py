"""Whether a signal comes to a value too often for chance, by the values next to it."""

from __future__ import annotations

from scipy.stats import binom

from imucald.core.arrays import true_runs
from imucald.diagnosis.signals import Mask
from imucald.motion.rail_evidence import PILE


def visited_too_often(is_there: Mask, beside: int, levels: int, chance: float) -> bool:
    """Whether k visits to a value are too many for m samples in n levels next to it.

    Where each level is as likely as the next, k of k + m is binomial with p <= 1/(n + 1). Visits
    are counted and not samples, since a slow signal stays for some at any value.

    is_there: (N,) samples at the value, in order of time; beside: m; levels: n; chance: of saying
    so without a reason.
    """
    visits = len(true_runs(is_there))
    return bool(binom.sf(visits - 1, visits + beside, PILE / (PILE + levels)) < chance)
