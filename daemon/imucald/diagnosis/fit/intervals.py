"""Values and intervals of freed parameters. Knows no cause by name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.fit.sandwich import QUARTERS, between_quarters, ridge, scatters, variances
from imucald.diagnosis.fit.score import Hypothesis, Problem

ERROR_RATE = 0.01
"""Of a drive: the chance that anything is named without a reason."""


@dataclass(frozen=True)
class Estimate:
    """Freed parameters with what is known of them. Arrays (k,)."""

    value: Array
    se: Array
    """Largest of sandwich, sandwich with lag one, model-based; with the wander between quarters and
    what the equations themselves err by."""
    quantile: float
    pull: float
    """By how many deviations the box pulls at the parameters: the root of twice the rise of the
    loss when they are put back into it, over-dispersion and wander taken off."""
    wander: Array
    """Scatter between quarters of the data beyond what chance gives."""

    @property
    def low(self) -> Array:
        """Lower ends of the intervals."""
        return np.asarray(self.value - self.quantile * self.se)

    @property
    def high(self) -> Array:
        """Upper ends of the intervals."""
        return np.asarray(self.value + self.quantile * self.se)


def quantile(blocks: int, questions: int) -> float:
    """Student's t for two sides, shared out over the questions asked (Bonferroni)."""
    return float(student.ppf(1.0 - ERROR_RATE / (2.0 * max(questions, 1)), max(blocks - 1, 1)))


def estimate(
    problem: Problem, h: Hypothesis, questions: int, null: Problem | None = None
) -> Estimate:
    """Value and deviation of a hypothesis' parameters, the others free within their box.

    null: the same with the box of correct files, where the model has moved out of it already.
    """
    gram, low, high = problem.widened(h)
    own = problem.own(h)
    total = gram.sum(axis=0)
    x = problem.fit(h)
    # What is bounded by a box is as uncertain as an even spread over it.
    prior = np.zeros(len(low))
    others = np.setdiff1d(np.arange(len(low)), own)
    prior[others] = 3.0 / np.maximum(0.5 * (high - low)[others], 1e-30) ** 2
    H = total[1:, 1:] + np.diag(prior) + ridge(total[1:, 1:])
    inverse = np.linalg.pinv(H)
    score = gram[:, 1:, 0] - gram[:, 1:, 1:] @ x
    ways = (*scatters(score, len(own) + 1), total[1:, 1:])
    spread = [variances(inverse, way + np.diag(prior))[own] for way in ways]
    variance = np.maximum(np.max(spread, axis=0), 0.0)
    far = variances(inverse, between_quarters(score) + np.diag(prior))[own]
    excess = np.maximum(far - variance, 0.0)
    more = problem.model_error(h) ** 2
    se = np.sqrt(variance + excess + more)
    wander = np.sqrt(QUARTERS * excess)
    pull = _pull(problem, h, x, own, more, null or problem)
    return Estimate(x[own], se, quantile(len(gram), questions), pull, wander)


def _pull(
    problem: Problem, h: Hypothesis, x: Array, own: Sequence[int], more: Array, null_of: Problem
) -> float:
    """Profile likelihood with the others in their box, so that none counts beyond its tolerance.

    The rise of the loss is divided by how much the blocks scatter more than the weights say
    (sandwich over model-based variance), and by `more` (k,), the variances of the equations
    themselves.
    """
    gram, low, high = problem.widened(h)
    total = gram.sum(axis=0)
    H, c = total[1:, 1:], total[1:, 0]
    base = problem.table.gram.sum(axis=0)
    null = null_of.fit()
    rise = (c @ x - 0.5 * x @ H @ x) - (base[1:, 0] @ null - 0.5 * null @ base[1:, 1:] @ null)
    width = high - low
    inside = np.flatnonzero((x > low + 1e-6 * width) & (x < high - 1e-6 * width))
    inside = np.union1d(inside, own)
    at = [int(np.flatnonzero(inside == i)[0]) for i in own]
    part = H[np.ix_(inside, inside)]
    inverse = np.linalg.pinv(part + ridge(part))
    score = (gram[:, 1:, 0] - gram[:, 1:, 1:] @ x)[:, inside]
    model = np.maximum(np.diag(inverse)[at], 1e-300)
    ways = (*scatters(score, len(own) + 1), between_quarters(score))
    spreads = [variances(inverse, way)[at] for way in ways]
    spread = max(1.0, float(np.max((np.max(spreads, axis=0) + more) / model)))
    # k parameters at once rise by k more without a reason.
    return float(np.sqrt(max(2.0 * rise / spread - (len(own) - 1), 0.0)))
