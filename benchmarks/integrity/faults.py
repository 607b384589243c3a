"""Faults, put into samples: what each does to a drive, and what is true then."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.integrity.bases import Base
from benchmarks.integrity.force import Response
from imucald.core.rotations import Matrix3, rotation_from_vector
from imucald.core.samples import GRAVITY, Samples, Series

Array = NDArray[np.float64]

TURN_S = 0.5
"""A sensor that is knocked or taken by hand turns within that time, where the gyroscope sees it."""
CLIPPED_SHARE = 0.02
CLIPPED_DRIVING_S = 60.0
"""Driving within which clipping has to be reported, with that share of its samples clipped."""
DEG = 180.0 / math.pi


@dataclass(frozen=True)
class Put:
    """How a fault is put in: from when on [s], which of its variants, to which side, draws."""

    start: float
    variant: int
    sign: float
    is_seen: bool
    """Of a turn: whether the gyroscope turns along."""
    rng: np.random.Generator


@dataclass(frozen=True)
class Faulty:
    """A drive with a fault.

    onset: first wrong sample [s]. judged: channels whose values are wrong. turn: of the mount at a
    time, in vehicle axes, on top of the base's. gyro_factor: of the database.
    left_out: channels that it no longer has.
    """

    samples: Samples
    onset: float
    judged: tuple[str, ...] = ()
    turn: Callable[[float], Matrix3] | None = None
    gyro_factor: float = 1.0
    left_out: frozenset[str] = field(default_factory=frozenset)
    response: Response = field(default_factory=Response)
    """What is put on the unit's own answer, all the time."""
    is_turned_round: bool = False
    """Roads lean the other way for it."""
    runs_from: float = 0.0
    """Time to alert runs from then on, where that is later than the onset."""


Edit = Callable[[Base, Put], Faulty]


def none(base: Base, put: Put) -> Faulty:
    """No fault."""
    return Faulty(base.samples, 0.0)


def _later(base: Base, channel: str, put: Put, edit: Callable[[Array, Array], Array]) -> Faulty:
    """Edit a channel's values from the start on; edit: values before and after the start."""
    series = base.samples[channel]
    at = int(np.searchsorted(series.t, put.start))
    values = series.values.copy()
    values[at:] = edit(values[:at], values[at:])
    changed = np.abs(values - series.values).reshape(len(values), -1).max(axis=1) > 0.0
    first = int(np.argmax(changed)) if changed.any() else at
    onset = float(series.t[min(first, len(series.t) - 1)])
    samples = {**base.samples, channel: Series(series.t, values)}
    return Faulty(samples, onset, (channel,) if channel in ("accel", "gyro") else ())


def _axis(base: Base, put: Put) -> tuple[str, int]:
    """Variants 0 to 2 are the accelerometer's axes, 3 to 5 the gyroscope's."""
    channel = "gyro" if put.variant % 6 >= 3 and "gyro" in base.samples else "accel"
    return channel, put.variant % 3


def frozen_sensor(base: Base, put: Put) -> Faulty:
    """The last value again and again, with right counters: whole unit, accelerometer, gyroscope."""
    both = [c for c in ("accel", "gyro") if c in base.samples]
    chosen = (both, both[:1], both[-1:])[put.variant % 3]
    faulty = Faulty(base.samples, put.start)
    for channel in chosen:
        one = _later(base, channel, put, lambda before, after: np.tile(before[-1], (len(after), 1)))
        samples = {**faulty.samples, channel: one.samples[channel]}
        faulty = Faulty(samples, one.onset, (*faulty.judged, channel))
    return faulty


def frozen_axis(base: Base, put: Put) -> Faulty:
    """One axis keeps its last value."""
    channel, i = _axis(base, put)
    return _later(base, channel, put, lambda before, after: _with(after, i, before[-1, i]))


def dead_axis(base: Base, put: Put) -> Faulty:
    """One axis says zero."""
    channel, i = _axis(base, put)
    return _later(base, channel, put, lambda _, after: _with(after, i, 0.0))


def clipped_axis(base: Base, put: Put) -> Faulty:
    """From the start on one axis cannot go beyond a level at either end, in 2 % of its samples.

    Time to alert runs from the first clipped sample that begins so much driving with that share
    clipped: of an axis that reaches its ends once in five minutes, no minute is clipped.
    """
    channel, i = _axis(base, put)
    t, whole = base.samples[channel].t, base.samples[channel].values[:, i]
    later = whole[t >= put.start]
    low, high = np.quantile(later, [0.5 * CLIPPED_SHARE, 1.0 - 0.5 * CLIPPED_SHARE])
    faulty = _later(
        base, channel, put, lambda _, after: _with(after, i, after[:, i].clip(low, high))
    )
    clipped = faulty.samples[channel].values[:, i] != whole
    driven = base.driven(t)
    stop = np.searchsorted(driven, driven + CLIPPED_DRIVING_S)
    count = np.concatenate([[0], np.cumsum(clipped)])
    share = (count[stop] - count[:-1]) / np.maximum(stop - np.arange(len(t)), 1)
    begins = clipped & (share >= CLIPPED_SHARE) & (driven + CLIPPED_DRIVING_S <= driven[-1])
    if not begins.any():  # no such minute: nothing to report
        return replace(faulty, onset=base.duration_s + CLIPPED_DRIVING_S)
    return replace(faulty, runs_from=float(t[int(np.argmax(begins))]))


def unit_change(base: Base, put: Put) -> Faulty:
    """From the start on in g where m/s^2 is stated, or in deg/s where rad/s is."""
    factors = (("accel", 1.0 / GRAVITY), ("gyro", DEG))
    channel, factor = factors[put.variant % 2 if "gyro" in base.samples else 0]
    return _later(base, channel, put, lambda _, after: factor * after)


def zero_step(size: float) -> Edit:
    """The zero of one axis of the accelerometer steps [m/s^2]."""

    def edit(base: Base, put: Put) -> Faulty:
        i, step = put.variant % 3, put.sign * size
        return _later(base, "accel", put, lambda _, after: _with(after, i, after[:, i] + step))

    return edit


def gain_step(share: float) -> Edit:
    """The gain of the whole accelerometer steps by a share."""

    def edit(base: Base, put: Put) -> Faulty:
        return _later(base, "accel", put, lambda _, after: (1.0 + put.sign * share) * after)

    return edit


def gyro_sign(base: Base, put: Put) -> Faulty:
    """The sign of one axis of the gyroscope turns, or of all."""
    if "gyro" not in base.samples:
        return none(base, put)
    signs = -np.ones(3) if put.variant % 4 == 3 else _one(put.variant % 4, -1.0)
    return _later(base, "gyro", put, lambda _, after: after * signs)


def small_rates(base: Base, put: Put) -> Faulty:
    """From the start on the rate in rad/s where deg/s is stated."""
    if "gyro" not in base.samples:
        return none(base, put)
    return _later(base, "gyro", put, lambda _, after: after / DEG)


def _with(values: Array, i: int, column: Array | float) -> Array:
    out = values.copy()
    out[:, i] = column
    return out


# a mount that moves ----------------------------------------------------------------------------


def remount(degrees: float) -> Edit:
    """The sensor is turned about a vehicle axis and stays so."""

    def edit(base: Base, put: Put) -> Faulty:
        size = put.sign * math.radians(degrees)
        width = TURN_S if put.is_seen else 0.0
        return _turned(base, put, lambda t: size * _ramp(t, put.start, width), put.start)

    return edit


def creep(degrees_per_hour: float) -> Edit:
    """The sensor turns about a vehicle axis all the time."""

    def edit(base: Base, put: Put) -> Faulty:
        rate = put.sign * math.radians(degrees_per_hour) / 3600.0
        seen = replace(put, is_seen=True)
        return _turned(base, seen, lambda t: rate * np.asarray(t), 0.0)

    return edit


def _ramp(t: Array, start: float, width: float) -> Array:
    if width <= 0.0:
        return np.asarray(np.asarray(t) >= start, dtype=float)
    return np.clip((np.asarray(t) - start) / width, 0.0, 1.0)


def _turned(base: Base, put: Put, angle: Callable[[Array], Array], onset: float) -> Faulty:
    """Samples as a sensor gives them that has been turned by an angle(t) about a vehicle axis.

    What is known of its zero errors turns along, as they are the sensor's.
    """
    axis = put.variant % 3
    samples = dict(base.samples)
    for channel, bias in (("accel", base.accel_bias), ("gyro", base.gyro_bias)):
        if channel not in samples:
            continue
        series = samples[channel]
        R = _mounts(base, series.t)
        vehicle = np.einsum("nij,nj->ni", R, series.values - np.array(bias))
        theta = angle(series.t)
        if channel == "gyro" and put.is_seen:
            vehicle[:, axis] += np.gradient(theta, series.t)
        vehicle = about(axis, -theta, vehicle)
        samples[channel] = Series(series.t, np.einsum("nji,nj->ni", R, vehicle) + np.array(bias))

    def turn(t: float) -> Matrix3:
        vector = np.zeros(3)
        vector[axis] = float(angle(np.array([t]))[0])
        return rotation_from_vector(vector)

    return Faulty(samples, onset, turn=turn)


def about(axis: int, theta: Array, vectors: Array) -> Array:
    """Vectors (N, 3) turned by angles (N,) [rad] about one of the axes, right-handed."""
    j, k = (axis + 1) % 3, (axis + 2) % 3
    out = vectors.copy()
    c, s = np.cos(theta), np.sin(theta)
    out[:, j] = c * vectors[:, j] - s * vectors[:, k]
    out[:, k] = s * vectors[:, j] + c * vectors[:, k]
    return out


def _mounts(base: Base, t: Array) -> Array:
    """R_vehicle_from_sensor (N, 3, 3) of the base at times (N,)."""
    R = np.tile(base.R_vehicle_from_sensor, (len(t), 1, 1))
    for start, later in base.mounts:
        R[t >= start] = later
    return R


# errors of the sensor and contradictions, all the time -----------------------------------------


def _linear(channel: str, matrix: Callable[[Put], Array], is_judged: bool) -> Edit:
    def edit(base: Base, put: Put) -> Faulty:
        if channel not in base.samples:
            return Faulty(base.samples, 0.0)
        series, applied = base.samples[channel], matrix(put)
        changed = Series(series.t, series.values @ applied.T)
        judged = (channel,) if is_judged else ()
        response = Response(**{channel: applied})
        return Faulty({**base.samples, channel: changed}, 0.0, judged, response=response)

    return edit


def _six(rng: np.random.Generator, share: float) -> Array:
    """One, and six cross-axis terms of a share rms, as `random_model` draws them."""
    matrix = np.eye(3)
    matrix[~np.eye(3, dtype=bool)] = share * rng.standard_normal(6)
    return matrix


def cross_axis(share: float, channel: str = "accel") -> Edit:
    """Cross-axis errors of the accelerometer (or gyroscope), rms share."""
    return _linear(channel, lambda put: _six(put.rng, share), is_judged=False)


def antisymmetric(share: float) -> Edit:
    """The axes of the accelerometer turned against the package and the gyroscope, rms share."""

    def matrix(put: Put) -> Array:
        off = np.triu(share * put.rng.standard_normal((3, 3)), 1)
        return np.asarray(np.eye(3) + off - off.T)

    return _linear("accel", matrix, is_judged=False)


def turned_gyroscope(angle_deg: float) -> Edit:
    """The gyroscope turned against the accelerometer, about an axis that is drawn."""

    def matrix(put: Put) -> Array:
        axis = put.rng.standard_normal(3)
        return rotation_from_vector(math.radians(angle_deg) * axis / np.linalg.norm(axis))

    return _linear("gyro", matrix, is_judged=False)


def mixture(base: Base, put: Put) -> Faulty:
    """Ordinary limits of a data sheet together: cross-axis terms of 2 %, a gain of 3 %, a zero of
    0.1 m/s^2, the gyroscope's axes 3 % off and turned by 1 deg."""
    response = Response(
        np.diag(_one(put.variant, 1.0 + put.sign * 0.03)) @ _six(put.rng, 0.02),
        zero=0.1 * put.rng.standard_normal(3),
    )
    accel = base.samples["accel"]
    samples = {
        **base.samples,
        "accel": Series(accel.t, accel.values @ response.accel.T + response.zero),
    }
    faulty = Faulty(samples, 0.0, response=response)
    for edit in (cross_axis(0.03, "gyro"), turned_gyroscope(1.0)):
        more = edit(replace(base, samples=faulty.samples), put)
        faulty = Faulty(more.samples, 0.0, response=faulty.response.then(more.response))
    return faulty


def gain(share: float) -> Edit:
    """Gain of one axis of the accelerometer off by a share."""
    return _linear(
        "accel", lambda put: np.diag(_one(put.variant, 1.0 + put.sign * share)), is_judged=False
    )


def _one(variant: int, value: float) -> Array:
    diagonal = np.ones(3)
    diagonal[variant % 3] = value
    return diagonal


def _exchanged(variant: int) -> Array:
    order = ((1, 0, 2), (0, 2, 1), (2, 1, 0))[variant % 3]
    return np.eye(3)[list(order)]


all_signs = _linear("accel", lambda _: -np.eye(3), is_judged=True)
one_sign = _linear("accel", lambda put: np.diag(_one(put.variant, -1.0)), is_judged=True)
accel_exchanged = _linear("accel", lambda put: _exchanged(put.variant), is_judged=True)
gyro_exchanged = _linear("gyro", lambda put: _exchanged(put.variant), is_judged=True)


def handedness(base: Base, put: Put) -> Faulty:
    """One axis of the unit has the wrong sign, in force and rate."""
    flip = np.diag(_one(put.variant, -1.0))
    samples = dict(base.samples)
    judged = tuple(c for c in ("accel", "gyro") if c in samples)
    for channel in judged:
        series = samples[channel]
        samples[channel] = Series(series.t, series.values @ flip)
    return Faulty(samples, 0.0, judged)


def gyro_units(factor: float) -> Edit:
    """The database multiplies rates by a factor too much."""

    def edit(base: Base, put: Put) -> Faulty:
        return Faulty(base.samples, 0.0, ("gyro",), gyro_factor=factor)

    return edit


def _scaled(channels: Sequence[str], factor: float) -> Edit:
    def edit(base: Base, put: Put) -> Faulty:
        samples = dict(base.samples)
        for channel in channels:
            if channel in samples:
                samples[channel] = Series(samples[channel].t, factor * samples[channel].values)
        return Faulty(samples, 0.0)

    return edit


def speed_units(factor: float) -> Edit:
    """All speeds times a factor, or the speed alone and the wheels right."""

    def edit(base: Base, put: Put) -> Faulty:
        channels = (("speed", "wheel_speeds"), ("speed",))[put.variant % 2]
        return _scaled(channels, factor)(base, put)

    return edit


speed_against_wheels = _scaled(("speed",), 1.19)
steering_sign = _scaled(("steering",), -1.0)


def speed_stuck(base: Base, put: Put) -> Faulty:
    """The speed stays as it was."""
    return _later(base, "speed", put, lambda before, after: np.full(len(after), before[-1]))


def reversing(base: Base, put: Put) -> Faulty:
    """Driven backwards all the time, and no signal of it.

    The same path driven the other way round: forward is backward, left is right; steering, lateral
    and longitudinal signals turn their sign, the yaw rate does not, left and right wheels change
    places.
    """
    changed = _scaled(("steering", "lateral_accel", "longitudinal_accel"), -1.0)(base, put).samples
    if "wheel_speeds" in changed:
        wheels = changed["wheel_speeds"]
        changed = {**changed, "wheel_speeds": Series(wheels.t, wheels.values[:, [1, 0, 3, 2]])}
    about_up = rotation_from_vector([0.0, 0.0, math.pi])
    left_out = frozenset({"reverse"})
    samples = {c: s for c, s in changed.items() if c not in left_out}
    return Faulty(samples, 0.0, turn=lambda _: about_up, left_out=left_out, is_turned_round=True)


def _with_reverse(base: Base, put: Put, values: Callable[[Array, Array], Array]) -> Faulty:
    """Another reverse signal, of times [s] and what is true; in every other drive no steering."""
    was = base.samples.get("reverse")
    t = np.arange(0.0, base.duration_s, 0.1) if was is None else was.t
    reverse = Series(t, values(t, np.zeros(len(t)) if was is None else was.values.ravel()))
    left_out = frozenset(base.samples) & ({"steering"} if put.variant % 2 else set())
    samples = {c: s for c, s in base.samples.items() if c not in left_out}
    return Faulty({**samples, "reverse": reverse}, put.start, left_out=left_out)


def reverse_turned_round(base: Base, put: Put) -> Faulty:
    """On while driving forwards and off in reverse: the other value of 'equals:'."""
    return _with_reverse(base, put, lambda _, is_on: 1.0 - is_on)


def reverse_stuck_on(base: Base, put: Put) -> Faulty:
    """On from some time on, while the vehicle drives forwards."""
    return _with_reverse(base, put, lambda t, is_on: np.where(t < put.start, is_on, 1.0))
