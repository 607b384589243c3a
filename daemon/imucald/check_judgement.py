"""What is suspicious in the signals of a drive: units, signs, axes; for `imucald check`.

Every judgement needs enough motion and a clear correlation, and stays silent without. Thresholds
are wide: squat, superelevation and offsets change a gain by a third, a wrong unit by over 2.5.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from imucald.check_motion import Motion, shifted, smooth
from imucald.samples import GRAVITY

Array = NDArray[np.float64]
Level = Literal["error", "warning", "note", "ok"]

FEWEST = 200
"""Ticks in motion that a judgement needs: 20 s."""
LEAST_TURNING = 0.008
"""Least standard deviation of the yaw rate for a judgement [rad/s]: bends of a motorway."""
MUCH_TURNING = 0.04
"""The same from which a signal that does not follow is told [rad/s]: a city."""
LEAST_BRAKING = 0.25
"""Least standard deviation of the change of speed for a judgement [m/s^2]."""
CLEAR = 0.6
"""Correlation from which two signals are taken to show the same motion."""
WRONG_GAIN = 2.5
"""A gain beyond this (or below its inverse) is a unit, not a vehicle."""
REST_WRONG, REST_ODD = 0.25, 0.03
"""Parts by which gravity at rest may be off before it is a wrong unit, or worth a word."""
PLANAR_REST = 1.5
"""What a level accelerometer may show at rest [m/s^2]: slope and offset."""
GYRO_REST = math.radians(5.0)
"""Largest plausible gyro offset at rest [rad/s]."""
AXIS_DEG = 20.0
"""Largest plausible angle between a gyroscope's axis in turns and gravity [deg]: body roll and
cross-axis errors make a few."""
HANDED = 0.7
"""Triple product of the unit vectors forward, left and up from which their sense is clear."""
WORTH_TELLING_DELAY = 2
"""Ticks of speed delay from which it is told."""
MAX_DELAY = 12
"""Ticks: a speed is up to 1.2 s late."""

REVERSE_SPEED = 5.0
"""Nobody reverses faster for long [m/s]."""
REVERSE_SHARE = 0.1
"""Part of the time above that speed that reverse may be on: a lever passing by."""
FEWEST_BRAKING = 50
"""Ticks with and without brake that a judgement of it needs: 5 s."""

_FACTORS = (
    (180.0 / math.pi, "deg against rad"),
    (GRAVITY, "g against m/s²"),
    (3.6, "km/h against m/s"),
    (1.0 / 0.44704, "mph against m/s"),
    (1.609344, "mph against km/h"),
    (1000.0, "thousandths"),
)


@dataclass(frozen=True)
class Finding:
    """One thing to tell; `quantity` as in the configuration."""

    level: Level
    quantity: str
    text: str

    def as_dict(self) -> dict[str, str]:
        """Plain, for JSON."""
        return {"level": self.level, "quantity": self.quantity, "text": self.text}


def judge(
    motion: Motion, track: float, wheelbase: float, steering_ratio: float
) -> Iterator[Finding]:
    """Yield everything that the motion tells about units, signs and axes.

    A wrong scale of accelerometer or speed is told once and then allowed for, so that it is not
    told again of every signal that is compared with them.
    """
    yield from _at_rest(motion)
    backwards = list(_reverse(motion))
    if backwards:
        yield from backwards
        motion = motion.without("reverse")
    if not motion.planar and motion.gravity is not None:
        motion = motion.scaled(accel=GRAVITY / float(np.linalg.norm(motion.gravity)))
        response = _best_response(motion, motion.turn_rates(track, wheelbase, steering_ratio))
        if response is not None:
            gain = float(np.linalg.norm(response.along))
            yield from _speed(gain, response.delay)
            if _wrong(gain):
                motion = motion.scaled(speed=gain)
    rates = motion.turn_rates(track, wheelbase, steering_ratio)
    yield from _turns(rates)
    yield from _along(motion)
    if not motion.planar:
        yield from _axes(motion, rates)
    yield from _brake(motion)


def _wrong(gain: float) -> bool:
    """Whether a gain that should be one is a wrong unit."""
    return not 1.0 / WRONG_GAIN < abs(gain) < WRONG_GAIN


# at rest ---------------------------------------------------------------------------------------


def _at_rest(motion: Motion) -> Iterator[Finding]:
    gravity = motion.gravity
    if gravity is None or motion.accel is None:
        return
    when = "at rest" if motion.standing is not None else "on average"
    if motion.planar:
        level = float(np.hypot(gravity[0], gravity[1]))
        if motion.standing is not None and level > PLANAR_REST:
            text = f"shows {level:.2f} m/s² {when}; without z it must be level: wrong axes or unit?"
            yield Finding("warning", "accelerometer", text)
        return
    size = float(np.linalg.norm(gravity))
    ratio = size / GRAVITY
    text = f"{size:.2f} m/s² {when} (gravity is {GRAVITY:.2f})"
    if abs(ratio - 1.0) > REST_WRONG:
        yield Finding("error", "accelerometer", f"{text}: {_gain_guess(ratio)}")
    elif abs(ratio - 1.0) > REST_ODD:
        yield Finding("warning", "accelerometer", f"{text}: scale or a large bias?")
    else:
        yield Finding("ok", "accelerometer", text)
    gyro = motion.grid.get("gyro")
    if gyro is not None and motion.standing is not None:
        n = min(len(gyro), len(motion.standing))
        resting = gyro[:n][motion.standing[:n]]
        resting = resting[np.isfinite(resting).all(axis=1)]
        offset = float(np.linalg.norm(resting.mean(axis=0))) if len(resting) else 0.0
        if offset > GYRO_REST:
            text = f"turns at {math.degrees(offset):.1f} deg/s at rest: wrong unit or offset?"
            yield Finding("warning", "gyroscope", text)


def _gain_guess(ratio: float) -> str:
    """Words for a gain that should be one."""
    size = abs(ratio)
    words = f"{size:.3g} times too much" if size > 1.0 else f"{1.0 / size:.3g} times too little"
    for factor, guess in _FACTORS:
        if abs(math.log(max(size, 1.0 / size) / factor)) < math.log(1.15):
            return f"{words}, as {guess} would be; set 'unit:'"
    return f"{words}; check its unit and scale"


# turns -----------------------------------------------------------------------------------------


def _turns(rates: Mapping[str, Array]) -> Iterator[Finding]:
    """Compare all witnesses of the yaw rate with the first one that turns."""
    names = [name for name, rate in rates.items() if _spread(rate) > LEAST_TURNING]
    if len(names) < 2:
        return
    reference, *others = names
    gains = {reference: 1.0}
    for name in others:
        gain, correlation = _gain(rates[reference], rates[name])
        if abs(correlation) >= CLEAR:
            gains[name] = gain
        elif abs(correlation) < CLEAR / 2.0 and _spread(rates[reference]) > MUCH_TURNING:
            text = f"hardly follows {reference} in turns (correlation {correlation:+.2f})"
            yield Finding("warning", name, text)
    yield from _signs(gains)
    yield from _gains(gains)


def _gains(gains: Mapping[str, float]) -> Iterator[Finding]:
    """Of three witnesses or more the middle one is believed; of two the first."""
    sizes = {name: abs(gain) for name, gain in gains.items()}
    middle = float(np.median(list(sizes.values()))) if len(sizes) > 2 else 1.0
    for name, size in sizes.items():
        if _wrong(size / middle):
            against = ", ".join(other for other in sizes if other != name)
            text = f"against {against} in turns {_gain_guess(size / middle)}"
            yield Finding("warning", name, text)


def _signs(gains: Mapping[str, float]) -> Iterator[Finding]:
    left = [name for name, gain in gains.items() if gain > 0.0]
    right = [name for name, gain in gains.items() if gain <= 0.0]
    if len(gains) < 2:
        return
    if not right:
        yield Finding("ok", left[0], f"turns the same way as {', '.join(left[1:])}")
    elif len(left) == len(right):
        text = f"has the opposite sign of {', '.join(right)} in turns; positive must be to the left"
        yield Finding("warning", left[0], text)
    else:
        few, many = (left, right) if len(left) < len(right) else (right, left)
        for name in few:
            hint = _sign_hint(name)
            text = f"has the opposite sign of {', '.join(many)} in turns{hint}"
            yield Finding("warning", name, text)


def _sign_hint(name: str) -> str:
    if name == "wheel_speeds":
        return ": are left and right exchanged?"
    if name == "gyroscope":
        return ": all three axes need 'sign: -1', or the accelerometer's do"
    return ": positive is to the left; set 'sign: -1'"


# along -----------------------------------------------------------------------------------------


def _along(motion: Motion) -> Iterator[Finding]:
    """Signals that must follow the change of speed."""
    if motion.change is None or _spread(motion.change) < LEAST_BRAKING:
        return
    signals = {}
    if "longitudinal_accel" in motion.grid:
        signals["longitudinal_acceleration"] = motion.grid["longitudinal_accel"]
    if motion.planar and motion.accel is not None:
        signals["accelerometer.x"] = motion.accel[:, 0]
    for name, signal in signals.items():
        gain, correlation = _gain(motion.change, signal)
        if abs(correlation) < CLEAR:
            continue
        if gain < 0.0 and name == "accelerometer.x":
            text = "is negative when the vehicle accelerates: backwards mounted, or 'sign: -1'"
            yield Finding("warning", name, text)
        elif gain < 0.0:
            text = "is negative when the vehicle accelerates; set 'sign: -1'"
            yield Finding("warning", name, text)
        elif _wrong(gain):
            text = f"against the change of speed {_gain_guess(gain)}"
            yield Finding("warning", name, text)
        else:
            yield Finding("ok", name, f"follows the change of speed (gain {gain:.2f})")


def _speed(gain: float, delay: int) -> Iterator[Finding]:
    """Whether changes of speed show in the accelerometer as they should, and how late."""
    if _wrong(gain):
        text = f"its changes are {_gain_guess(1.0 / gain)} (against the accelerometer)"
        yield Finding("warning", "speed", text)
    else:
        text = f"its changes show in the accelerometer (gain {gain:.2f})"
        yield Finding("ok", "speed", text)
    if abs(delay) >= WORTH_TELLING_DELAY:
        word = "behind" if delay > 0 else "ahead of"
        text = f"is about {abs(delay) / 10:.1f} s {word} the accelerometer (this is allowed for)"
        yield Finding("note", "speed", text)


def _axes(motion: Motion, rates: Mapping[str, Array]) -> Iterator[Finding]:
    """Whether accelerometer and gyroscope make sense as right-handed sets of the same axes."""
    up = motion.up
    if up is None:
        return
    yield from _rotation_axis(motion, rates, up)
    response = _best_response(motion, rates)
    if response is None or np.linalg.norm(response.across) < 1.0 / WRONG_GAIN:
        return
    along, across = response.along, response.across
    handed = float(np.cross(along, across) @ up / np.linalg.norm(along) / np.linalg.norm(across))
    if handed < -HANDED:
        text = (
            "forward, left and up are a left-handed set: one axis has the wrong sign, two are "
            "exchanged, or the turn rate has the wrong sign"
        )
        yield Finding("warning", "accelerometer", text)
    elif handed > HANDED:
        yield Finding("ok", "accelerometer", "forward, left and up are a right-handed set")


def _rotation_axis(motion: Motion, rates: Mapping[str, Array], up: Array) -> Iterator[Finding]:
    """In turns a gyroscope turns about the direction that the accelerometer calls up."""
    names = [n for n, rate in rates.items() if n != "gyroscope" and _spread(rate) > LEAST_TURNING]
    if "gyro" not in motion.grid or not names:
        return
    rate, gyro = rates[names[0]], smooth(motion.grid["gyro"])
    rows = np.isfinite(rate) & np.isfinite(gyro).all(axis=1)
    if np.count_nonzero(rows) < FEWEST:
        return
    axis = np.cov(gyro[rows].T, rate[rows])[3, :3]
    aligned = abs(float(axis @ up)) / max(float(np.linalg.norm(axis)), 1e-12)
    angle = math.degrees(math.acos(min(aligned, 1.0)))
    if angle > AXIS_DEG and abs(_gain(gyro @ axis, rate)[1]) > CLEAR:
        text = (
            f"turns about an axis {angle:.0f} deg from gravity's: one of its axes (or of the "
            "accelerometer's) has the wrong sign, or two are exchanged"
        )
        yield Finding("warning", "gyroscope", text)


def _best_response(motion: Motion, rates: Mapping[str, Array]) -> _Response | None:
    """The response with the delay that explains most; None where it is not clear."""
    if motion.change is None or motion.accel is None or motion.speed is None:
        return None
    reference = next((r for r in rates.values() if _spread(r) > LEAST_TURNING), None)
    turn = np.zeros_like(motion.speed) if reference is None else motion.speed * reference
    fits = [_response(motion.accel, motion.change, turn, delay) for delay in _DELAYS]
    best = max((fit for fit in fits if fit is not None), key=lambda f: f.explained, default=None)
    return best if best is not None and best.explained >= CLEAR**2 else None


_DELAYS = range(-MAX_DELAY // 2, MAX_DELAY + 1)


@dataclass(frozen=True)
class _Response:
    """What the accelerometer's axes (3,) show of changes of speed and of turns.

    explained: part of the motion along `along` that the change of speed explains. delay: of the
    speed behind the accelerometer [ticks].
    """

    along: Array
    across: Array
    explained: float
    delay: int


def _response(accel: Array, change: Array, turn: Array, delay: int) -> _Response | None:
    """Least squares of the axes on change of speed and centripetal acceleration."""
    change = shifted(change, delay)
    rows = np.isfinite(accel).all(axis=1) & np.isfinite(change) & np.isfinite(turn)
    if np.count_nonzero(rows) < FEWEST or float(np.std(change[rows])) < LEAST_BRAKING:
        return None
    known = np.column_stack([change[rows], turn[rows], np.ones(np.count_nonzero(rows))])
    coefficients, *_ = np.linalg.lstsq(known, accel[rows], rcond=None)
    along, across = coefficients[0], coefficients[1]
    if not np.linalg.norm(along) > 0.0:
        return None
    direction = along / np.linalg.norm(along)
    rest = (accel[rows] - np.outer(turn[rows], across)) @ direction
    correlation = float(np.corrcoef(rest, change[rows])[0, 1])
    return _Response(along, across, correlation * correlation, delay)


# switches --------------------------------------------------------------------------------------


def _reverse(motion: Motion) -> Iterator[Finding]:
    if motion.speed is None or "reverse" not in motion.grid:
        return
    fast = np.nan_to_num(np.abs(motion.speed)) > REVERSE_SPEED
    reverse = motion.grid["reverse"][fast]
    share = float(np.mean(reverse > 0.5)) if len(reverse) >= FEWEST else 0.0
    if share > REVERSE_SHARE:
        text = f"is on for {100 * share:.0f} % of the time above 18 km/h: see 'equals:'"
        yield Finding("warning", "reverse", text)


def _brake(motion: Motion) -> Iterator[Finding]:
    if motion.speed is None or motion.change is None or "brake" not in motion.grid:
        return
    moving = (np.nan_to_num(np.abs(motion.speed)) > 1.0) & np.isfinite(motion.change)
    brake = motion.grid["brake"] > 0.5
    on, off = motion.change[moving & brake], motion.change[moving & ~brake]
    if min(len(on), len(off)) >= FEWEST_BRAKING and on.mean() > off.mean() + 0.1:
        text = "is on when the vehicle accelerates: see 'equals:' and 'above:'"
        yield Finding("warning", "brake", text)


# arithmetic ------------------------------------------------------------------------------------


def _spread(x: Array) -> float:
    known = x[np.isfinite(x)]
    return float(np.std(known)) if len(known) >= FEWEST else 0.0


def _gain(reference: Array, signal: Array) -> tuple[float, float]:
    """How many times the reference the signal is, with sign, and the correlation.

    The gain is the ratio of spreads: noise in either of them moves it less than a regression.
    """
    rows = np.isfinite(reference) & np.isfinite(signal)
    if np.count_nonzero(rows) < FEWEST:
        return 1.0, 0.0
    a, b = reference[rows], signal[rows]
    if np.std(a) == 0.0 or np.std(b) == 0.0:
        return 1.0, 0.0
    correlation = float(np.corrcoef(a, b)[0, 1])
    return math.copysign(float(np.std(b) / np.std(a)), correlation), correlation
