"""Types of vehicles: their mount, how far vehicles differ, which vehicle or batch stands out.

Rotation vectors about the type's mount, in the vehicle's axes [deg]. One vehicle counts once, by
its first segment: as it was delivered. The road crown is in every vehicle alike; it cancels in all
differences and enters the intervals of mounts once, not divided by the number of vehicles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control
from scipy.stats import t as t_distribution

from imucald.fleet.analysis.components import VarianceComponent, between_vehicles, robust_variance
from imucald.fleet.analysis.known_drives import between, turned
from imucald.fleet.analysis.moderation import moderated

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

MAX_Q = 0.05
LEAST_GROUP = 5
"""A batch with fewer vehicles is not judged."""
T_FREEDOM = 4.0
"""Of the t distribution whose weights make the centre robust (Lange et al., J. Am. Stat. Assoc. 84,
1989: 4 serves most data)."""
ROUNDS = 12
RESTARTS = 4
CENTRES = 400
"""Vehicles from which the first centre is chosen."""
LEAST_PLAIN = 5
"""A type with fewer vehicles beside those of found batches has these in its mean too."""


@dataclass(frozen=True)
class Units:
    """One row for each vehicle. rotation: its first segment's mount. V: (n, 3, 3) its covariance
    without the crown's part [deg^2]. kind: (n,) index of its type, of `kinds` types."""

    rotation: Rotation
    V: Array
    kind: Index
    kinds: int

    def __len__(self) -> int:
        """Return the number of vehicles."""
        return len(self.kind)

    @property
    def v(self) -> Array:
        """Variances (n, 3)."""
        return np.diagonal(self.V, axis1=1, axis2=2)


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


@dataclass
class Population:
    """What was found. centre: mounts of the types; e: (n, 3) vehicles about them, offsets of found
    batches taken out; offset: (n, 3) these. mean_covariance: (kinds, 3, 3) of the centres without
    the crown. T: components by type and axis; tau2: (kinds, 3) [deg^2] T moderated by the other
    types. freedom: (kinds,) of it. p, q: (n,) of each vehicle being an outlier."""

    centre: Rotation
    e: Array
    offset: Array
    T: list[list[VarianceComponent]]
    tau2: Array
    freedom: Array
    mean_covariance: Array
    p: Array
    q: Array
    outlier: Flags
    groups: list[GroupEffect] = field(default_factory=list)


def t_quantile(freedom: float) -> float:
    """Half width of a 95 % interval in standard deviations."""
    return float(t_distribution.ppf(0.975, max(freedom, 1.0)))


def population(units: Units, columns: Mapping[str, Sequence[str | None]]) -> Population:
    """Find types, batches and outliers. columns: what each vehicle is grouped by, by name."""
    codes = {name: _codes(values) for name, values in columns.items()}
    found: list[GroupEffect] = []
    offset = np.zeros((len(units), 3))
    for _ in range(RESTARTS):
        centre, e, T = _robust(units, offset)
        effects = _groups(units, e + offset, T, codes)
        now = {(g.column, g.name) for g in effects if g.found}
        offset = _offsets(units, effects, codes)
        if now == {(g.column, g.name) for g in found if g.found}:
            found = effects
            break
        found = effects
    return _without_outliers(units, centre, e, offset, T, found)


def _codes(values: Sequence[str | None]) -> tuple[list[str], Index]:
    """Names of the groups, and the index of each vehicle's (-1: not known)."""
    names = sorted({v for v in values if v is not None})
    index = {name: i for i, name in enumerate(names)}
    return names, np.array([-1 if v is None else index[v] for v in values], dtype=np.int64)


def _robust(units: Units, offset: Array) -> tuple[Rotation, Array, Array]:
    """Centres, vehicles about them less the offsets (n, 3), and T (kinds, 3), all robust."""
    rotation = turned(units.rotation, -offset) if len(units) else units.rotation
    centre = _first_centres(rotation, units)
    T = np.zeros((units.kinds, 3))
    e = np.zeros((len(units), 3))
    for _ in range(ROUNDS):
        e = between(rotation, centre[units.kind])
        for k in range(units.kinds):
            mine = units.kind == k
            T[k] = [robust_variance(e[mine, a] ** 2, units.v[mine, a]) for a in range(3)]
        w = _t_weights(e, T[units.kind] + units.v)[:, None] / (T[units.kind] + units.v)
        total = _sum(w, units.kind, units.kinds)
        centre = turned(centre, _sum(w * e, units.kind, units.kinds) / np.maximum(total, 1e-12))
    return centre, between(rotation, centre[units.kind]), T


def _sum(values: Array, kind: Index, kinds: int) -> Array:
    total = np.zeros((kinds, *values.shape[1:]))
    np.add.at(total, kind, values)
    return total


def _t_weights(e: Array, variance: Array) -> Array:
    """Weights (n,), at most 1, of the t distribution in three dimensions."""
    squares = (e * e / variance).sum(axis=1)
    return np.asarray(np.minimum((T_FREEDOM + 3.0) / (T_FREEDOM + squares), 1.0))


def _first_centres(rotation: Rotation, units: Units) -> Rotation:
    """The vehicle of each type with the least median distance to the others."""
    chosen = []
    for k in range(units.kinds):
        mine = np.flatnonzero(units.kind == k)
        mine = mine[:: max(1, len(mine) // CENTRES)]
        q = rotation[mine].as_quat()
        alike = np.abs(q @ q.T)  # cosine of half the angle between
        chosen.append(int(mine[int(np.argmax(np.median(alike, axis=1)))]))
    return rotation[chosen]


def _groups(
    units: Units, e: Array, T: Array, codes: Mapping[str, tuple[list[str], Index]]
) -> list[GroupEffect]:
    """Effects of all groups; those found are left out of what the others are compared with."""
    wide = T[units.kind] + units.v
    w = _t_weights(e, wide)
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


def _offsets(
    units: Units, effects: Sequence[GroupEffect], codes: Mapping[str, tuple[list[str], Index]]
) -> Array:
    """What found groups turn each of their vehicles by (n, 3) [deg]."""
    offset = np.zeros((len(units), 3))
    for g in effects:
        if g.found:
            names, index = codes[g.column]
            offset[index == names.index(g.name)] += g.effect
    return offset


def _without_outliers(
    units: Units, centre: Rotation, e: Array, offset: Array, T: Array, groups: list[GroupEffect]
) -> Population:
    """REML of T and the means without outliers; each vehicle judged by the others of its type."""
    odd = _t_weights(e, T[units.kind] + units.v) < _SUSPECT_WEIGHT
    rotation = turned(units.rotation, -offset) if len(units) else units.rotation
    for _ in range(RESTARTS):
        _, tau2, freedom = _components(units, e, odd)
        p = _leave_one_out(units, e, odd, tau2, freedom)
        q = false_discovery_control(p) if len(p) else p
        now = q <= MAX_Q
        if (now == odd).all():
            break
        odd = now
    parts, tau2, freedom = _components(units, e, odd)
    w = np.where(odd[:, None], 0.0, 1.0 / (tau2[units.kind] + units.v))
    w *= np.where((offset != 0.0).any(axis=1) & _has_others(units, offset, odd), 0.0, 1.0)[:, None]
    total = np.maximum(_sum(w, units.kind, units.kinds), 1e-12)
    centre = turned(centre, _sum(w * e, units.kind, units.kinds) / total)
    e = between(rotation, centre[units.kind])
    covariance = np.array([np.diag(1.0 / row) for row in total]).reshape(-1, 3, 3)
    return Population(centre, e, offset, parts, tau2, freedom, covariance, p, q, odd, groups)


_SUSPECT_WEIGHT = (T_FREEDOM + 3.0) / (T_FREEDOM + 16.27)
"""Of a vehicle whose square is above the 99.9th percentile of chi-square with 3 freedoms."""


def _has_others(units: Units, offset: Array, odd: Flags) -> Flags:
    """Whether a vehicle's type has others that neither stand out nor are of a found batch."""
    plain = ~odd & (offset == 0.0).all(axis=1)
    count = _sum(plain[:, None].astype(float), units.kind, units.kinds)[:, 0]
    return np.asarray(count[units.kind] >= LEAST_PLAIN)


def _components(
    units: Units, e: Array, odd: Flags
) -> tuple[list[list[VarianceComponent]], Array, Array]:
    """T by type and axis as each type shows it, then moderated (kinds, 3), with its freedoms."""
    found, usual = [], np.zeros((units.kinds, 3))
    for k in range(units.kinds):
        mine = (units.kind == k) & ~odd
        found.append([between_vehicles(e[mine, a], units.v[mine, a]) for a in range(3)])
        if mine.any():
            usual[k] = np.median(units.v[mine], axis=0)
    return found, *moderated(found, usual)


def _leave_one_out(units: Units, e: Array, odd: Flags, tau2: Array, freedom: Array) -> Array:
    """p of each vehicle against the mean of the others of its type that do not stand out."""
    wide = tau2[units.kind] + units.v
    w = np.where(odd[:, None], 0.0, 1.0 / wide)
    total, weighted = (_sum(x, units.kind, units.kinds)[units.kind] for x in (w, w * e))
    others = np.maximum(total - w, 1e-12)
    mean = (weighted - w * e) / others
    squares = ((e - mean) ** 2 / (wide + 1.0 / others)).sum(axis=1)
    return np.asarray(f_distribution.sf(squares / 3.0, 3, freedom[units.kind]))
