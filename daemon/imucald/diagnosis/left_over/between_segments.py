"""Find gains whose best values in single segments differ by more than their errors (random
effects).

A gain should be one number. If its best values in the segments differ by more than their errors and
a correct file's tolerances allow, one number does not describe the drive: something changes the
gain.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.stats import chi2

from imucald.core.arrays import Array
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.chance import Question
from imucald.diagnosis.fit.intervals import ERROR_RATE
from imucald.diagnosis.fit.score import Hypothesis, Problem, one_in_fifteen, what_leaves
from imucald.diagnosis.left_over.stability import EVENLY, amount
from imucald.diagnosis.outcome import SEEN_SHARE, first_signal
from imucald.diagnosis.result import WANDERS, Structure
from imucald.diagnosis.search.search import beyond
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import hypotheses
from imucald.mount.mount_words import SD_95

LEAST_BLOCKS = 8
OWN = 3
"""Numbers fitted to each segment, which reduce its noise: two tilts and the value itself."""


def gains_apart(problem: Problem, state: State, drift: Hypothesis | None) -> list[Question]:
    """Questions for each gain, whether or not it was named as a cause. Zeros are not tested,
    because a segment's own zero absorbs the effect of its road. Delays, lever arm and springs are
    not tested, because they absorb errors of the tyre equations. drift: a named drift, which has no
    place in the model file; it is fitted too."""
    table = problem.table
    if table.blocks < LEAST_BLOCKS:
        return []
    z = what_leaves(problem, drift)
    asked = [h for h in hypotheses(table, state.model, []) if _is_gain(h)]
    return [q for h in asked for q in _questions(problem, h, h.keys, z)]


def named_apart(problem: Problem, state: State, drift: Hypothesis | None) -> list[Structure]:
    """Named gains that are not constant. These questions have their own error rate of 1 %, because
    readers take a named gain as valid for the whole drive."""
    table = problem.table
    if table.blocks < LEAST_BLOCKS:
        return []
    z = what_leaves(problem, drift)
    asked = [q for t in state.named if _is_gain(t.hypothesis)
             for q in _questions(problem, t.hypothesis, beyond(t), z)]  # fmt: skip
    return [q.structure for q in asked if q.is_large and q.p * len(asked) < ERROR_RATE]


def _is_gain(h: Hypothesis) -> bool:
    return h.pattern is None and all(key.split(".")[1] == "scale" for key in h.keys)


def _questions(
    problem: Problem, h: Hypothesis, keys: Sequence[str], z: Array
) -> Iterator[Question]:
    """keys: those of the hypothesis that are tested."""
    table = problem.table
    errors = problem.model_error(h)
    for k, key in enumerate(h.keys):
        if key not in keys:
            continue
        moved = h.directions[k] if h.directions else {key: 1.0}
        d = np.zeros(z.shape[1])
        for name, factor in moved.items():
            d[table.keys.index(name) + 1] = factor
        may = float(table.tolerance[table.keys.index(key)] + SD_95 * errors[k])
        x, variance = _own_values(table, d, z)
        if len(x) >= LEAST_BLOCKS:
            size, p = _scatter(x, variance, EVENLY * may)
            text = (
                f"{key} changes from segment to segment by {amount(key, size)}, not counting "
                f"its own errors (limit {amount(key, EVENLY * may)})"
            )
            signal = first_signal(table, [key])
            size /= EVENLY * may
            yield Question(p, size > 1.0, Structure(signal, WANDERS, size, text, key))


def _own_values(table: Table, d: Array, z: Array) -> tuple[Array, Array]:
    """Departure of each segment from the fit along a direction d (P+1,), and its variance from the
    segment's own noise in each equation that shows the direction."""
    energy = {n: np.einsum("i,bij,j->b", d, g, d) for n, g in table.by_equation.items()}
    total = sum(float(e.sum()) for e in energy.values())
    score, information, spread = np.zeros((3, table.blocks))
    for name, gram in table.by_equation.items():
        h = energy[name]
        if h.sum() <= SEEN_SHARE * total:
            continue
        s = np.einsum("i,bij,bj->b", d, gram, z)
        power = np.einsum("bi,bij,bj->b", z, gram, z)
        power = power - np.divide(s**2, h, out=np.zeros_like(h), where=h > 0.0)
        count = int(2.0 * table.seconds * table.top_hz[name])
        score, information = score + s, information + h
        spread = spread + h * np.maximum(power, 0.0) / max(count - OWN, 1)
    there = (information > 0.0) & (spread > 0.0)
    x = score[there] / information[there]
    return x, spread[there] / information[there] ** 2


def _scatter(x: Array, variance: Array, may: float) -> tuple[float, float]:
    """Standard deviation between segments beyond their errors (DerSimonian and Laird 1986), and the
    chance of their scatter (Cochran 1954) if the true values scatter by `may`. One segment in
    fifteen must not decide."""
    far = (x - np.median(x)) ** 2 / (variance + may**2)
    kept = np.argsort(far)[: len(x) - one_in_fifteen(len(x))]
    x, variance = x[kept], variance[kept]
    w = 1.0 / variance
    excess = float(w @ (x - w @ x / w.sum()) ** 2) - (len(x) - 1)
    size = float(np.sqrt(max(excess, 0.0) / (w.sum() - w @ w / w.sum())))
    w = 1.0 / (variance + may**2)
    power = float(w @ (x - w @ x / w.sum()) ** 2)
    return size, float(chi2.sf(power, len(x) - 1))
