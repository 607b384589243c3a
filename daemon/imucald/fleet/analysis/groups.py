"""Batches and firmware: vehicles of a group beside the other vehicles of their types."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control

from imucald.fleet.analysis.units import MAX_Q, Units, t_quantile, t_weights

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]
Codes = Mapping[str, tuple[list[str], Index]]
"""By column the names of its groups, and the index of each vehicle's (-1: not known)."""

LEAST_GROUP = 5
"""A batch with fewer vehicles is not judged."""


@dataclass(frozen=True)
class GroupEffect:
    """How vehicles of a batch sit beside others of their types. p, q are NaN with too few."""

    column: str
    name: str
    vehicles: int
    kinds: int
    effect: Array
    covariance: Array
    p: float
    freedom: float
    q: float = float("nan")
    found: bool = False

    @property
    def half_width(self) -> Array:
        """Half of the 95 % interval (3,) [deg]."""
        return t_quantile(self.freedom) * np.sqrt(np.diagonal(self.covariance))


def group_codes(values: Sequence[str | None]) -> tuple[list[str], Index]:
    """Names of the groups, and the index of each vehicle's (-1: not known)."""
    names = sorted({v for v in values if v is not None})
    index = {name: i for i, name in enumerate(names)}
    return names, np.array([-1 if v is None else index[v] for v in values], dtype=np.int64)


def group_effects(units: Units, e: Array, T: Array, codes: Codes) -> list[GroupEffect]:
    """Effects of all groups; those found are left out of what the others are compared with."""
    wide = T[units.kind] + units.v
    w = t_weights(e, wide)
    left_out = np.zeros(len(units), dtype=bool)
    found: dict[tuple[str, str], GroupEffect] = {}
    while True:
        effects = [
            found.get((column, name))
            or _effect(units, e, wide, w, left_out, column, name, index == i)
            for column, (names, index) in codes.items()
            for i, name in enumerate(names)
        ]
        effects = _with_q(effects)
        fresh = [g for g in effects if g.found and (g.column, g.name) not in found]
        if not fresh:
            return effects
        best = min(fresh, key=lambda g: g.p)
        found[best.column, best.name] = best
        names, index = codes[best.column]
        left_out |= index == names.index(best.name)
        w = np.where(index == names.index(best.name), 1.0, w)


def _effect(
    units: Units,
    e: Array,
    wide: Array,
    w: Array,
    left_out: Flags,
    column: str,
    name: str,
    mine: Flags,
) -> GroupEffect:
    """One group beside the other vehicles of its types: contrasts by type, put together."""
    vehicles = int(mine.sum())
    inside, outside = mine & ~left_out, ~mine & ~left_out
    total, weighted, kinds, freedom = np.zeros(3), np.zeros(3), 0, 0
    for k in np.unique(units.kind[inside]):
        a, b = inside & (units.kind == k), outside & (units.kind == k)
        if not b.any():
            continue  # the whole type is of this batch: the two cannot be told apart
        (mean_a, var_a), (mean_b, var_b) = (_mean(e[s], wide[s], w[s]) for s in (a, b))
        precision = 1.0 / (var_a + var_b)
        total += precision
        weighted += precision * (mean_a - mean_b)
        kinds += 1
        freedom += int(a.sum() + b.sum()) - 2
    nan = float("nan")
    if vehicles < LEAST_GROUP or kinds == 0:
        return GroupEffect(
            column, name, vehicles, kinds, np.full(3, nan), np.full((3, 3), nan), nan, 0
        )
    effect, covariance = weighted / total, np.diag(1.0 / total)
    square = float((effect**2 * total).sum())
    p = _p_of(square, freedom)
    return GroupEffect(column, name, vehicles, kinds, effect, covariance, p, freedom)


def _mean(e: Array, wide: Array, w: Array) -> tuple[Array, Array]:
    """Robust weighted mean (3,) and its variance (3,)."""
    weight = w[:, None] / wide
    total = weight.sum(axis=0)
    return (weight * e).sum(axis=0) / total, (weight**2 * wide).sum(axis=0) / total**2


def _p_of(square: float | Array, freedom: float) -> float:
    """Chance of so large a square of three normal variables whose scale was learnt from data."""
    return float(f_distribution.sf(square / 3.0, 3, max(freedom, 1)))


def _with_q(effects: Sequence[GroupEffect]) -> list[GroupEffect]:
    judged = [g for g in effects if np.isfinite(g.p)]
    if not judged:
        return list(effects)
    q = dict(zip(map(id, judged), false_discovery_control([g.p for g in judged]), strict=True))
    return [_judged(g, float(q.get(id(g), np.nan))) for g in effects]


def _judged(g: GroupEffect, q: float) -> GroupEffect:
    return replace(g, q=q, found=g.found or q <= MAX_Q)


def group_offsets(units: Units, effects: Sequence[GroupEffect], codes: Codes) -> Array:
    """What found groups turn each of their vehicles by (n, 3) [deg]."""
    offset = np.zeros((len(units), 3))
    for g in effects:
        if g.found:
            names, index = codes[g.column]
            offset[index == names.index(g.name)] += g.effect
    return offset
