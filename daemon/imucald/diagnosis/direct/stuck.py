"""Find slow signals that are stuck: frames come, but their value does not change.

`motion.recorded_health` judges sensors, whose noise always changes their values.
"""

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
from imucald.diagnosis.signals import Spans

Index = NDArray[np.intp]
MOVING_MPS = 2.0
STUCK = "stuck_signal"
STUCK_S, STUCK_RUNS = 8.0, 4.0
"""Shortest time that counts as stuck for a signal that may keep its value. The time must also be
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
) -> Iterator[Fault]:
    """Find intervals with one constant value while the vehicle moves, of a signal that may keep its
    value for seconds: speed, steering angle. Zeros at rest are normal."""
    t, table = series.t, series.values.reshape(len(series.t), -1)
    same = (np.diff(table, axis=0) == 0.0).all(axis=1)
    first, last = true_runs(same).T
    if not len(first):
        return
    # Missing frames are another fault.
    length = np.minimum(t[last] - t[first], (last - first) * float(np.median(np.diff(t))))
    # Only time in motion counts; a long interval may contain stops.
    steps = np.diff(t) * (np.interp(0.5 * (t[1:] + t[:-1]), *moving) > MOVING_MPS)
    driven = np.concatenate([[0.0], np.cumsum(steps)])
    length = np.minimum(length, driven[last] - driven[first])
    usual = _usual(length)
    long = length > max(STUCK_S, STUCK_RUNS * usual)
    for k in np.flatnonzero(long):
        long[k] = length[k] > STUCK_RUNS * _usual_of(table[first], length, int(k))
    stays = [(float(t[a]), float(t[b])) for a, b in zip(first, last, strict=True)]
    asked = np.flatnonzero(length > STUCK_S)
    felt = np.full(len(stays), np.nan)
    if name == "speed":
        felt[asked] = chances_of_sensors(samples, tuple(stays[k] for k in asked))
    sole = _chances(t, table[:, 0], last, length, asked, felt) < CHANCE
    # A chance that includes the inertial sensors needs no other evidence.
    sure, maybe = sole & np.isfinite(felt), sole | (long & (usual > 0.0))
    spans = [
        stays[k] for k in np.flatnonzero(maybe) if sure[k] or _others_move(name, samples, stays[k])
    ]
    spans = [s for s in spans if not is_shown_often(series, s)]
    if sum(b - a for a, b in spans) >= STUCK_S:
        yield stuck_fault(name, spans)


def stuck_fault(name: str, spans: Sequence[tuple[float, float]]) -> Fault:
    """The fault of a signal that repeats one value in these intervals of time [s]."""
    total = sum(b - a for a, b in spans)
    gaps = tuple({"start_s": max(a, 0.0), "duration_s": b - a} for a, b in spans)
    least = 1.0 if name in INERTIAL else STUCK_S
    return Fault(
        STUCK, name, {f"_{name}.stuck_s": (total, 0.0, "s")},
        f"Frames come, but the value does not change for {total:.1f} s in "
        f"{counted(len(spans), 'piece')} of driving, from {spans[0][0]:.0f} s on.",
        {f"{name}.stuck": gaps}, tuple(spans), 5.0 * total / least,
    )  # fmt: skip


def _usual(length: Array) -> float:
    """Return the length of stay that 99 % of the stays do not exceed. Few stays give no measure of
    this length."""
    length = length[length > 0.0]
    return float(np.quantile(length, 0.99, method="lower")) if len(length) > FEW_STAYS else 0.0


def _usual_of(values: Array, length: Array, k: int) -> float:
    """Return the same length for stays at the held value only. A value that a sensor shows
    repeatedly for some time (a dead zone, a default) is no sign of a stuck sensor."""
    return _usual(length[(values == values[k]).all(axis=1)])


def is_shown_often(series: Series, span: tuple[float, float]) -> bool:
    """Return whether most other stays of a signal have the same value as an interval of time: then
    it is a dead zone, and nothing is stuck."""
    t, table = series.t, series.values.reshape(len(series.t), -1)
    first = true_runs((np.diff(table, axis=0) == 0.0).all(axis=1))[:, 0]
    inside = (t >= span[0]) & (t <= span[1])
    others = first[~inside[first]]
    if len(others) < FEW_OTHERS:
        return False
    return bool((table[others] == table[inside][0]).all(axis=1).mean() > 0.5)


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
