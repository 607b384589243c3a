"""Test every pair of signals for an error of one signal that depends on the other signal.

A sensor's error may depend on the speed, on the direction of turning, or on hard driving shortly
before. A zero error that depends on another signal is an even or nonlinear function of this signal.
A gain or a delay that depends on another signal is a product of two signals (Volterra terms of
second order; as a test of a linear model: Ramsey 1969; Lee, White and Granger 1993).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import idct
from scipy.signal import lfilter

from imucald.core.arrays import Array
from imucald.diagnosis.cause_keys import model_error, tolerance
from imucald.diagnosis.direct.faults import PAUSE_S, late_steps
from imucald.diagnosis.equations.forward import STOPPING_MPS2, Forward
from imucald.diagnosis.fit.added import AddedRows, level_of, rows_with, whitened
from imucald.diagnosis.fit.chance import Answer, chance_of_both, chance_of_large, moderated
from imucald.diagnosis.fit.intervals import scatters
from imucald.diagnosis.fit.score import without_best
from imucald.diagnosis.left_over.courses import DELAY, EITHER_SIDE, amount
from imucald.diagnosis.left_over.remains import LEAST_SEGMENTS, Remains
from imucald.diagnosis.result import Kind
from imucald.diagnosis.search.trials import SINGLE_NATS
from imucald.diagnosis.signals import STANDING_MPS, STEP_S, Channel, Mask
from imucald.model.model import VehicleModel
from imucald.mount.mount_words import SD_95

CRAWL_MPS = 3.0
SHAKEN_S = (3.0, 10.0)
"""Averaging times of the vibration [s]. The longest is the time whose effects the tilt of a segment
absorbs."""
LARGE = 2.0
"""Level, in multiples of the rms, above which a value may have an after-effect."""
MEMORY_S = 20.0
"""Time constant of the memory [s]: between the length of a bend and the length of a segment."""
SPEEDS = ("the speed", "crawling")
EITHER_WAY = ("accelerating and braking", "the last hard acceleration")
TO_ONE_SIDE = ("the direction of turning", "the last hard turning")
"""Conditions that change sign when left and right are exchanged. A vehicle is symmetric in this
respect."""
STAMPS = "the deviation of its time stamps from a constant cycle"
ENDS = (0.05, 0.95)
BEYOND = 0.5
"""Distance beyond the two percentiles up to which a condition is followed, relative to the distance
between the percentiles."""
ZERO, GAIN, LATE, ASIDE = "zero", "gain", "delay", "place"
PARTS = 4
"""Number of parts of a segment whose scatter is used: a bend or a braking lasts some seconds."""
LEAST_PARTS = 10.0
"""Smallest number of parts that contain the information on an error."""
OWN_SHARE = 0.1
"""Smallest share of a column's energy that the catalogue's columns do not explain. With a smaller
share, the column's value depends on the errors of the catalogue's columns (a variance inflation
factor of ten; Marquardt 1970)."""
HALF_KMH = 0.5 / 3.6
"""Error of a speed in whole km/h, as in SAE J1979 [m/s]."""
OWN: Mapping[str, tuple[tuple[str, ...], str, float]] = {
    "accel.bias.x": (EITHER_WAY, "accel.scale.0", STOPPING_MPS2),
    "accel.bias.y": (TO_ONE_SIDE, "accel.scale.1", STOPPING_MPS2),
    "gyro.bias.z": (TO_ONE_SIDE, "gyro.scale.2", STOPPING_MPS2 / 10.0),
}
"""Zero errors whose condition is the sign of the signal itself. A gain error has the same effect at
large values."""


@dataclass(frozen=True)
class Error:
    """An error of a sensor's reading."""

    text: str
    signal: str
    kind: str
    key: str
    """The similar parameter of the catalogue, whose tolerance is used; empty for the speed's zero
    error."""
    axis: int | None = None


ERRORS = (
    Error("the accelerometer's zero forward", "accel", ZERO, "accel.bias.x", 0),
    Error("the accelerometer's zero to the left", "accel", ZERO, "accel.bias.y", 1),
    Error("the accelerometer's zero upward", "accel", ZERO, "accel.bias.z", 2),
    Error("the gyroscope's zero about the forward axis", "gyro", ZERO, "gyro.bias.x", 0),
    Error("the gyroscope's zero about the left axis", "gyro", ZERO, "gyro.bias.y", 1),
    Error("the gyroscope's zero about the upward axis", "gyro", ZERO, "gyro.bias.z", 2),
    Error("the speed's zero", "speed", ZERO, ""),
    Error("the sideways position of the place whose speed is measured", "speed", ASIDE,
          "mount.lever_arm_m.1"),
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
"""An error, and a condition on which the error may depend."""


def pairs(left: Remains) -> Iterator[Answer]:
    """Yield one answer for each error of a sensor with each condition."""
    forwards, model, table = left.state.forwards, left.state.model, left.table
    if not all(f.has_gravity for f in forwards):
        return  # the road's slope is not removed and correlates with anything
    some = [conditions(f) for f in forwards]
    asked = [
        (error, name)
        for error in ERRORS
        if all(f.drive.has(error.signal) for f in forwards)
        for name in some[0]
        if all(name in each for each in some) and _can_be_asked(error, name)
    ]
    blocks, each = sum(f.blocks for f in forwards), iter(some)
    if not asked or blocks < LEAST_SEGMENTS:
        return
    parts = rows_with(forwards, model, table, lambda f: _added(f, model, asked, next(each)))
    x = np.tile(left.problem.fit(), (blocks, 1))  # differences that fit each segment
    x[table.number] = -left.z[:, 1:]
    # Information of a uniform distribution within a half width.
    prior = np.diag(3.0 / np.maximum(np.abs(table.plausible).max(axis=1), 1e-12) ** 2)
    yield from _answers(asked, *_scores(parts, x, prior), model)


def _can_be_asked(error: Error, condition: str) -> bool:
    """True if an error can be tested with a condition.

    A tyre responds after a distance and not after a time (relaxation length, Pacejka, ch. 5), so in
    every vehicle the delay in turns depends on the speed. A zero error that depends on its own
    signal is a gain error. The condition about time stamps is about the time stamps of the speed.
    """
    if error.kind == ZERO and error.signal == "speed" and condition == SPEEDS[0]:
        return False
    if condition == STAMPS:
        return error.key == DELAY
    if error.kind == ASIDE:
        return condition == TO_ONE_SIDE[0]
    return error.kind != LATE or error.signal == "speed" or condition not in SPEEDS


def may_be(error: Error, condition: str, model: VehicleModel) -> float:
    """Return the error that a correct model file may have, including the error of the equations.
    The error of the equations is left out if only an asymmetric vehicle could cause it under this
    condition."""
    if not error.key:
        # A delayed speed is wrong by the delay times the acceleration.
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
        # At crawling speed, half a km/h is this share.
        half += HALF_KMH / CRAWL_MPS if condition != SPEEDS[0] else 0.0
    return half


# columns -----------------------------------------------------------------------------------------


def _added(
    f: Forward, model: VehicleModel, asked: Sequence[Asked], some: Mapping[str, Array]
) -> Iterator[tuple[dict[str, Array], float]]:
    """Yield the effect of an error that grows by one step over the range of a condition, and this
    step."""
    for error, name in asked:
        step = may_be(error, name, model)
        yield {error.signal: step * (some[name] * _unit(f, error).T).T}, step


def _unit(f: Forward, error: Error) -> Array:
    """Return the effect of a zero error, a gain error or a delay of 1, or of a position 1 m to the
    left: (N,), or (N, 3) along the vehicle's axes."""
    if error.kind == ZERO:
        if error.axis is None:
            return np.ones(len(f.t))
        return np.tile(np.eye(3)[error.axis], (len(f.t), 1))
    if error.kind == ASIDE:
        return f.yaw_rate()
    level = level_of(f, error.signal)
    return level if error.kind == GAIN else np.asarray(-np.gradient(level, STEP_S, axis=0))


# scores ------------------------------------------------------------------------------------------


def _scores(parts: Mapping[str, AddedRows], x: Array, prior: Array) -> tuple[Array, Array]:
    """Return slope and curvature of the loss along each column (B, PARTS, E). The tilt and all
    columns of the catalogue, within their plausible ranges, are projected out first (Frisch and
    Waugh). Slope and curvature are zero for a column that the catalogue explains."""
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
    """Return time series (B, n, E) from coefficients (B, K, E). n is a multiple of `PARTS`."""
    n = -(-a.shape[1] // PARTS) * PARTS
    return np.asarray(idct(a, type=2, axis=1, norm="ortho", n=n))


def _by_part(a: Array, b: Array) -> Array:
    """Return the sums (B, PARTS, E) of the products of two arrays, by part of each block."""
    product = a * b
    return np.asarray(product.reshape(len(a), PARTS, a.shape[1] // PARTS, -1).sum(axis=2))


# answers -----------------------------------------------------------------------------------------


def _answers(asked: Sequence[Asked], u: Array, h: Array, model: VehicleModel) -> Iterator[Answer]:
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
        value, sigma = abs(test.value), test.sigma(scatter)
        size = amount(error.key, test.value) if error.key else f"{test.value:.2g} m/s"
        text = (
            f"{error.text} changes with {condition}: by {size} from one end to the other, "
            f"{sigma:.1f} σ ({value / may:.1f} times the limit of a correct file)"
        )
        yield Answer(
            error.signal, value, may, test.chance(scatter, count), text,
            DELAY if condition == STAMPS else "",
            # The value minus one standard deviation counts, if unseen data confirm it.
            sure=value * (1.0 - 1.0 / max(sigma, 1.0)) if test.gain > SINGLE_NATS else 0.0,
            rare=chance_of_large(may, value / max(sigma, 1e-300), float(count)),
            kind=Kind.WANDERS if condition == STAMPS else "",
        )  # fmt: skip


@dataclass(frozen=True)
class PairTest:
    """Result of one question. over: scatter divided by the scatter of noise alone. free: degrees of
    freedom of `over`. gain: nats on blocks that the fit did not use."""

    value: float
    by_rows: float
    """Size of the effect in standard deviations, computed with the noise of all rows."""
    over: float
    free: float
    gain: float

    def sigma(self, over: float) -> float:
        """Return the size of the effect in standard deviations, computed with a scatter. The result
        is at most the size with the noise of all rows."""
        return self.by_rows / float(np.sqrt(max(over, 1.0)))

    def chance(self, over: float, free: float) -> float:
        """Return the chance of the effect, computed with a scatter that has `free` degrees of
        freedom."""
        by = self.by_rows / float(np.sqrt(max(over, 1e-300)))
        return chance_of_both(by, free, self.by_rows)


def _test(u: Array, h: Array) -> PairTest:
    """Return the result of one question. u, h: (B, PARTS) slope and curvature of the loss.

    One standard deviation is computed from scatter, either between parts of segments or between
    segments; the larger one is used. The degrees of freedom of this standard deviation are the
    effective number of parts or segments. A second standard deviation is computed from the noise of
    all rows.
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
    """Return the size of a sum of slopes u in standard deviations, and the effective number of
    slopes.

    The standard deviation is computed from the scatter of the residuals of single slopes, or of
    slopes with their neighbours. The effective number is (sum h)^2 / sum h^2 (Carter, Schnepel and
    Steigerwald 2017)."""
    scatter = max(float(s[0, 0]) for s in scatters(left.reshape(-1, 1), 1))
    count = max(float(h.sum() ** 2 / (h**2).sum()), 2.0)
    return abs(float(u.sum())) / float(np.sqrt(max(scatter, 1e-300))), count


# conditions --------------------------------------------------------------------------------------


def conditions(f: Forward) -> dict[str, Array]:
    """Return the conditions (N,) by name. Each condition is scaled from -0.5 at the 5th percentile
    to 0.5 at the 95th percentile of the rows in motion."""
    v = f.amount_of_speed()
    moves = v > STANDING_MPS
    if not moves.any():
        return {}
    made = {SPEEDS[0]: v, SPEEDS[1]: np.exp(-v / CRAWL_MPS)}
    made |= _of(_accelerating(f), moves, "acceleration", *EITHER_WAY)
    if f.has_turning:
        made |= _of(_smooth(f.yaw_rate()), moves, "turning", *TO_ONE_SIDE)
    made |= {f"shaking in {x:g} s": shaken(f, x) for x in SHAKEN_S}
    made[f"shaking in {MEMORY_S:g} s"] = _remembered(shaken(f, SHAKEN_S[0]))
    stamps = f.drive.channels["speed"].t
    made[STAMPS] = np.interp(f.t, stamps, off_cycle(stamps))
    ends = {name: np.quantile(x[moves], ENDS) for name, x in made.items()}
    return {
        name: np.clip((x - low) / (high - low), -BEYOND, 1.0 + BEYOND) - 0.5
        for (name, x), (low, high) in zip(made.items(), ends.values(), strict=True)
        if high > low
    }


def _of(x: Array, moves: Mask, what: str, side: str, last_side: str) -> Mapping[str, Array]:
    """Return direction and amount of a quantity (N,), now and in the recent past. The scale is the
    rms of the quantity. last_side: name of the direction of the last value above `LARGE`."""
    z = x / max(float(np.sqrt(np.mean(x[moves] ** 2))), 1e-12)
    rows, amount = np.arange(len(z)), np.abs(z)
    last = np.maximum.accumulate(np.where(amount > LARGE, rows, 0))
    return {
        side: np.tanh(z),
        last_side: np.sign(z[last]),
        f"the amount of {what}": amount,
        f"the amount of {what} in {MEMORY_S:g} s": _remembered(amount),
    }


def _accelerating(f: Forward) -> Array:
    """Return the slope of the speed (N,) [m/s^2]."""
    knots: Channel = f.drive.knots
    slopes = np.diff(knots.values) / np.diff(knots.t)
    return _smooth(np.interp(f.t, 0.5 * (f.knots[1:] + f.knots[:-1]), slopes))


def _smooth(x: Array) -> Array:
    n = round(1.0 / STEP_S)  # manoeuvres last longer than a second
    return np.asarray(np.convolve(x, np.ones(n) / n, "same"))


def _remembered(x: Array) -> Array:
    """Return the mean of the past (N,) with exponential weights. The time constant is
    `MEMORY_S`."""
    share = 1.0 - np.exp(-STEP_S / MEMORY_S)
    made, _ = lfilter([share], [1.0, share - 1.0], x, zi=[x[0] * (1.0 - share)])
    return np.asarray(made)


def shaken(f: Forward, seconds: float) -> Array:
    """Return the mean square (N,) of the accelerometer's differences around each time. The scale is
    such that the smoothest and the roughest twentieth of the drive differ by 1."""
    accel = f.drive.channels["accel"]
    power = np.sum(np.diff(accel.values, axis=0) ** 2, axis=1)
    area = np.concatenate([[0.0], np.cumsum(power)])
    first, last = (np.searchsorted(accel.t[1:], f.t + x * seconds) for x in (-0.5, 0.5))
    mean = (area[last] - area[first]) / np.maximum(last - first, 1)
    low, high = np.quantile(mean, ENDS)
    return np.asarray((mean - low) / max(float(high - low), 1e-12))


def off_cycle(t: Array) -> Array:
    """Return the delay (N,) of time stamps relative to a constant cycle [s]. t: (N,) time stamps
    [s], ascending.

    A cyclic sender gives cyclic time stamps. If time stamps leave the cycle, either the sender left
    the cycle or the clock of the time stamps is wrong. If the delay of the signal follows the time
    stamps, the clock is wrong. Steps are counted in whole cycles, so a lost frame does not delay
    the next frame.
    """
    steps = np.diff(t)
    cycle = float(np.median(steps))
    late = late_steps(steps, cycle)
    late[steps > PAUSE_S] = 0.0  # a sender starts again at any phase of its cycle
    total = np.concatenate([[0.0], np.cumsum(late)])
    line = np.column_stack([np.ones(len(t)), t - t.mean()])
    return np.asarray(total - line @ np.linalg.lstsq(line, total, rcond=None)[0])
