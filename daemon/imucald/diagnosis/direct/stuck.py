"""Frames that come, with a value that does not change."""

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
"""A quick sensor is stuck from so long on, a slow one; and only if so many times the usual, or if
chance does not make it (`own_stays`)."""
FEW_OTHERS = 3
CHANCE = 0.01
"""Of each slow signal of a sound drive."""
PARTNER_SHARE = 0.5
"""A slow signal is stuck where others go on moving by this share of their usual spread."""


@dataclass(frozen=True)
class Fault:
    """A fault of one signal."""

    cause: str
    signal: str
    values: Mapping[str, tuple[float, float, str]]
    """Key to value, deviation, unit."""
    text: str
    changes: Mapping[str, Any]
    """What the model file says of it from now on."""
    spans: Spans = ()
    """Intervals of time [s] that must not be used."""
    score: float = 50.0
    """Evidence in nats, as far as it is known."""
    held: Spans = ()
    """The samples themselves, of a rail: without what is kept out about them."""
    against: tuple[str, ...] = ()
    """What speaks against it, in sentences: it is likely then, not certain."""


def stuck(
    name: str,
    series: Series,
    samples: Samples,
    moving: tuple[Array, Array],
    piled: Sequence[Fault] = (),
) -> Iterator[Fault]:
    """Frames that come with one value while the vehicle moves; zeros at rest are natural, and so is
    one value on a rail (of a signal with one number, on either end)."""
    t, table = series.t, series.values.reshape(len(series.t), -1)
    same = (np.diff(table, axis=0) == 0.0).all(axis=1)
    first, last = true_runs(same).T
    if not len(first):
        return
    # Frames that do not come are another fault.
    length = np.minimum(t[last] - t[first], (last - first) * float(np.median(np.diff(t))))
    length[_on_a_rail(name, t, table, first, last, piled)] = 0.0
    # Only while driving; a long interval may hold stops.
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
        # A chance that holds what the sensors say needs no other witness.
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
    """Which intervals lie on a rail that was found; of a signal with one number, on either end."""
    hit = np.zeros(len(first), dtype=bool)
    for fault in piled:
        for low, high in fault.spans:
            hit |= (t[last] >= low) & (t[first] <= high)
        size, *_ = fault.values.get(f"{name}.full_scale", (np.inf,))
        if table.shape[1] == 1:
            hit |= np.abs(table[first, 0]) >= size * (1.0 - 1e-9)
    return hit


def _usual(length: Array) -> float:
    """How long values stay, but for one in a hundred; of few the longest is no measure of it."""
    length = length[length > 0.0]
    return float(np.quantile(length, 0.99, method="lower")) if len(length) > FEW_STAYS else 0.0


def _usual_of(values: Array, length: Array, k: int) -> float:
    """The same of the value that is held: what a sensor shows again and again, for a while each
    time (a dead zone, a default), is not what it was stuck at."""
    return _usual(length[(values == values[k]).all(axis=1)])


def _is_shown_often(t: Array, table: Array, first: Index, span: tuple[float, float]) -> bool:
    """Whether what a sensor shows in a span is what most of its other stays are at: a dead zone,
    and no sensor that is stuck. first: rows at which a stay begins."""
    inside = (t >= span[0]) & (t <= span[1])
    value = table[inside][0]
    others = first[~inside[first]]
    if len(others) < FEW_OTHERS:
        return False
    return bool((table[others] == value).all(axis=1).mean() > 0.5)


def _chances(t: Array, x: Array, last: Index, length: Array, asked: Index, felt: Array) -> Array:
    """(S,) chance that any stay of a sound slow signal x (N,) is as much out of the ordinary: as
    long, ends with as large a change, and the sensors speak as much against it. 1 where not asked.

    last: rows at which stays end; length: of each while driving [s]; felt: chance of what the
    sensors say, NaN where they say nothing.
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
    """Whether what should move with a signal goes on moving in an interval of time."""
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
