"""Deviations of many questions about one drive, each by few segments: they borrow from each other.

How far segments scatter beyond the noise is known of each question by itself from as many segments
as it rests on, often fewer than ten, so that Student's law asks for six deviations and more. Of a
hundred questions about the same segments the over-dispersion is drawn from one law, which all of
them show: each is held against a mean of its own and the common one (moderated t; Smyth, Linear
models and empirical Bayes methods for assessing differential expression, 2004).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from imucald.core.arrays import Array

FEW = 10
"""Questions of which no law is taken."""
LEAST, MOST = 1e-2, 1e4
"""Degrees of freedom of the common one that are told from none, and from all."""


def moderated(over: Array, free: Array, most: float) -> tuple[Array, Array]:
    """(E,) over-dispersions and their degrees of freedom, each with what all others show.

    over: (E,) scatter over what noise makes; free: (E,) degrees of freedom that each is known by
    itself; most: no more than so many in all, since the questions share their segments.
    """
    known = (over > 0.0) & (free > 0.0)
    if known.sum() < FEW:
        return over, free
    prior, common = _law(over[known], free[known])
    prior = max(min(prior, most - float(np.median(free[known]))), 0.0)
    total = np.maximum(prior + free, 1e-300)
    return (prior * common + free * over) / total, np.minimum(total, most)


def _law(over: Array, free: Array) -> tuple[float, float]:
    """Degrees of freedom and value of the common over-dispersion, by mean and variance of the
    logarithms (Smyth 2004, section 6.2)."""
    half = 0.5 * free
    logs = np.log(over) - digamma(half) + np.log(half)
    more = float(logs.var(ddof=1) - polygamma(1, half).mean())
    if more <= polygamma(1, 0.5 * MOST):
        return MOST, float(np.exp(logs.mean()))
    if more >= polygamma(1, 0.5 * LEAST):
        return 0.0, float(np.exp(logs.mean()))
    prior = float(brentq(lambda x: float(polygamma(1, 0.5 * x)) - more, LEAST, MOST))
    return prior, float(np.exp(logs.mean() + digamma(0.5 * prior) - np.log(0.5 * prior)))
