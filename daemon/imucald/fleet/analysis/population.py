"""Vehicle types: the mount of each type, the scatter between vehicles, and unusual vehicles or
batches.

Rotation vectors are relative to the mount of the type, in the vehicle's axes [deg]. Each vehicle
counts once, with its first segment (the mount at delivery). The error from the road crown is the
same in every vehicle, so it cancels in all differences. This error is added once to the intervals
of mounts and is not divided by the number of vehicles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control

from imucald.core.arrays import Array, Flags
from imucald.fleet.analysis.components import (
    VarianceComponent,
    between_vehicles,
    moderated,
    robust_variance,
)
from imucald.fleet.analysis.groups import (
    GroupEffect,
    group_codes,
    group_effects,
    group_offsets,
)
from imucald.fleet.analysis.known_drives import between, turned
from imucald.fleet.analysis.units import MAX_Q, T_FREEDOM, Units, sums_by, t_weights

ROUNDS = 12
RESTARTS = 4
CENTRES = 400
"""Largest number of vehicles among which the first centre of a type is chosen."""
LEAST_PLAIN = 5
"""The mean of a type uses only vehicles outside bad batches. If there are fewer such vehicles than
this number, the mean also uses vehicles of bad batches."""


@dataclass
class Population:
    """Result of the analysis. centre: mounts of the types. e: (n, 3) rotation vectors of the
    vehicles relative to the centre of their type, without the offsets of bad batches [deg]. offset:
    (n, 3) the offsets of bad batches [deg]. mean_covariance: (kinds, 3, 3) covariance of the
    centres without the road crown. T: variance components by type and axis. tau2: (kinds, 3) T
    moderated by the other types [deg^2]. freedom: (kinds,) degrees of freedom of tau2. p, q: (n,)
    p-value and false-discovery rate of the test whether a vehicle is an outlier."""

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


def population(units: Units, columns: Mapping[str, Sequence[str | None]]) -> Population:
    """Find the mounts of the vehicle types, bad batches, and vehicles that are outliers. columns:
    for each column of groups, the group of each vehicle."""
    codes = {name: group_codes(values) for name, values in columns.items()}
    found: list[GroupEffect] = []
    offset = np.zeros((len(units), 3))
    for _ in range(RESTARTS):
        centre, e, T = _robust(units, offset)
        effects = group_effects(units, e + offset, T, codes)
        now = {(g.column, g.name) for g in effects if g.found}
        offset = group_offsets(units, effects, codes)
        if now == {(g.column, g.name) for g in found if g.found}:
            found = effects
            break
        found = effects
    return _without_outliers(units, centre, e, offset, T, found)


def _robust(units: Units, offset: Array) -> tuple[Rotation, Array, Array]:
    """Return robust estimates: centres of the types, rotation vectors of the vehicles relative to
    the centres without the offsets (n, 3), and the variance T between vehicles (kinds, 3)."""
    rotation = turned(units.rotation, -offset) if len(units) else units.rotation
    centre = _first_centres(rotation, units)
    T = np.zeros((units.kinds, 3))
    e = np.zeros((len(units), 3))
    for _ in range(ROUNDS):
        e = between(rotation, centre[units.kind])
        for k in range(units.kinds):
            mine = units.kind == k
            T[k] = [robust_variance(e[mine, a] ** 2, units.v[mine, a]) for a in range(3)]
        w = t_weights(e, T[units.kind] + units.v)[:, None] / (T[units.kind] + units.v)
        total = sums_by(w, units.kind, units.kinds)
        centre = turned(centre, sums_by(w * e, units.kind, units.kinds) / np.maximum(total, 1e-12))
    return centre, between(rotation, centre[units.kind]), T


def _first_centres(rotation: Rotation, units: Units) -> Rotation:
    """Return for each type the mount of the vehicle with the smallest median distance to the other
    vehicles."""
    chosen = []
    for k in range(units.kinds):
        mine = np.flatnonzero(units.kind == k)
        mine = mine[:: max(1, len(mine) // CENTRES)]
        q = rotation[mine].as_quat()
        closeness = np.abs(q @ q.T)  # cosine of half the angle between
        chosen.append(int(mine[int(np.argmax(np.median(closeness, axis=1)))]))
    return rotation[chosen]


def _without_outliers(
    units: Units, centre: Rotation, e: Array, offset: Array, T: Array, groups: list[GroupEffect]
) -> Population:
    """Estimate the variance T between vehicles by REML, and the means, without outliers.

    Each vehicle is compared with the other vehicles of its type to find outliers."""
    odd = t_weights(e, T[units.kind] + units.v) < _SUSPECT_WEIGHT
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
    total = np.maximum(sums_by(w, units.kind, units.kinds), 1e-12)
    centre = turned(centre, sums_by(w * e, units.kind, units.kinds) / total)
    e = between(rotation, centre[units.kind])
    covariance = np.array([np.diag(1.0 / row) for row in total]).reshape(-1, 3, 3)
    return Population(centre, e, offset, parts, tau2, freedom, covariance, p, q, odd, groups)


_SUSPECT_WEIGHT = (T_FREEDOM + 3.0) / (T_FREEDOM + 16.27)
"""A vehicle with a smaller robust weight is an outlier candidate. The value is the weight at the
99.9th percentile of chi-square with 3 degrees of freedom (16.27)."""


def _has_others(units: Units, offset: Array, odd: Flags) -> Flags:
    """Return for each vehicle whether its type has at least `LEAST_PLAIN` vehicles that are neither
    outliers nor in a bad batch."""
    plain = ~odd & (offset == 0.0).all(axis=1)
    count = sums_by(plain[:, None].astype(float), units.kind, units.kinds)[:, 0]
    return np.asarray(count[units.kind] >= LEAST_PLAIN)


def _components(
    units: Units, e: Array, odd: Flags
) -> tuple[list[list[VarianceComponent]], Array, Array]:
    """Return the variance T between vehicles by type and axis, from each type alone; the moderated
    T (kinds, 3); and its degrees of freedom."""
    found, usual = [], np.zeros((units.kinds, 3))
    for k in range(units.kinds):
        mine = (units.kind == k) & ~odd
        found.append([between_vehicles(e[mine, a], units.v[mine, a]) for a in range(3)])
        if mine.any():
            usual[k] = np.median(units.v[mine], axis=0)
    return found, *moderated(found, usual)


def _leave_one_out(units: Units, e: Array, odd: Flags, tau2: Array, freedom: Array) -> Array:
    """Return the p-value of each vehicle. The vehicle is compared with the mean of the other
    vehicles of its type, without outliers."""
    wide = tau2[units.kind] + units.v
    w = np.where(odd[:, None], 0.0, 1.0 / wide)
    total, weighted = (sums_by(x, units.kind, units.kinds)[units.kind] for x in (w, w * e))
    others = np.maximum(total - w, 1e-12)
    mean = (weighted - w * e) / others
    squares = ((e - mean) ** 2 / (wide + 1.0 / others)).sum(axis=1)
    return np.asarray(f_distribution.sf(squares / 3.0, 3, freedom[units.kind]))
