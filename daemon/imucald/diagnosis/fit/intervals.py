"""Values and intervals of freed parameters. No function in this module depends on the name of a
cause."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.fit.box import RIDGE
from imucald.diagnosis.fit.score import Hypothesis, Problem, explained
from imucald.diagnosis.signals import CHANCE


@dataclass(frozen=True)
class Estimate:
    """Estimates of freed parameters. Arrays are (k,)."""

    value: Array
    se: Array
    """Standard error of each parameter: the largest of three estimates (sandwich, sandwich with lag
    one, model-based). The wander between quarters of the data and the error of the equations
    are added."""
    quantile: float
    pull: float
    """Distance of the parameters from the box in standard deviations. It is the square root of
    twice the rise of the loss when the parameters are moved back into the box, corrected for
    over-dispersion and wander."""
    wander: Array
    """Scatter between quarters of the data in addition to chance."""


def quantile(blocks: int, questions: int) -> float:
    """Return the two-sided quantile of Student's t, corrected for the number of questions
    (Bonferroni)."""
    return float(student.ppf(1.0 - CHANCE / (2.0 * max(questions, 1)), max(blocks - 1, 1)))


def estimate(
    problem: Problem, h: Hypothesis, questions: int, null: Problem | None = None
) -> Estimate:
    """Return value and standard deviation of a hypothesis's parameters. The other parameters are
    free within their box.

    null: the same problem with the box of correct model files. `null` is needed if the model has
    already left this box.
    """
    gram, low, high = problem.widened(h)
    own = problem.own(h)
    total = gram.sum(axis=0)
    x = problem.fit(h)
    # A parameter bounded by a box gets the variance of a uniform distribution over the box.
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
    pull = _pull(problem, h, more, null or problem)
    return Estimate(x[own], se, quantile(len(gram), questions), pull, wander)


def _pull(problem: Problem, h: Hypothesis, more: Array, null: Problem) -> float:
    """Return the distance of the parameters from the box, by a profile likelihood. The other
    parameters stay in their box, so that none exceeds its tolerance.

    The rise of the loss is divided by the over-dispersion of the blocks (sandwich variance divided
    by model-based variance). more: (k,) variances of the errors of the equations; they are added.
    """
    gram, low, high = problem.widened(h)
    x, own, width = problem.fit(h), problem.own(h), high - low
    rise = explained(gram, x) - explained(problem.table.gram, null.fit())
    free = np.flatnonzero((x > low + 1e-6 * width) & (x < high - 1e-6 * width))
    inside = np.union1d(free, own)
    at = np.searchsorted(inside, own)
    part = gram.sum(axis=0)[1:, 1:][np.ix_(inside, inside)]
    inverse = np.linalg.pinv(part + ridge(part))
    score = (gram[:, 1:, 0] - gram[:, 1:, 1:] @ x)[:, inside]
    model = np.maximum(np.diag(inverse)[at], 1e-300)
    ways = (*scatters(score, len(own) + 1), between_quarters(score))
    spreads = [variances(inverse, way)[at] for way in ways]
    spread = max(1.0, float(np.max((np.max(spreads, axis=0) + more) / model)))
    # By chance alone, k parameters raise twice the loss by about k.
    return float(np.sqrt(max(2.0 * rise / spread - (len(own) - 1), 0.0)))


# sandwich ----------------------------------------------------------------------------------------

QUARTERS = 4


def ridge(H: Array) -> Array:
    """Return the ridge that is added to a Hessian (P, P) so that it can be inverted."""
    return RIDGE * np.diag(np.maximum(np.diag(H), 1e-30))


def scatters(score: Array, fitted: int) -> tuple[Array, Array]:
    """Return two scatter matrices (P, P) of the blocks' scores (B, P). The first matrix treats
    blocks as independent. The second matrix includes the correlation with the neighbouring block,
    for effects longer than a block.
    fitted: number of parameters fitted to the blocks."""
    B = len(score)
    alone = score.T @ score * (B / max(B - fitted, 1))
    lag = score[1:].T @ score[:-1]
    return alone, alone + lag + lag.T


def between_quarters(score: Array) -> Array:
    """Return the scatter of the quarters' scores about their mean (cluster-robust; Cameron and
    Miller 2015).

    A parameter that drifts between quarters counts by its effect on the whole fit. If a quarter
    contains little information on a parameter, the quarter's own value may be very wrong, but it
    hardly changes the fit of all quarters.
    """
    if len(score) < 2 * QUARTERS:
        return np.zeros((score.shape[1], score.shape[1]))
    parts = np.array([part.sum(axis=0) for part in np.array_split(score, QUARTERS)])
    parts = parts - parts.mean(axis=0)
    return np.asarray(parts.T @ parts * (QUARTERS / (QUARTERS - 1)))


def variances(inverse: Array, scatter: Array) -> Array:
    """Return the variances (P,) of the parameters, from the inverse Hessian and the scatter of the
    scores."""
    return np.diag(inverse @ scatter @ inverse)
