"""Many questions about residuals, with one false-discovery rate for all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student

from imucald.diagnosis.result import Structure

FALSE_SHARE = 0.01
"""False-discovery rate of the reports. If nothing is wrong, it is the chance of any report."""


@dataclass(frozen=True)
class Question:
    """A question about a residual: its chance if nothing is wrong, and the report it would give."""

    p: float
    is_large: bool
    """True if the effect is larger than a correct model file may leave."""
    structure: Structure
    may_be_large: float = 1.0
    """Upper limit of the chance that the effect looks large if nothing is wrong. An accurately
    known value never looks large."""


def chance_of_large(limit: float, se: float, free: float, beside: float = 1.0) -> float:
    """Chance that a value exceeds a limit by `beside` standard deviations in either direction, if
    nothing is wrong. se: its standard deviation. free: degrees of freedom of that."""
    return float(2.0 * student.sf(limit / max(se, 1e-300) + beside, max(free, 1.0)))


def chance_of_both(by_parts: float, free: float, by_rows: float) -> float:
    """Two-sided chance of a value in standard deviations, by two measures: the scatter of parts
    (Student) and the noise of all rows (normal). Each measure has its own distribution."""
    return 2.0 * max(float(student.sf(by_parts, free)), float(norm.sf(by_rows)))


def beyond_chance(asked: Sequence[Question]) -> list[Structure]:
    """Return the structures to report: large effects whose chance is at most a certain level. The
    level is the largest at which the expected number of false reports is 1 % of all reports at that
    level. Of each signal and kind only the most certain is reported.

    At a level a, the chance of a false report of the i-th question is at most min(a, its chance to
    look large). The sum of these chances over the number of reports is the false-discovery rate
    (Benjamini and Hochberg 1995; as an estimate, Storey, Taylor and Siegmund 2004). Questions that
    can never be reported take no part (Tarone 1990).
    """
    found: dict[tuple[str, str], Structure] = {}
    large = sorted((q for q in asked if q.is_large), key=lambda q: q.p)
    may = np.array([q.may_be_large for q in asked])
    sure = 0
    for k, q in enumerate(large, start=1):
        if float(np.minimum(may, q.p).sum()) <= k * FALSE_SHARE:
            sure = k
    for q in large[:sure]:
        found.setdefault((q.structure.signal, q.structure.kind), q.structure)
    return list(found.values())
