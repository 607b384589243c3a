"""Fits, held-out losses and intervals on a table of blocks. Knows no cause by name.

The null is a box: an honest model file is wrong by |x_j| <= tau_j. A Gaussian prior of that width
would be overrun by half an hour of data. A hypothesis frees its own parameters from the box.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from imucald.diagnosis.blocks import Table
from imucald.diagnosis.signals import Array, Mask

FOLDS = 8
ERROR_RATE = 0.01
"""Of a drive: the chance that anything is named without a reason."""
RIDGE = 1e-9
STEPS = 20
"""Changes of the active set, for each parameter."""
QUARTERS = 4
REACH = 3.0
"""A freed parameter may go so many times as far as is plausible: then it is told as such."""
SILENT = 1e-6
TINY = 1e-9
CLOSE = 1e-9
"""Of a slope that counts as none."""


@dataclass(frozen=True)
class Hypothesis:
    """Parameters that go wrong together, all along or by a pattern over the blocks."""

    name: str
    keys: tuple[str, ...]
    """What is told of; the parameters that are freed."""
    directions: tuple[Mapping[str, float], ...] = ()
    """For each key, what moves with it; empty: the keys by themselves."""
    lead: int = 0
    """How many of the first keys must leave their tolerance; 0: any."""
    pattern: Array | None = None
    """(B,) factor on the parameters in each block; None: everywhere."""

    @property
    def is_plain(self) -> bool:
        """Whether nothing but the keys is freed, everywhere."""
        return not self.directions and self.pattern is None


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


@dataclass(frozen=True)
class Problem:
    """A table with the parameters that are free already, and bounds from direct evidence."""

    table: Table
    low: Array
    high: Array

    @staticmethod
    def of(table: Table, free: Sequence[str], bounds: Mapping[str, tuple[float, float]]) -> Problem:
        """Box of the tolerances; free keys are bounded by three times what is plausible."""
        low, high = -table.tolerance.copy(), table.tolerance.copy()
        for key, (a, b) in bounds.items():
            if key in table.keys:
                i = table.keys.index(key)
                low[i], high[i] = a, b
        for key in free:
            i = table.keys.index(key)
            low[i], high[i] = REACH * table.plausible[i]
        return Problem(table, low, high)

    def model_error(self, h: Hypothesis) -> Array:
        """(k,) what the equations err by. What moves together errs as the best known of it; what
        moves in mid-drive is a difference, in which it drops out."""
        errors = self.table.model_error
        if h.pattern is not None:
            return np.zeros(len(h.keys))
        if h.directions:
            alike = [[k for k, x in d.items() if x == 1.0] for d in h.directions]
            return np.array([min(errors[self.table.index(keys)]) for keys in alike])
        return np.asarray(errors[self.table.index(h.keys)])

    def widened(self, h: Hypothesis | None) -> tuple[Array, Array, Array]:
        """Gram matrices (B, Q+1, Q+1) and bounds (Q,) with a hypothesis' parameters freed."""
        gram, low, high = self.table.gram, self.low, self.high
        if h is None:
            return gram, low, high
        index = self.table.index(h.keys)
        wide = REACH * self.table.plausible[index]
        low, high = low.copy(), high.copy()
        if h.is_plain:
            low[index], high[index] = wide.T
            return gram, low, high
        D = np.zeros((gram.shape[1], len(h.keys)))
        for k, key in enumerate(h.keys):
            for name, x in (h.directions[k] if h.directions else {key: 1.0}).items():
                D[self.table.keys.index(name) + 1, k] = x
        if h.directions:
            # The direction takes the place of its kin in the box.
            kin = {n for d in h.directions for n in d if _family(n) == _family(h.keys[0])}
            index = self.table.index(sorted(kin))
            silent = SILENT * (high - low)[index]
            low[index], high[index] = -silent, silent
        m = np.ones(len(gram)) if h.pattern is None else h.pattern
        cross = (gram @ D) * m[:, None, None]
        own = (D.T @ gram @ D) * (m * m)[:, None, None]
        gram = np.concatenate(
            [
                np.concatenate([gram, cross], axis=2),
                np.concatenate([np.swapaxes(cross, 1, 2), own], axis=2),
            ],
            axis=1,
        )
        return gram, np.concatenate([low, wide[:, 0]]), np.concatenate([high, wide[:, 1]])

    def own(self, h: Hypothesis) -> list[int]:
        """Places of a hypothesis' parameters in a widened problem."""
        if h.is_plain:
            return self.table.index(h.keys)
        return list(range(len(self.table.keys), len(self.table.keys) + len(h.keys)))


def _family(key: str) -> str:
    return key.rpartition(".")[0]


def box_fit(H: Array, c: Array, low: Array, high: Array, start: Array | None = None) -> Array:
    """Minimise x'Hx/2 - c'x within low <= x <= high: (Q,).

    Primal active set (Nocedal and Wright, ch. 16): to the first bound that a Newton step meets,
    and one bound let go at a time, the one that pulls most.
    """
    scale = 0.5 * (high - low)
    H = H * np.outer(scale, scale)
    H = H + np.diag(RIDGE * np.diag(H) + TINY)
    c, low, high = c * scale, low / scale, high / scale
    x = np.clip(np.zeros(len(c)) if start is None else start / scale, low, high)
    slope = H @ x - c
    held = ((x <= low) & (slope > 0.0)) | ((x >= high) & (slope < 0.0))
    for _ in range(STEPS * len(c)):
        step = _newton_step(H, H @ x - c, held)
        with np.errstate(divide="ignore", invalid="ignore"):
            room = np.where(step > 0.0, (high - x) / step, (low - x) / step)
        room[step == 0.0] = np.inf
        first = int(np.argmin(room))
        if room[first] < 1.0:
            x = np.clip(x + max(room[first], 0.0) * step, low, high)
            x[first] = high[first] if step[first] > 0.0 else low[first]
            held[first] = True
            continue
        x = np.clip(x + step, low, high)
        slope = H @ x - c
        pull = np.where(x >= high, slope, -slope) * held
        worst = int(np.argmax(pull))
        if pull[worst] <= CLOSE * (1.0 + abs(c[worst])):
            break
        held[worst] = False
    return np.asarray(x * scale)


def _newton_step(H: Array, slope: Array, held: Mask) -> Array:
    step = np.zeros(len(slope))
    free = np.flatnonzero(~held)
    if len(free):
        step[free] = -_solved(H[np.ix_(free, free)], slope[free])
    return step


def _solved(A: Array, b: Array) -> Array:
    try:
        return np.asarray(np.linalg.solve(A, b))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.lstsq(A, b, rcond=None)[0])


def folds(blocks: int) -> Array:
    """(B,) fold of each block: contiguous stretches."""
    return np.asarray(np.arange(blocks) * min(FOLDS, blocks) // blocks)


def losses(gram: Array, x: Array) -> Array:
    """(B,) half the squared whitened residual of each block."""
    z = np.concatenate([[1.0], -x])
    return np.asarray(0.5 * np.einsum("i,bij,j->b", z, gram, z))


def held_out(problem: Problem, h: Hypothesis | None = None) -> Array:
    """(B,) loss of each block by a fit that did not see its fold."""
    gram, low, high = problem.widened(h)
    total = gram.sum(axis=0)
    fold = folds(len(gram))
    whole = box_fit(total[1:, 1:], total[1:, 0], low, high)
    lost = np.empty(len(gram))
    for k in range(int(fold.max()) + 1):
        out = fold == k
        rest = total - gram[out].sum(axis=0)
        x = box_fit(rest[1:, 1:], rest[1:, 0], low, high, whole)
        lost[out] = losses(gram[out], x)
    return lost


def fitted(problem: Problem, h: Hypothesis | None = None) -> Array:
    """(Q,) parameters, those of a patterned hypothesis last."""
    gram, low, high = problem.widened(h)
    total = gram.sum(axis=0)
    return box_fit(total[1:, 1:], total[1:, 0], low, high)


def quantile(blocks: int, questions: int) -> float:
    """Student's t for two sides, shared out over the questions asked (Bonferroni)."""
    return float(student.ppf(1.0 - ERROR_RATE / (2.0 * max(questions, 1)), max(blocks - 1, 1)))


def estimate(
    problem: Problem, h: Hypothesis, questions: int, null: Problem | None = None
) -> Estimate:
    """Value and deviation of a hypothesis' parameters, the others free within their box.

    null: the same with the box of honest files, where the model has moved out of it already.
    """
    gram, low, high = problem.widened(h)
    own = problem.own(h)
    total = gram.sum(axis=0)
    x = box_fit(total[1:, 1:], total[1:, 0], low, high)
    # What is bounded by a box is as uncertain as an even spread over it.
    prior = np.zeros(len(low))
    others = np.setdiff1d(np.arange(len(low)), own)
    prior[others] = 3.0 / np.maximum(0.5 * (high - low)[others], 1e-30) ** 2
    H = total[1:, 1:] + np.diag(prior) + RIDGE * np.diag(np.maximum(np.diag(total[1:, 1:]), 1e-30))
    inverse = np.linalg.pinv(H)
    score = gram[:, 1:, 0] - gram[:, 1:, 1:] @ x
    B = len(gram)
    inner = score.T @ score * (B / max(B - len(own) - 1, 1))
    lag = score[1:].T @ score[:-1]
    ways = (inner, inner + lag + lag.T, total[1:, 1:])
    spread = [np.diag(inverse @ (way + np.diag(prior)) @ inverse)[own] for way in ways]
    se = np.sqrt(np.maximum(np.max(spread, axis=0), 0.0))
    wander, share = _wander(gram, prior, x, own)
    more = wander**2 * share + problem.model_error(h) ** 2
    se = np.sqrt(se**2 + more)
    pull = _pull(problem, h, x, own, more, null or problem)
    return Estimate(x[own], se, quantile(B, questions), pull, wander)


def _pull(
    problem: Problem, h: Hypothesis, x: Array, own: Sequence[int], more: Array, null_of: Problem
) -> float:
    """Profile likelihood with the others in their box, so that none counts beyond its tolerance.

    The rise of the loss is divided by how much the blocks scatter more than the weights say
    (sandwich over model-based variance), and by `more` (k,), the variances between quarters and of
    the equations themselves.
    """
    gram, low, high = problem.widened(h)
    total = gram.sum(axis=0)
    H, c = total[1:, 1:], total[1:, 0]
    base = problem.table.gram.sum(axis=0)
    null = box_fit(base[1:, 1:], base[1:, 0], null_of.low, null_of.high)
    rise = (c @ x - 0.5 * x @ H @ x) - (base[1:, 0] @ null - 0.5 * null @ base[1:, 1:] @ null)
    width = high - low
    inside = np.flatnonzero((x > low + 1e-6 * width) & (x < high - 1e-6 * width))
    inside = np.union1d(inside, own)
    at = [int(np.flatnonzero(inside == i)[0]) for i in own]
    part = H[np.ix_(inside, inside)]
    part = part + RIDGE * np.diag(np.maximum(np.diag(part), 1e-30))
    inverse = np.linalg.pinv(part)
    score = (gram[:, 1:, 0] - gram[:, 1:, 1:] @ x)[:, inside]
    B = len(gram)
    inner = score.T @ score * (B / max(B - len(own) - 1, 1))
    lag = score[1:].T @ score[:-1]
    model = np.maximum(np.diag(inverse)[at], 1e-300)
    ways = [np.diag(inverse @ way @ inverse)[at] for way in (inner, inner + lag + lag.T)]
    spread = max(1.0, float(np.max((np.max(ways, axis=0) + more) / model)))
    # k parameters at once rise by k more without a reason.
    return float(np.sqrt(max(2.0 * rise / spread - (len(own) - 1), 0.0)))


def _wander(gram: Array, prior: Array, x: Array, own: Sequence[int]) -> tuple[Array, Array]:
    """Scatter of the parameters between quarters of the data beyond what each may scatter, and
    which share of its square the mean keeps: random effects (DerSimonian and Laird 1986)."""
    parts = np.array_split(np.arange(len(gram)), QUARTERS)
    values, variances = [], []
    for part in parts:
        if len(part) < 2:
            return np.zeros(len(own)), np.ones(len(own))
        total = gram[part].sum(axis=0)
        H = total[1:, 1:] + np.diag(prior)
        H += RIDGE * np.diag(np.maximum(np.diag(H), 1e-30))
        inverse = np.linalg.pinv(H)
        step = inverse @ (total[1:, 0] - total[1:, 1:] @ x)
        score = gram[part][:, 1:, 0] - gram[part][:, 1:, 1:] @ (x + step)
        inner = np.maximum(np.diag(inverse @ (score.T @ score) @ inverse), np.diag(inverse))
        values.append(step[list(own)])
        variances.append(inner[list(own)])
    w = 1.0 / np.maximum(np.array(variances), 1e-30)
    total_w = w.sum(axis=0)
    mean = (w * values).sum(axis=0) / total_w
    excess = (w * (np.array(values) - mean) ** 2).sum(axis=0) - (len(parts) - 1)
    spare = total_w - (w**2).sum(axis=0) / total_w
    variance = np.maximum(excess, 0.0) / np.maximum(spare, 1e-30)
    variance[spare <= 1e-9 * total_w] = 0.0
    return np.sqrt(variance), np.asarray((w**2).sum(axis=0) / total_w**2)


def without_best(gain: Array, one_in: int = 15) -> float:
    """Sum over blocks without the best one of so many: one block must not decide."""
    drop = max(1, round(len(gain) / one_in))
    return float(np.sort(gain)[: len(gain) - drop].sum())


def paired(first: Array, second: Array) -> tuple[float, float]:
    """Difference of two losses, summed over blocks, and its standard error."""
    d = first - second
    return float(d.sum()), float(np.sqrt(len(d)) * np.std(d, ddof=1)) if len(d) > 1 else np.inf
