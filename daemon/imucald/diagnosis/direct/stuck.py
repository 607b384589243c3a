"""Find stuck signals: frames come, but their value does not change."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, true_runs
from imucald.core.samples import INERTIAL, Samples, Series
from imucald.core.text import counted
from imucald.diagnosis.direct.held_speed import chances_of_sensors
from imucald.diagnosis.direct.own_stays import (
    FEW_STAYS,
    chance_of_any,
    chance_of_change,
    number_as_long,
)
from imucald.diagnosis.signals import Mask, Spans

Index = NDArray[np.intp]
MOVING_MPS = 2.0
STUCK_S, STUCK_SLOW_S, STUCK_RUNS = 0.5, 8.0, 4.0
"""Shortest time that counts as stuck for a quick and for a slow sensor. The time must also be
STUCK_RUNS times the usual stay, or too long for chance (`own_stays`)."""
FEW_OTHERS = 3
CHANCE = 0.01
"""Chance of a false finding for each slow signal of a drive without faults."""
PARTNER_SHARE = 0.5
"""A slow signal is stuck if other signals go on moving by this share of their usual spread."""


@dataclass(frozen=True)
class Fault:
    """A fault of one signal."""

    cause: str
    signal: str
    values: Mapping[str, tuple[float, float, str]]
    """By key: value, deviation, unit."""
    text: str
    changes: Mapping[str, Any]
    """Changes of the model file that state the fault."""
    spans: Spans = ()
    """Intervals of time [s] that must not be used."""
    score: float = 50.0
    """Evidence [nats], if it is known."""
    held: Spans = ()
    """At a rail, the samples on the rail only, without the margin about them."""
    against: tuple[str, ...] = ()
    """Arguments against the fault, in sentences: with any, it is likely and not certain."""


def stuck(
    name: str,
    series: Series,
    samples: Samples,
    moving: tuple[Array, Array],
    piled: Sequence[Fault] = (),
) -> Iterator[Fault]:
    """Find intervals with one constant value while the vehicle moves. Zeros at rest are normal, and
    so is a constant value on a rail (for a signal with one component, at either end)."""
    t, table = series.t, series.values.reshape(len(series.t), -1)
    same = (np.diff(table, axis=0) == 0.0).all(axis=1)
    first, last = true_runs(same).T
    if not len(first):
        return
    # Missing frames are another fault.
    length = np.minimum(t[last] - t[first], (last - first) * float(np.median(np.diff(t))))
    length[_on_a_rail(name, t, table, first, last, piled)] = 0.0
    # Only time in motion counts; a long interval may contain stops.
    steps = np.diff(t) * (np.interp(0.5 * (t[1:] + t[:-1]), *moving) > MOVING_MPS)
    driven = np.concatenate([[0.0], np.cumsum(steps)])
    length = np.minimum(length, driven[last] - driven[first])
    least = STUCK_S if name in INERTIAL else STUCK_SLOW_S
    driving = length[length > 0.0]
    usual = _usual(driving)
    long = length > max(least, STUCK_RUNS * usual)
    for k in np.flatnonzero(long):
        long[k] = length[k] > STUCK_RUNS * _usual_of(table[first], length, int(k))
    stays = [(float(t[a]), float(t[b])) for a, b in zip(first, last, strict=True)]
    if name in INERTIAL:
        spans = [stays[k] for k in np.flatnonzero(long)]
    else:
        asked = np.flatnonzero(length > STUCK_SLOW_S)
        felt = np.full(len(stays), np.nan)
        if name == "speed":
            felt[asked] = chances_of_sensors(samples, tuple(stays[k] for k in asked))
        sole = _chances(t, table[:, 0], last, length, asked, felt) < CHANCE
        # A chance that includes the inertial sensors needs no other evidence.
        sure, maybe = sole & np.isfinite(felt), sole | (long & (usual > 0.0))
        spans = [
            stays[k]
            for k in np.flatnonzero(maybe)
            if sure[k] or _others_move(name, samples, stays[k])
        ]
    spans = [s for s in spans if not _is_shown_often(t, table, first, s)]
    total = sum(b - a for a, b in spans)
    if not spans or (name not in INERTIAL and total < STUCK_SLOW_S):
        return
    gaps = tuple({"start_s": max(a, 0.0), "duration_s": b - a} for a, b in spans)
    yield Fault(
        "stuck_signal", name, {f"_{name}.stuck_s": (total, 0.0, "s")},
        f"Frames come, but the value does not change for {total:.1f} s in "
        f"{counted(len(spans), 'piece')} of driving, from {spans[0][0]:.0f} s on.",
        {f"{name}.stuck": gaps}, tuple(spans), 5.0 * total / max(least, 1.0),
    )  # fmt: skip


def _on_a_rail(
    name: str, t: Array, table: Array, first: Index, last: Index, piled: Sequence[Fault]
) -> Mask:
    """Return which intervals lie on a rail that was found; for a signal with one component, at
    either end."""
    hit = np.zeros(len(first), dtype=bool)
    for fault in piled:
        for low, high in fault.spans:
            hit |= (t[last] >= low) & (t[first] <= high)
        size, *_ = fault.values.get(f"{name}.full_scale", (np.inf,))
        if table.shape[1] == 1:
            hit |= np.abs(table[first, 0]) >= size * (1.0 - 1e-9)
    return hit


def _usual(length: Array) -> float:
    """Return the length of stay that 99 % of the stays do not exceed. Few stays give no measure of
    this length."""
    length = length[length > 0.0]
    return float(np.quantile(length, 0.99, method="lower")) if len(length) > FEW_STAYS else 0.0


def _usual_of(values: Array, length: Array, k: int) -> float:
    """Return the same length for stays at the held value only. A value that a sensor shows
    repeatedly for some time (a dead zone, a default) is no sign of a stuck sensor."""
    return _usual(length[(values == values[k]).all(axis=1)])


def _is_shown_often(t: Array, table: Array, first: Index, span: tuple[float, float]) -> bool:
    """True if most other stays of a sensor have the same value as this span: then it is a dead zone
    and no stuck sensor. first: rows at which a stay begins."""
    inside = (t >= span[0]) & (t <= span[1])
    value = table[inside][0]
    others = first[~inside[first]]
    if len(others) < FEW_OTHERS:
        return False
    return bool((table[others] == value).all(axis=1).mean() > 0.5)


def _chances(t: Array, x: Array, last: Index, length: Array, asked: Index, felt: Array) -> Array:
    """(S,) chance that any stay of a healthy slow signal x (N,) is as unusual as this one: as long,
    ending with as large a change, and contradicted as strongly by the inertial sensors. 1 for stays
    that are not tested.

    last: rows at which stays end; length: of each while driving [s]; felt: chance by the inertial
    sensors, NaN if they show nothing.
    """
    made = np.ones(len(length))
    if not len(asked):
        return made
    steps = np.round(length / np.median(np.diff(t))).astype(np.intp)
    changes = np.abs(np.diff(x))
    ends = last < len(changes)
    for k in asked:
        others = steps > 0
        others[k] = False
        factors = [number_as_long(steps[others], int(steps[k]))]
        if ends[k]:
            like = changes[last[others & ends]]
            own = like if len(like) > FEW_STAYS else changes[changes > 0.0]
            factors.append(chance_of_change(own, float(changes[last[k]])))
        if np.isfinite(felt[k]):
            factors.append(float(felt[k]))
        made[k] = chance_of_any(float(np.prod(factors)), len(factors), len(asked))
    return made


def _others_move(name: str, samples: Samples, span: tuple[float, float]) -> bool:
    """True if related signals go on moving in an interval of time."""
    if name == "speed":
        partner = samples["accel"]
    else:
        known = samples.get("yaw_rate") or samples.get("gyro")
        if known is None:
            return False
        partner = known
    table = partner.values.reshape(len(partner.t), -1)
    bins = np.floor(partner.t).astype(int)
    inside = (partner.t >= span[0]) & (partner.t <= span[1])
    seconds = np.array([np.bincount(bins - bins[0], c) for c in table.T]).T
    count = np.maximum(np.bincount(bins - bins[0]), 1)[:, None]
    means = seconds / count
    here = np.unique(bins[inside] - bins[0])
    if len(here) < 4:
        return False
    return bool(np.any(np.std(means[here], axis=0) > PARTNER_SHARE * np.std(means, axis=0)))
