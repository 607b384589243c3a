"""Fits and held-out losses on a table of blocks. No function in this module depends on the name of
a cause.

The null hypothesis is a box: the errors of a correct model file are |x_j| <= tau_j. A Gaussian
prior of this width would have no effect against half an hour of data. A hypothesis frees its own
parameters from the box.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from imucald.core.arrays import Array, Index
from imucald.diagnosis.causes import family
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.box import box_fit
from imucald.diagnosis.signals import Mask

FOLDS = 8
REACH = 3.0
"""Multiple of the plausible limit up to which a freed parameter is fitted. A parameter beyond the
plausible limit is reported as implausible."""


@dataclass(frozen=True)
class Hypothesis:
    """Parameters that are wrong together, in the whole drive or with a pattern over the blocks."""

    name: str
    keys: tuple[str, ...]
    """The freed parameters. They are reported."""
    directions: tuple[Mapping[str, float], ...] = ()
    """For each key, the parameters that change with it and their factors; empty: only the keys
    change (`along`)."""
    lead: int = 0
    """Number of first keys of which at least one must leave its tolerance; 0: any key is enough."""
    pattern: Array | None = None
    """Factor (B,) on the parameters in each block; None: 1 in all blocks."""
    error: float | None = None
    """Error of the equations in this hypothesis; None: the smallest error among its parameters."""

    @property
    def along(self) -> tuple[Mapping[str, float], ...]:
        """For each key, all parameters that change with it, and their factors."""
        return self.directions or tuple({key: 1.0} for key in self.keys)

    @property
    def moved(self) -> set[str]:
        """The keys and all parameters that change with them."""
        return {k for d in self.along for k in d}

    @property
    def is_plain(self) -> bool:
        """True if only the keys are freed, in all blocks."""
        return not self.directions and self.pattern is None


@dataclass(frozen=True)
class Problem:
    """A table, the box of its parameters, and bounds from direct evidence."""

    table: Table
    low: Array
    high: Array

    @staticmethod
    def from_table(
        table: Table, free: Sequence[str], bounds: Mapping[str, tuple[float, float]]
    ) -> Problem:
        """Return the problem with the box of tolerances. Free keys have bounds of three times the
        plausible limits."""
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
        """Return the error of the equations (k,). Parameters that change together have the smallest
        of their errors. For a change in the middle of a drive, the error is zero, because it
        cancels in the difference."""
        errors = self.table.model_error
        if h.pattern is not None:
            return np.zeros(len(h.keys))
        if h.error is not None:
            return np.full(len(h.keys), h.error)
        together = [[k for k, x in d.items() if x == 1.0] for d in h.along]
        return np.array([min(errors[self.table.index(keys)]) for keys in together])

    def widened(self, h: Hypothesis | None) -> tuple[Array, Array, Array]:
        """Return Gram matrices (B, Q+1, Q+1) and bounds (Q,) with a hypothesis's parameters
        freed."""
        return (self.table.gram, self.low, self.high) if h is None else self._freed(h)[0]

    def fit(self, h: Hypothesis | None = None) -> Array:
        """Return all fitted parameters (Q,) within their bounds. Parameters of a hypothesis with a
        pattern are last."""
        return self._whole if h is None else self._freed(h)[1]

    def fitted_changes(self) -> dict[str, float]:
        """Return the changes of the model file from the fit within all bounds: key to value,
        without zeros."""
        return {k: float(v) for k, v in zip(self.table.keys, self.fit(), strict=True) if v}

    @cached_property
    def _whole(self) -> Array:
        return fitted(*self.widened(None))

    @cached_property
    def _last(self) -> list[tuple[Hypothesis, tuple[Array, Array, Array], Array]]:
        return []

    def _freed(self, h: Hypothesis) -> tuple[tuple[Array, Array, Array], Array]:
        # Only the last result is kept: it is asked for a few times in a row.
        if not self._last or self._last[0][0] is not h:
            made = self._widened(h)
            self._last[:] = [(h, made, fitted(*made))]
        return self._last[0][1:]

    def _widened(self, h: Hypothesis) -> tuple[Array, Array, Array]:
        gram, low, high = self.table.gram, self.low, self.high
        index = self.table.index(h.keys)
        wide = REACH * self.table.plausible[index]
        low, high = low.copy(), high.copy()
        if h.is_plain:
            low[index], high[index] = wide.T
            return gram, low, high
        D = np.stack([self.table.direction(along) for along in h.along], axis=1)
        if h.directions:
            # The direction replaces the related parameters in the box.
            kin = {n for d in h.directions for n in d if family(n) == family(h.keys[0])}
            index = self.table.index(sorted(kin))
            silent = 1e-6 * (high - low)[index]
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
        """Return the indices of a hypothesis's parameters in the widened problem."""
        if h.is_plain:
            return self.table.index(h.keys)
        return list(range(len(self.table.keys), len(self.table.keys) + len(h.keys)))

    def moves(self, h: Hypothesis, only: Sequence[str] = ()) -> dict[str, float]:
        """Return the fitted differences of a hypothesis's parameters, and of the parameters that
        change with them. only: parameters to return; the other parameters are fitted within their
        tolerance and not returned."""
        if only:
            h = replace(h, keys=tuple(only))
        x, own = self.fit(h), self.own(h)
        made: dict[str, float] = {}
        for k, direction in enumerate(h.along):
            for name, factor in direction.items():
                made[name] = made.get(name, 0.0) + factor * float(x[own[k]])
        return made


def folds(blocks: int) -> Iterator[Mask]:
    """Yield flags (B,) of the blocks of each fold. A fold is a contiguous segment."""
    fold = np.arange(blocks) * min(FOLDS, blocks) // blocks
    return (fold == k for k in range(int(fold.max()) + 1))


def losses(gram: Array, x: Array) -> Array:
    """Return half of the squared residual of each block (B,). x: (Q,) parameters, or (B, Q) of each
    block."""
    z = np.insert(-np.atleast_2d(x), 0, 1.0, axis=1)
    return np.asarray(0.5 * np.sum((gram @ z[:, :, None])[:, :, 0] * z, axis=1))


def explained(gram: Array, x: Array) -> float:
    """Return the nats by which parameters x (Q,) reduce the loss of all blocks (B, Q+1, Q+1)."""
    total = gram.sum(axis=0)
    return float(total[1:, 0] @ x - 0.5 * x @ total[1:, 1:] @ x)


def fitted(gram: Array, low: Array, high: Array) -> Array:
    """Return the parameters (Q,) that fit the blocks (B, Q+1, Q+1) within bounds."""
    total = gram.sum(axis=0)
    return box_fit(total[1:, 1:], total[1:, 0], low, high)


def fitted_by_fold(problem: Problem, h: Hypothesis | None = None) -> Array:
    """Return parameters (B, Q). The values of each block come from a fit that did not use the fold
    of the block."""
    gram, low, high = problem.widened(h)
    total, whole = gram.sum(axis=0), problem.fit(h)
    made = np.empty((len(gram), len(low)))
    for out in folds(len(gram)):
        rest = total - gram[out].sum(axis=0)
        made[out] = box_fit(rest[1:, 1:], rest[1:, 0], low, high, whole)
    return made


def held_out(problem: Problem, h: Hypothesis | None = None) -> Array:
    """Return the loss (B,) of each block, from a fit that did not use the fold of the block."""
    return losses(problem.widened(h)[0], fitted_by_fold(problem, h))


def one_in_fifteen(blocks: int) -> int:
    """Return the number of blocks that must not decide a test alone: one in fifteen, at least
    one."""
    return max(1, round(blocks / 15))


def without_best(gain: Array) -> float:
    """Return the sum over blocks without the best blocks, one in fifteen."""
    return float(np.sort(gain)[: len(gain) - one_in_fifteen(len(gain))].sum())


def paired(first: Array, second: Array, own: Index, other: Index) -> tuple[float, float]:
    """Return the difference of two losses (B,) and (C,), summed over blocks, and its standard
    error.

    own, other: indices of the blocks (`Table.number`). A table leaves out blocks without
    information. The blocks left out may differ between two models, for example with another delay.
    Therefore only blocks in both tables are compared.
    """
    if not np.array_equal(own, other):
        _, one, two = np.intersect1d(own, other, assume_unique=True, return_indices=True)
        first, second = first[one], second[two]
    return sum_and_se(first - second)


def sum_and_se(x: Array) -> tuple[float, float]:
    """Return the sum over blocks of x (B,), and the standard error of this sum."""
    return float(x.sum()), float(np.sqrt(len(x)) * np.std(x, ddof=1)) if len(x) > 1 else np.inf
