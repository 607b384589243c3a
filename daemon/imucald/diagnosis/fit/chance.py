"""Many questions about what is left, and one false-discovery rate over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from imucald.diagnosis.result import Structure

FALSE_SHARE = 0.01
"""Of what is reported; where nothing is left, the chance that anything is."""


@dataclass(frozen=True)
class Question:
    """Asked of a residual: its chance where nothing is there, and what would be reported."""

    p: float
    is_large: bool
    """Beyond what a correct model file may leave."""
    structure: Structure
    may_be_large: float = 1.0
    """Chance that it looks large where nothing is there, or more: a value that is known well never
    does, whatever its own chance."""


def chance_of_large(limit: float, se: float, free: float, beside: float = 1.0) -> float:
    """That a value whose error has a deviation `se`, known by so many degrees of freedom, exceeds a
    limit by so many deviations to either side, where nothing is there."""
    return float(2.0 * student.sf(limit / max(se, 1e-300) + beside, max(free, 1.0)))


def chance_of_both(by_parts: float, free: float, by_rows: float) -> float:
    """Of a value by so many deviations: by how parts scatter (Student), and by the noise of all
    rows (normal), to either side. Each has its own law."""
    return 2.0 * max(float(student.sf(by_parts, free)), float(norm.sf(by_rows)))


def beyond_chance(asked: Sequence[Question]) -> list[Structure]:
    """What is reported: large ones whose chance is up to the largest level at which the expected
    number of false ones is a hundredth of those that reach it; of each signal and kind the largest.

    At a level a the i-th question is reported falsely with a chance of min(a, its chance to look
    large) at most: the sum of these over the number that is reported is the rate of false ones
    (Benjamini and Hochberg 1995 as an estimate, Storey, Taylor and Siegmund 2004; what cannot be
    reported takes no part, Tarone 1990).
    """
    found: dict[tuple[str, str], Structure] = {}
    large = sorted((q for q in asked if q.is_large), key=lambda q: q.p)
    may = np.array([q.may_be_large for q in asked])
    sure = 0
    for k, q in enumerate(large, start=1):
        if float(np.minimum(may, q.p).sum()) <= k * FALSE_SHARE:
            sure = k
    for q in large[:sure]:
        at = q.structure.signal, q.structure.kind
        if at not in found or q.structure.size > found[at].size:
            found[at] = q.structure
    return list(found.values())
