"""Fits and held-out losses on a table of blocks. Nothing here depends on a cause's name.

The null hypothesis is a box: a correct model file is wrong by |x_j| <= tau_j. Half an hour of data
would outweigh a Gaussian prior of that width. A hypothesis frees its own parameters from the box.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.causes import family
from imucald.diagnosis.fit.blocks import NDArrayInt, Table
from imucald.diagnosis.fit.box import box_fit

FOLDS = 8
REACH = 3.0
"""A freed parameter may reach this multiple of the plausible limit; then it is reported as
implausible."""
SILENT = 1e-6


@dataclass(frozen=True)
class Hypothesis:
    """Parameters that are wrong together, in the whole drive or by a pattern over the blocks."""

    name: str
    keys: tuple[str, ...]
    """The freed parameters, which are reported."""
    directions: tuple[Mapping[str, float], ...] = ()
    """For each key, the parameters that move with it and their factors; empty: the keys alone."""
    lead: int = 0
    """Number of leading keys of which at least one must leave its tolerance; 0: any key is
    enough."""
    pattern: Array | None = None
    """(B,) factor on the parameters in each block; None: everywhere."""
    error: float | None = None
    """Error of the equations in this hypothesis; None: the error of its best known parameter."""

    @property
    def moved(self) -> set[str]:
        """The keys and all parameters that move with them."""
        return {k for d in self.directions for k in d} or set(self.keys)

    @property
    def is_plain(self) -> bool:
        """True if only the keys are freed, in all blocks."""
        return not self.directions and self.pattern is None


@dataclass(frozen=True)
class Problem:
    """A table with the parameters that are free already, and bounds from direct evidence."""

    table: Table
    low: Array
    high: Array

    @staticmethod
    def from_table(
        table: Table, free: Sequence[str], bounds: Mapping[str, tuple[float, float]]
    ) -> Problem:
        """Problem with the box of tolerances; free keys are bounded by three times the plausible
        limits."""
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
        """(k,) error of the equations. Parameters that move together have the error of the best
        known one. For a change in mid-drive it is zero, because it cancels in the difference."""
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
        # Only the last result is kept: it is asked for a few times in a row.
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
        """Changes of the model file by the fit within all bounds: key to value, without zeros."""
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
            # The direction replaces the related parameters in the box.
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
        """Indices of a hypothesis' parameters in a widened problem."""
        if h.is_plain:
            return self.table.index(h.keys)
        return list(range(len(self.table.keys), len(self.table.keys) + len(h.keys)))

    def moves(self, h: Hypothesis, only: Sequence[str] = ()) -> dict[str, float]:
        """Departures of a hypothesis' own parameters and of those that move with them. only: the
        parameters to move; the others are fitted within their tolerance and not moved."""
        if only:
            h = replace(h, keys=tuple(only))
        x, own = self.fit(h), self.own(h)
        made: dict[str, float] = {}
        for k, key in enumerate(h.keys):
            for name, factor in (h.directions[k] if h.directions else {key: 1.0}).items():
                made[name] = made.get(name, 0.0) + factor * float(x[own[k]])
        return made


def folds(blocks: int) -> Array:
    """(B,) fold of each block: contiguous segments."""
    return np.asarray(np.arange(blocks) * min(FOLDS, blocks) // blocks)


def losses(gram: Array, x: Array) -> Array:
    """(B,) half the squared whitened residual of each block."""
    z = np.concatenate([[1.0], -x])
    return np.asarray(0.5 * (gram @ z @ z))


def held_out(problem: Problem, h: Hypothesis | None = None) -> Array:
    """(B,) loss of each block, with a fit that did not use its fold."""
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
    """(B, P+1) coefficients that turn each segment's rows into its residual, after a fit of all
    parameters in their box. drift: a named drift, which has no place in the model file; it is
    fitted too."""
    table, x = problem.table, problem.fit(drift)
    own = len(table.keys)
    z = np.tile(np.concatenate([[1.0], -x[:own]]), (table.blocks, 1))
    if drift is not None and drift.pattern is not None:
        for key, slope in zip(drift.keys, x[own:], strict=True):
            z[:, table.keys.index(key) + 1] -= slope * drift.pattern
    return z


def one_in_fifteen(blocks: int) -> int:
    """Return the number of blocks that must not decide a question alone: one in fifteen, at least
    one."""
    return max(1, round(blocks / 15))


def without_best(gain: Array) -> float:
    """Sum over blocks without the best one in fifteen."""
    return float(np.sort(gain)[: len(gain) - one_in_fifteen(len(gain))].sum())


def paired(first: Array, second: Array, own: NDArrayInt, other: NDArrayInt) -> tuple[float, float]:
    """Difference of two losses (B,) and (C,), summed over blocks, and its standard error.

    own, other: indices of their blocks (`Table.number`). A table leaves out blocks without
    information, and these may differ between models, for example with another delay. Therefore only
    blocks that both tables have are compared.
    """
    if not np.array_equal(own, other):
        _, one, two = np.intersect1d(own, other, assume_unique=True, return_indices=True)
        first, second = first[one], second[two]
    d = first - second
    return float(d.sum()), float(np.sqrt(len(d)) * np.std(d, ddof=1)) if len(d) > 1 else np.inf
