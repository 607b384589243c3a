"""Find slow signals that are stuck: frames are received, but their value does not change.

`motion.recorded_health` tests sensors, whose values always change because of noise.
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
"""Shortest time [s] that counts as stuck for a signal that may keep its value. The time must also
be STUCK_RUNS times the usual stay, or too long for chance (`own_stays`)."""
FEW_OTHERS = 3
CHANCE = 0.01
"""Chance of a false finding for each slow signal of a drive without faults."""
PARTNER_SHARE = 0.5
"""Smallest ratio of a related signal's spread during a stay to its usual spread, at which the slow
signal counts as stuck."""


@dataclass(frozen=True)
class Fault:
    """A fault of one signal."""

    cause: str
    signal: str
    values: Mapping[str, tuple[float, float, str]]
    """Value, deviation and unit, by key."""
    text: str
    changes: Mapping[str, Any]
    """Changes of the model file that state the fault."""
    spans: Spans = ()
    """Intervals of time [s] that must not be used."""
    score: float = 50.0
    """Evidence [nats], if known."""
    held: Spans = ()
    """At the end of a range: the samples with the end value, without the margin around them."""
    against: tuple[str, ...] = ()
    """Arguments against the fault, as sentences. A fault with such an argument is likely and not
    certain."""


def stuck(
    name: str,
    series: Series,
    samples: Samples,
    moving: tuple[Array, Array],
) -> Iterator[Fault]:
    """Yield a fault if a slow signal has intervals with one constant value while the vehicle moves.

    Slow signals are signals that may keep their value for seconds: speed, steering angle. Zeros at
    rest are normal."""
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
    """Return the fault of a signal that repeats one value in these intervals of time [s]."""
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
    """Return the length of stay that 99 % of the stays do not exceed; 0 if there are too few
    stays."""
    length = length[length > 0.0]
    return float(np.quantile(length, 0.99, method="lower")) if len(length) > FEW_STAYS else 0.0


def _usual_of(values: Array, length: Array, k: int) -> float:
    """Return the length that 99 % of the stays at the same value do not exceed. If a sensor
    repeatedly shows a value for some time (a dead zone, a default value), this value is no evidence
    of a stuck sensor."""
    return _usual(length[(values == values[k]).all(axis=1)])


def is_shown_often(series: Series, span: tuple[float, float]) -> bool:
    """Return whether most other stays of a signal have the same value as an interval of time. The
    value is then a dead zone, and the signal is not stuck."""
    t, table = series.t, series.values.reshape(len(series.t), -1)
    first = true_runs((np.diff(table, axis=0) == 0.0).all(axis=1))[:, 0]
    inside = (t >= span[0]) & (t <= span[1])
    others = first[~inside[first]]
    if len(others) < FEW_OTHERS:
        return False
    return bool((table[others] == table[inside][0]).all(axis=1).mean() > 0.5)


def _chances(t: Array, x: Array, last: Index, length: Array, asked: Index, felt: Array) -> Array:
    """Return the chance (S,) that any stay of a healthy slow signal x (N,) is as unusual as this
    stay. 1 for stays that are not tested.

    A stay is unusual if it is long, ends with a large change, and contradicts the inertial sensors.
    last: rows at which the stays end. length: length of each stay while driving [s]. felt: chance
    of each stay by the inertial sensors; NaN if they give no evidence.
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
