"""Fits and held-out losses on a table of blocks. Knows no cause by name.

The null is a box: a correct model file is wrong by |x_j| <= tau_j. A Gaussian prior of that width
would be overrun by half an hour of data. A hypothesis frees its own parameters from the box.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.causes import family
from imucald.diagnosis.fit.blocks import NDArrayInt, Table
from imucald.diagnosis.fit.box import box_fit

FOLDS = 8
REACH = 3.0
"""A freed parameter may go so many times as far as is plausible: then it is reported as such."""
SILENT = 1e-6


@dataclass(frozen=True)
class Hypothesis:
    """Parameters that go wrong together, all along or by a pattern over the blocks."""

    name: str
    keys: tuple[str, ...]
    """What is reported; the parameters that are freed."""
    directions: tuple[Mapping[str, float], ...] = ()
    """For each key, what moves with it; empty: the keys by themselves."""
    lead: int = 0
    """How many of the first keys must leave their tolerance; 0: any."""
    pattern: Array | None = None
    """(B,) factor on the parameters in each block; None: everywhere."""
    error: float | None = None
    """What the equations err by in it; None: as in the best known of its parameters."""

    @property
    def moved(self) -> set[str]:
        """The keys with what moves with them."""
        return {k for d in self.directions for k in d} or set(self.keys)

    @property
    def is_plain(self) -> bool:
        """Whether nothing but the keys is freed, everywhere."""
        return not self.directions and self.pattern is None


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
        if h.error is not None:
            return np.full(len(h.keys), h.error)
        if h.directions:
            together = [[k for k, x in d.items() if x == 1.0] for d in h.directions]
            return np.array([min(errors[self.table.index(keys)]) for keys in together])
        return np.asarray(errors[self.table.index(h.keys)])

    def widened(self, h: Hypothesis | None) -> tuple[Array, Array, Array]:
        """Gram matrices (B, Q+1, Q+1) and bounds (Q,) with a hypothesis' parameters freed."""
        if h is None:
            return self.table.gram, self.low, self.high
        for known, made in self._asked:
            if known is h:
                return made
        # The last one alone: it is asked of a few times in a row.
        self._asked[:] = [(h, self._widened(h))]
        return self._asked[0][1]

    def fit(self, h: Hypothesis | None = None) -> Array:
        """(Q,) all parameters within their bounds; those of a patterned hypothesis last."""
        gram, low, high = self.widened(h)
        if h is None:
            return self._whole
        for known, x in self._fitted:
            if known is h:
                return x
        total = gram.sum(axis=0)
        x = box_fit(total[1:, 1:], total[1:, 0], low, high)
        self._fitted[:] = [(h, x)]
        return x

    def fitted_changes(self) -> dict[str, float]:
        """What the fit within all bounds makes of the model file: key to value, without zeros."""
        return {k: float(v) for k, v in zip(self.table.keys, self.fit(), strict=True) if v}

    @cached_property
    def _whole(self) -> Array:
        total = self.table.gram.sum(axis=0)
        return box_fit(total[1:, 1:], total[1:, 0], self.low, self.high)

    @cached_property
    def _asked(self) -> list[tuple[Hypothesis, tuple[Array, Array, Array]]]:
        return []

    @cached_property
    def _fitted(self) -> list[tuple[Hypothesis, Array]]:
        return []

    def _widened(self, h: Hypothesis) -> tuple[Array, Array, Array]:
        gram, low, high = self.table.gram, self.low, self.high
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
            kin = {n for d in h.directions for n in d if family(n) == family(h.keys[0])}
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


def folds(blocks: int) -> Array:
    """(B,) fold of each block: contiguous segments."""
    return np.asarray(np.arange(blocks) * min(FOLDS, blocks) // blocks)


def losses(gram: Array, x: Array) -> Array:
    """(B,) half the squared whitened residual of each block."""
    z = np.concatenate([[1.0], -x])
    return np.asarray(0.5 * (gram @ z @ z))


def held_out(problem: Problem, h: Hypothesis | None = None) -> Array:
    """(B,) loss of each block by a fit that did not see its fold."""
    gram, low, high = problem.widened(h)
    total = gram.sum(axis=0)
    fold = folds(len(gram))
    whole = problem.fit(h)
    lost = np.empty(len(gram))
    for k in range(int(fold.max()) + 1):
        out = fold == k
        rest = total - gram[out].sum(axis=0)
        x = box_fit(rest[1:, 1:], rest[1:, 0], low, high, whole)
        lost[out] = losses(gram[out], x)
    return lost


def what_leaves(problem: Problem, drift: Hypothesis | None) -> Array:
    """(B, P+1) what makes of each segment's rows what is left of them, everything fitted in its
    box. drift: of what was named and has no place in the model file; it is fitted beside."""
    table, x = problem.table, problem.fit(drift)
    own = len(table.keys)
    z = np.tile(np.concatenate([[1.0], -x[:own]]), (table.blocks, 1))
    if drift is not None and drift.pattern is not None:
        for key, slope in zip(drift.keys, x[own:], strict=True):
            z[:, table.keys.index(key) + 1] -= slope * drift.pattern
    return z


def one_in_fifteen(blocks: int) -> int:
    """So many of these blocks must not decide; of few, one."""
    return max(1, round(blocks / 15))


def without_best(gain: Array) -> float:
    """Sum over blocks without the best one in fifteen."""
    return float(np.sort(gain)[: len(gain) - one_in_fifteen(len(gain))].sum())


def paired(first: Array, second: Array, own: NDArrayInt, other: NDArrayInt) -> tuple[float, float]:
    """Difference of two losses (B,), (C,), summed over blocks, and its standard error.

    own, other: their numbers of blocks (`Table.number`). A table has no blocks that say nothing,
    and another model, as another delay, may leave others, be they as many: those that both have
    are compared.
    """
    if not np.array_equal(own, other):
        _, one, two = np.intersect1d(own, other, assume_unique=True, return_indices=True)
        first, second = first[one], second[two]
    d = first - second
    return float(d.sum()), float(np.sqrt(len(d)) * np.std(d, ddof=1)) if len(d) > 1 else np.inf
