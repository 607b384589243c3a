"""Many tests of residuals, with one false-discovery rate for all tests.

The tests are the rows of `left_over.table`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma
from scipy.stats import norm
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.result import Structure
from imucald.diagnosis.signals import CHANCE

Tick = Callable[[str], None]
"""Function that is called with the text of the present step."""


@dataclass(frozen=True)
class Answer:
    """Result of one test of a residual or of raw values."""

    signal: str
    size: float
    """Size of the effect, in any unit."""
    least: float
    """Largest size that a correct model file or a healthy signal may cause, in the same unit."""
    p: float
    """Chance of such an effect if nothing is wrong."""
    text: str
    parameter: str = ""
    """The zero error or gain that changes, as in `Structure`."""
    sure: float | None = None
    """The part of the size that must exceed `least`; None: the whole size."""
    shown: float | None = None
    """Reported size; None: the ratio of size and `least`."""
    rare: float = 1.0
    """Upper limit of the chance that the effect looks large although nothing is wrong. An
    accurately known value never looks large by chance."""
    kind: str = ""
    """Kind of the structure; empty: the kind of the row."""

    @property
    def is_large(self) -> bool:
        """True if the effect is larger than a correct model file may cause."""
        return bool((self.size if self.sure is None else self.sure) > self.least)

    @property
    def structure(self) -> Structure:
        """The structure that is reported."""
        shown = self.size / self.least if self.shown is None else self.shown
        return Structure(self.signal, self.kind, shown, self.text, self.parameter)


@dataclass(frozen=True)
class Row:
    """One question about structure that no cause of the catalogue explains."""

    kind: str
    """Kind of the reported structure."""
    question: str
    statistic: Callable[[Any], Iterable[Answer]]
    """Function of the evidence of the table."""
    has_limit: bool = False
    """True if `least` contains the chance: every effect beyond `least` is then reported, without a
    share of the false-discovery rate."""

    def asked(self, evidence: Any) -> list[Answer]:
        """Return the answers to the question."""
        return [replace(a, kind=a.kind or self.kind) for a in self.statistic(evidence)]


def chance_of_large(limit: float, se: float, free: float) -> float:
    """Return the chance that a value exceeds a limit by one standard deviation in either direction,
    if nothing is wrong. se: standard deviation of the value. free: degrees of freedom of this
    standard deviation."""
    return float(2.0 * student.sf(limit / max(se, 1e-300) + 1.0, max(free, 1.0)))


def chance_of_both(by_parts: float, free: float, by_rows: float) -> float:
    """Return the two-sided chance of a value in standard deviations, by two measures of the
    deviation: the scatter of parts (Student's t) and the noise of all rows (normal). The larger
    chance counts."""
    return 2.0 * max(float(student.sf(by_parts, free)), float(norm.sf(by_rows)))


def reported(rows: Iterable[Row], evidence: Any, tick: Tick, apart: str = "") -> list[Structure]:
    """Ask all rows, and return the structures to report. tick: called with each question. apart:
    parameter whose answers have a false-discovery rate of their own."""
    certain: list[Structure] = []
    others: list[Answer] = []
    for row in rows:
        tick(row.question)
        answers = row.asked(evidence)
        if row.has_limit:
            certain += [a.structure for a in answers if a.is_large]
        else:
            others += answers
    is_apart = [apart != "" and a.parameter == apart for a in others]
    for own in (False, True):
        part = (a for a, flag in zip(others, is_apart, strict=True) if flag == own)
        certain += beyond_chance(part)
    return certain


def beyond_chance(asked: Iterable[Answer]) -> list[Structure]:
    """Return the structures to report: large effects whose chance is at most a certain level. The
    level is the largest level at which the expected number of false reports is 1 % (`CHANCE`) of
    all reports at this level. If nothing is wrong, this is the chance of any report. For each
    signal and kind, only the most certain structure is reported.

    At a level a, the chance of a false report of the i-th question is at most min(a, chance that
    its effect looks large). The sum of these chances divided by the number of reports is the
    false-discovery rate (Benjamini and Hochberg 1995; as an estimate, Storey, Taylor and Siegmund
    2004). Questions that can never be reported do not count (Tarone 1990).
    """
    answers = list(asked)
    found: dict[tuple[str, str], Structure] = {}
    large = sorted((a for a in answers if a.is_large), key=lambda a: a.p)
    may = np.array([a.rare for a in answers])
    sure = 0
    for k, a in enumerate(large, start=1):
        if float(np.minimum(may, a.p).sum()) <= k * CHANCE:
            sure = k
    for a in large[:sure]:
        found.setdefault((a.signal, a.kind), a.structure)
    return list(found.values())


# shared scatter ----------------------------------------------------------------------------------

FEW = 10
"""Number of questions below which no common distribution is estimated."""
LEAST, MOST = 1e-2, 1e4
"""Range of the common distribution's degrees of freedom. Below the first value the common
distribution is ignored. The second value is the largest value used."""


def moderated(over: Array, free: Array, most: float) -> tuple[Array, Array]:
    """Return moderated over-dispersions (E,) and their degrees of freedom (E,).

    With fewer than ten segments, the scatter of a single question requires six standard deviations
    in Student's t test. A hundred questions about the same segments have over-dispersions from one
    common distribution. Each question therefore uses a mean of its own over-dispersion and the
    common over-dispersion (moderated t; Smyth, Linear models and empirical Bayes methods for
    assessing differential expression, 2004).

    over: (E,) scatter divided by the scatter of noise alone. free: (E,) degrees of freedom of each
    question alone. most: upper limit of the total degrees of freedom, because all questions use the
    same segments.
    """
    known = (over > 0.0) & (free > 0.0)
    if known.sum() < FEW:
        return over, free
    prior, common = _law(over[known], free[known])
    prior = max(min(prior, most - float(np.median(free[known]))), 0.0)
    total = np.maximum(prior + free, 1e-300)
    return (prior * common + free * over) / total, np.minimum(total, most)


def _law(over: Array, free: Array) -> tuple[float, float]:
    """Return degrees of freedom and value of the common over-dispersion, from mean and variance of
    the logarithms (Smyth 2004, section 6.2)."""
    half = 0.5 * free
    logs = np.log(over) - digamma(half) + np.log(half)
    more = float(logs.var(ddof=1) - polygamma(1, half).mean())
    if more <= polygamma(1, 0.5 * MOST):
        return MOST, float(np.exp(logs.mean()))
    if more >= polygamma(1, 0.5 * LEAST):
        return 0.0, float(np.exp(logs.mean()))
    prior = float(brentq(lambda x: float(polygamma(1, 0.5 * x)) - more, LEAST, MOST))
    return prior, float(np.exp(logs.mean() + digamma(0.5 * prior) - np.log(0.5 * prior)))
