"""Errors of one signal that depend on another: products and even parts, of every pair.

A parameter of the model file is one number, and a cause of the catalogue is linear in the signals.
What a sensor shows too much may as well go with the speed, with the side that the vehicle turns to,
or with how hard it was driven a while ago: a zero that does is an even or a bent part of the other
signal, a gain or a delay that does is a product of two (Volterra terms of second order; as a test
of a linear model: Ramsey 1969; Lee, White and Granger 1993). Every sensor's zero, gain and delay is
asked beside every condition, by the equations' own physics.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import idct

from imucald.core.arrays import Array
from imucald.diagnosis.cause_keys import model_error, tolerance
from imucald.diagnosis.equations.forward import STOPPING_MPS2, Forward
from imucald.diagnosis.fit.added import AddedRows, level_of, rows_with, whitened
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.chance import Question, chance_of_both, chance_of_large
from imucald.diagnosis.fit.moderated import moderated
from imucald.diagnosis.fit.sandwich import scatters
from imucald.diagnosis.fit.score import Problem, what_leaves, without_best
from imucald.diagnosis.left_over.conditions import (
    CRAWL_MPS,
    EITHER_WAY,
    SPEEDS,
    TO_ONE_SIDE,
    conditions,
)
from imucald.diagnosis.left_over.stability import EITHER_SIDE, amount, drift_of
from imucald.diagnosis.result import GOES_WITH_ANOTHER, Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import SINGLE_NATS
from imucald.diagnosis.signals import STEP_S
from imucald.model.model import VehicleModel
from imucald.mount.mount_words import SD_95

ZERO, GAIN, LATE = "zero", "gain", "delay"
PARTS = 4
"""Of a segment, whose scatter is looked at: a bend or a braking lasts some seconds."""
LEAST_PARTS = 10.0
"""That carry what is known of an error."""
LEAST_BLOCKS = 6
OWN_SHARE = 0.1
"""Of a column's energy that columns of the catalogue do not make up for: beside less, its value is
that of what the columns err by (a variance inflation factor of ten; Marquardt 1970)."""
HALF_KMH = 0.5 / 3.6
"""A speed in whole km/h, as SAE J1979 has it, is off by so much [m/s]."""
DELAY = "speed.delay_s"
BEND_MPS = 10.0
OWN: Mapping[str, tuple[tuple[str, str], str, float]] = {
    "accel.bias.x": (EITHER_WAY, "accel.scale.0", STOPPING_MPS2),
    "accel.bias.y": (TO_ONE_SIDE, "accel.scale.1", STOPPING_MPS2),
    "gyro.bias.z": (TO_ONE_SIDE, "gyro.scale.2", STOPPING_MPS2 / BEND_MPS),
}
"""Zeros beside which a condition is the sign of the signal itself: a gain that is off makes as much
of a strong value."""
PRIOR = 3.0
"""Over the square of a half width: information of what lies evenly within it."""


@dataclass(frozen=True)
class Error:
    """Something that a sensor shows too much."""

    text: str
    signal: str
    kind: str
    key: str
    """Parameter of the catalogue that it is like, with its tolerance; empty: the speed's zero."""
    axis: int | None = None


ERRORS = (
    Error("the accelerometer's zero forward", "accel", ZERO, "accel.bias.x", 0),
    Error("the accelerometer's zero to the left", "accel", ZERO, "accel.bias.y", 1),
    Error("the accelerometer's zero upward", "accel", ZERO, "accel.bias.z", 2),
    Error("the gyroscope's zero about the forward axis", "gyro", ZERO, "gyro.bias.x", 0),
    Error("the gyroscope's zero about the left axis", "gyro", ZERO, "gyro.bias.y", 1),
    Error("the gyroscope's zero about the upward axis", "gyro", ZERO, "gyro.bias.z", 2),
    Error("the speed's zero", "speed", ZERO, ""),
    Error("the yaw rate's zero", "yaw_rate", ZERO, "yaw_rate.offset"),
    Error("the steering angle's zero", "steering", ZERO, "steering.offset"),
    Error("the lateral acceleration's zero", "lateral_accel", ZERO, "lateral_accel.offset"),
    Error("the longitudinal acceleration's zero", "longitudinal_accel", ZERO,
          "longitudinal_accel.offset"),
    Error("the accelerometer's gain", "accel", GAIN, "accel.scale.0"),
    Error("the gyroscope's gain", "gyro", GAIN, "gyro.scale.0"),
    Error("the speed's gain", "speed", GAIN, "speed.scale"),
    Error("the yaw rate's gain", "yaw_rate", GAIN, "yaw_rate.scale"),
    Error("the steering angle's gain", "steering", GAIN, "chassis.steering_ratio"),
    Error("the accelerometer's delay", "accel", LATE, "accel.delay_s"),
    Error("the gyroscope's delay", "gyro", LATE, "gyro.delay_s"),
    Error("the speed's delay", "speed", LATE, "speed.delay_s"),
    Error("the yaw rate's delay", "yaw_rate", LATE, "yaw_rate.delay_s"),
    Error("the steering angle's delay", "steering", LATE, "steering.delay_s"),
)  # fmt: skip
Asked = tuple[Error, str]
"""An error, and a condition that it may go with."""


def pairs(problem: Problem, state: State) -> list[Question]:
    """One question for each error of a sensor and each condition."""
    table = problem.table
    fitted = np.tile(problem.fit(), (sum(f.blocks for f in state.forwards), 1))
    # What was named and has no place in the model file is another in each segment.
    fitted[table.number] = -what_leaves(problem, drift_of(problem, state))[:, 1:]
    return asked_of(state.forwards, state.model, table, fitted)


def asked_of(
    forwards: Sequence[Forward], model: VehicleModel, table: Table, x: Array
) -> list[Question]:
    """Of drives beside a model file, whose table this is. x: (all blocks, P) departures that fit
    their segments."""
    if not all(f.has_gravity for f in forwards):
        return []  # the road's slope is left, and goes with anything
    some = [conditions(f) for f in forwards]
    asked = [
        (error, name)
        for error in ERRORS
        if all(f.drive.has(error.signal) for f in forwards)
        for name in some[0]
        if all(name in each for each in some) and _can_be_asked(error, name)
    ]
    each = iter(some)
    parts = rows_with(forwards, model, table, lambda f: _added(f, model, asked, next(each)))
    if not asked or sum(f.blocks for f in forwards) < LEAST_BLOCKS:
        return []
    prior = np.diag(PRIOR / np.maximum(np.abs(table.plausible).max(axis=1), 1e-12) ** 2)
    return list(_questions(asked, *_scores(parts, x, prior), model))


def _can_be_asked(error: Error, condition: str) -> bool:
    """A tyre answers after so much of its way, not of time (relaxation length, Pacejka, ch. 5):
    beside turning, a delay goes with the speed in every vehicle. A zero that goes with its own
    signal is a gain."""
    if error.kind == ZERO and error.signal == "speed" and condition == SPEEDS[0]:
        return False
    return error.kind != LATE or error.signal == "speed" or condition not in SPEEDS


def may_be(error: Error, condition: str, model: VehicleModel) -> float:
    """By how much a correct file may be wrong, with what the equations err by: where a vehicle
    would differ between its sides for it, that is not among it."""
    if not error.key:
        # A late speed is off by so much of the acceleration.
        late = tolerance(model, DELAY) + SD_95 * model_error(model, DELAY)
        return HALF_KMH + (STOPPING_MPS2 * late if condition in EITHER_WAY else 0.0)
    half = tolerance(model, error.key)
    if error.key in OWN and condition in OWN[error.key][0]:
        _, gain, strong = OWN[error.key]
        half += strong * (tolerance(model, gain) + SD_95 * model_error(model, gain))
    if condition in TO_ONE_SIDE:
        return half
    half += SD_95 * model_error(model, error.key)
    if error.kind == GAIN and condition in SPEEDS:
        # So much of a crawl is half a km/h.
        half += HALF_KMH / CRAWL_MPS if condition != SPEEDS[0] else 0.0
    return half


# columns -----------------------------------------------------------------------------------------


def _added(
    f: Forward, model: VehicleModel, asked: Sequence[Asked], some: Mapping[str, Array]
) -> Iterator[tuple[dict[str, Array], float]]:
    """What an error of one from one end of a condition to the other adds, times a step."""
    for error, name in asked:
        step = may_be(error, name, model)
        yield {error.signal: step * (some[name] * _unit(f, error).T).T}, step


def _unit(f: Forward, error: Error) -> Array:
    """(N,), or (N, 3) along the vehicle: what a zero, a gain or a delay of one adds."""
    if error.kind == ZERO:
        if error.axis is None:
            return np.ones(len(f.t))
        return np.tile(np.eye(3)[error.axis], (len(f.t), 1))
    level = level_of(f, error.signal)
    return level if error.kind == GAIN else np.asarray(-np.gradient(level, STEP_S, axis=0))


# scores ------------------------------------------------------------------------------------------


def _scores(parts: Mapping[str, AddedRows], x: Array, prior: Array) -> tuple[Array, Array]:
    """(B, PARTS, E) slope of the loss along each column, and its curvature: beside all columns of
    the catalogue, which go as far as is plausible (Frisch and Waugh), and the tilt. None of a
    column that these make up for."""
    rows = list(whitened(parts, x).values())
    P = x.shape[1]
    flat = [a.reshape(-1, a.shape[2])[:, 1:] for a in rows]
    inner = np.asarray(sum(a[:, :P].T @ a for a in flat))
    w = np.linalg.pinv(prior + inner[:, :P], hermitian=True) @ inner[:, P:]
    u = h = whole = np.zeros(1)
    for a in rows:
        left = _in_time(a[:, :, :1] - a[:, :, 1 : P + 1] @ x[:, :, None])
        own = _in_time(a[:, :, P + 1 :] - a[:, :, 1 : P + 1] @ w)
        u = u + _by_part(left, own)
        h = h + _by_part(own, own)
        whole = whole + np.sum(a[:, :, P + 1 :] ** 2, axis=(0, 1))
    is_own = h.sum(axis=(0, 1)) > OWN_SHARE * whole
    return u * is_own, h * is_own


def _in_time(a: Array) -> Array:
    """(B, n, E) of coefficients (B, K, E), n a multiple of `PARTS`."""
    n = -(-a.shape[1] // PARTS) * PARTS
    return np.asarray(idct(a, type=2, axis=1, norm="ortho", n=n))


def _by_part(a: Array, b: Array) -> Array:
    """(B, PARTS, E) sums of products of two, by time within each block."""
    product = a * b
    return np.asarray(product.reshape(len(a), PARTS, a.shape[1] // PARTS, -1).sum(axis=2))


# questions ---------------------------------------------------------------------------------------


def _questions(
    asked: Sequence[Asked], u: Array, h: Array, model: VehicleModel
) -> Iterator[Question]:
    there = h.sum(axis=(1, 2)) > 0.0
    u, h = u[there], h[there]
    tests: list[tuple[Error, str, PairTest]] = []
    for e, (error, condition) in enumerate(asked):
        own, known = u[:, :, e], np.maximum(h[:, :, e], 0.0)
        information = float(known.sum())
        if information <= 0.0 or information**2 < LEAST_PARTS * float((known**2).sum()):
            continue
        tests.append((error, condition, _test(own, known)))
    over, free = moderated(
        np.array([test.over for *_, test in tests]),
        np.array([test.free for *_, test in tests]),
        float(PARTS * len(u) - 1),
    )
    for (error, condition, test), scatter, count in zip(tests, over, free, strict=True):
        may = EITHER_SIDE * may_be(error, condition, model)
        value, sigma, p = test.value, test.sigma(scatter), test.chance(scatter, count)
        # An end less its error of one deviation.
        is_large = abs(value) * (1.0 - 1.0 / max(sigma, 1.0)) > may and test.gain > SINGLE_NATS
        size = amount(error.key, value) if error.key else f"{value:.2g} m/s"
        text = (
            f"{error.text} changes with {condition}: by {size} from one end to the other, "
            f"{sigma:.1f} σ ({abs(value) / may:.1f} times the limit of a correct file)"
        )
        structure = Structure(error.signal, GOES_WITH_ANOTHER, abs(value) / may, text)
        se = abs(value) / max(sigma, 1e-300)
        yield Question(p, is_large, structure, chance_of_large(may, se, float(count)))


@dataclass(frozen=True)
class PairTest:
    """What is known of one question. over: scatter over what noise makes, known by so many degrees
    of freedom as `free`; gain: nats on blocks that its fit did not see."""

    value: float
    by_rows: float
    """Its deviations by the noise of all rows."""
    over: float
    free: float
    gain: float

    def sigma(self, over: float) -> float:
        """Its deviations with a scatter, by the noise of all rows at most."""
        return self.by_rows / float(np.sqrt(max(over, 1.0)))

    def chance(self, over: float, free: float) -> float:
        """Its chance with a scatter that is known by so many degrees of freedom."""
        by = self.by_rows / float(np.sqrt(max(over, 1e-300)))
        return chance_of_both(by, free, self.by_rows)


def _test(u: Array, h: Array) -> PairTest:
    """u, h: (B, PARTS) slope and curvature of the loss.

    Its deviation is by the scatter between parts of segments or between segments, whichever is
    larger, with as many as what is known of it lies in; and by the noise of all rows.
    """
    information = float(h.sum())
    value = float(u.sum()) / information
    left = u - h * value
    U, H = u.sum(axis=1), h.sum(axis=1)
    by, count = min(_deviations(u, h, left), _deviations(U, H, left.sum(axis=1)))
    by_rows = abs(value) * float(np.sqrt(information))
    other = (U.sum() - U) / np.maximum(information - H, 1e-300)
    gain = without_best(other * U - 0.5 * other**2 * H)
    return PairTest(value, by_rows, (by_rows / max(by, 1e-300)) ** 2, count - 1.0, gain)


def _deviations(u: Array, h: Array, left: Array) -> tuple[float, float]:
    """Of a sum of slopes u, by how what is left of them scatters, alone and with neighbours; and in
    how many of them what is known lies, (sum h)^2 / sum h^2 (Carter, Schnepel and Steigerwald
    2017)."""
    scatter = max(float(s[0, 0]) for s in scatters(left.reshape(-1, 1), 1))
    count = max(float(h.sum() ** 2 / (h**2).sum()), 2.0)
    return abs(float(u.sum())) / float(np.sqrt(max(scatter, 1e-300))), count
