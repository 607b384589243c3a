"""Standard deviations of many questions about one drive, each from few segments. The questions
share information about their scatter.

The scatter of segments beyond the noise (over-dispersion) is known for each question only from its
own segments, often fewer than ten. With so few, Student's t requires six standard deviations and
more. But a hundred questions about the same segments have over-dispersions from one common
distribution, which can be estimated from all of them. Each question therefore uses a mean of its
own over-dispersion and the common one (moderated t; Smyth, Linear models and empirical Bayes
methods for assessing differential expression, 2004).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from imucald.core.arrays import Array

FEW = 10
"""With fewer questions than this, no common distribution is estimated."""
LEAST, MOST = 1e-2, 1e4
"""Range of the common distribution's degrees of freedom: below the first it is ignored; the second
is the largest value."""


def moderated(over: Array, free: Array, most: float) -> tuple[Array, Array]:
    """(E,) moderated over-dispersions and their degrees of freedom.

    over: (E,) scatter divided by that of noise alone. free: (E,) degrees of freedom of each by
    itself. most: upper limit of the total degrees of freedom, since the questions share their
    segments.
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
