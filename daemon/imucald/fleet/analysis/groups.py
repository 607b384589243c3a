"""Compare the vehicles of a group (a sensor batch or a firmware) with the other vehicles of the
same types."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control

from imucald.core.arrays import Array, Flags, Index
from imucald.fleet.analysis.units import MAX_Q, Units, sums_by, t_quantile, t_weights

Codes = Mapping[str, tuple[list[str], Index]]
"""For each column: the names of the groups, and the group index of each vehicle (-1: not known)."""

LEAST_GROUP = 5
"""Smallest number of vehicles of a group that is tested."""


@dataclass(frozen=True)
class GroupEffect:
    """Difference between the vehicles of a group and the other vehicles of the same types: effect
    and half width of its 95 % interval (3,) [deg]. p and q are NaN if there are too few
    vehicles."""

    column: str
    name: str
    vehicles: int
    kinds: int
    effect: Array
    half_width: Array
    p: float
    q: float = float("nan")
    found: bool = False


def group_codes(values: Sequence[str | None]) -> tuple[list[str], Index]:
    """Return the names of the groups, and the group index of each vehicle (-1: not known)."""
    names = sorted({v for v in values if v is not None})
    index = {name: i for i, name in enumerate(names)}
    return names, np.array([-1 if v is None else index[v] for v in values], dtype=np.int64)


def group_effects(units: Units, e: Array, T: Array, codes: Codes) -> list[GroupEffect]:
    """Return the effects of all groups. Vehicles in groups with a found effect are not used as
    reference for other groups."""
    wide = T[units.kind] + units.v
    w = t_weights(e, wide)[:, None] / wide
    left_out = np.zeros(len(units), dtype=bool)
    found: dict[tuple[str, str], GroupEffect] = {}
    while True:
        sums = np.concatenate([w, w * e, w * w * wide, np.ones((len(units), 1))], axis=1)
        effects = [
            found.get((column, effect.name), effect)
            for column, (names, index) in codes.items()
            for effect in _effects(units, sums, ~left_out, column, names, index)
        ]
        effects = _with_q(effects)
        fresh = [g for g in effects if g.found and (g.column, g.name) not in found]
        if not fresh:
            return effects
        best = min(fresh, key=lambda g: g.p)
        found[best.column, best.name] = best
        names, index = codes[best.column]
        left_out |= index == names.index(best.name)


def _effects(
    units: Units, sums: Array, used: Flags, column: str, names: Sequence[str], index: Index
) -> list[GroupEffect]:
    """Compare each group with the other vehicles of the same types. The differences within each
    type are combined.

    sums: (n, 10), for each vehicle the weights, the products of weights and e, the variances of
    these products, and 1.
    """
    vehicles = np.bincount(index[index >= 0], minlength=len(names))
    mine = used & (index >= 0)
    pairs, pair = np.unique(index[mine] * units.kinds + units.kind[mine], return_inverse=True)
    inside = sums_by(sums[mine], pair, len(pairs))
    group, kind = np.divmod(pairs, units.kinds)
    outside = sums_by(sums[used], units.kind[used], units.kinds)[kind] - inside
    # if a whole type belongs to this batch, the two cannot be separated
    beside = outside[:, 9] > 0.5
    inside, outside, group = inside[beside], outside[beside], group[beside]
    (mean, variance), (of_others, their_variance) = _mean(inside), _mean(outside)
    precision = 1.0 / (variance + their_variance)
    total = sums_by(precision, group, len(names))
    weighted = sums_by(precision * (mean - of_others), group, len(names))
    kinds = np.bincount(group, minlength=len(names))
    freedom = np.bincount(group, inside[:, 9] + outside[:, 9] - 2.0, len(names))
    found = []
    for i, name in enumerate(names):
        judged = vehicles[i] >= LEAST_GROUP and kinds[i] > 0
        effect = weighted[i] / total[i] if judged else np.full(3, np.nan)
        half = t_quantile(freedom[i]) / np.sqrt(total[i]) if judged else np.full(3, np.nan)
        # the scale of the three normal variables was estimated with `freedom` degrees of freedom
        square = float((effect**2 * total[i]).sum()) / 3.0
        p = float(f_distribution.sf(square, 3, max(freedom[i], 1))) if judged else float("nan")
        found.append(GroupEffect(column, name, int(vehicles[i]), int(kinds[i]), effect, half, p))
    return found


def _mean(sums: Array) -> tuple[Array, Array]:
    """Return robust weighted means (n, 3) and their variances (n, 3)."""
    weight = sums[:, 0:3]
    return sums[:, 3:6] / weight, sums[:, 6:9] / weight**2


def _with_q(effects: Sequence[GroupEffect]) -> list[GroupEffect]:
    judged = [g for g in effects if np.isfinite(g.p)]
    if not judged:
        return list(effects)
    q = dict(zip(map(id, judged), false_discovery_control([g.p for g in judged]), strict=True))
    return [
        replace(g, q=float(q.get(id(g), np.nan)), found=g.found or q.get(id(g), 1.0) <= MAX_Q)
        for g in effects
    ]


def group_offsets(units: Units, effects: Sequence[GroupEffect], codes: Codes) -> Array:
    """Return the rotation vectors (n, 3) [deg] by which the found group effects rotate the mount of
    each vehicle."""
    offset = np.zeros((len(units), 3))
    for g in effects:
        if g.found:
            names, index = codes[g.column]
            offset[index == names.index(g.name)] += g.effect
    return offset
