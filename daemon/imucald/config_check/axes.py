"""Compare the sensor's axes with the vehicle's motion: scale, delay, handedness."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from types import MappingProxyType

import numpy as np

from imucald.config.base import MAX_SPEED_DELAY
from imucald.config_check.finding import (
    ODD_GAIN,
    Finding,
    gain_guess,
    is_beyond,
    sign_remedy,
    spread,
)
from imucald.config_check.gyro_axes import tilt_findings
from imucald.config_check.motion import Motion, less
from imucald.config_check.relation import Response, relation, response
from imucald.core.angles import DEG_PER_RAD
from imucald.core.arrays import Array
from imucald.core.samples import HEADING
from imucald.motion.ticks import TICK_S
from imucald.mount.contradictions import LIKE, UNLIKE, WRONG_UNIT

MIN_TURNING = 0.008
"""Smallest standard deviation of the yaw rate for a comparison [rad/s]: a drive with bends of a
motorway."""
MIN_TURNING_TO_FOLLOW = 0.04
"""A signal that does not show the same turns is reported only if the standard deviation of the yaw
rate is at least this [rad/s], as in city driving."""
OTHER_RATIO = 2.5
"""A larger gain of the steering angle means a wrong unit, even if steering ratio and wheelbase are
not stated. The steering ratio of a truck is up to 1.3 times the steering ratio of a car; the
wheelbase is up to twice as long."""
_STEERING = "steering_wheel_angle"
_BY_SPEED = (_STEERING, "lateral_acceleration", "accelerometer.y")
"""Measurements of the yaw rate that are computed with the speed."""


def sign_findings(
    rates: Mapping[str, Array], turned: Mapping[str, bool] = MappingProxyType({})
) -> Iterator[Finding]:
    """Compare the signs of all measurements of the yaw rate with the first measurement that shows
    turns.

    turned: for each quantity, whether the configuration reverses the signs of all its axes.
    """
    gains = _gains(rates)
    reference = next(iter(gains), "")
    for name, rate in rates.items():
        if name in gains or spread(rate) <= MIN_TURNING or not reference:
            continue
        if name == HEADING.key:  # a course may be late by more than a bend takes
            continue
        found = relation(rates[reference], rate)
        if abs(found.correlation) < UNLIKE and spread(rates[reference]) > MIN_TURNING_TO_FOLLOW:
            text = f"hardly follows {reference} in turns (correlation {found.correlation:+.2f})"
            yield Finding("error", name, text)
    yield from _signs(gains, turned)


def gain_findings(rates: Mapping[str, Array], unit_advice: Mapping[str, str]) -> Iterator[Finding]:
    """Check the gains of all measurements of the yaw rate. The reference is the median gain of
    three or more measurements, or the first of two measurements."""
    sizes = {name: abs(gain) for name, gain in _gains(rates).items()}
    middle = float(np.median(list(sizes.values()))) if len(sizes) > 2 else 1.0
    for name, size in sizes.items():
        if is_beyond(size / middle, OTHER_RATIO if name == _STEERING else WRONG_UNIT):
            others = tuple(other for other in sizes if other != name)
            guess = gain_guess(size / middle, unit_advice.get(name))
            text = f"compared with {', '.join(others)} in turns {guess}"
            if name in _BY_SPEED:
                advice = unit_advice.get("speed")
                text += "; or the unit of the speed is wrong" + (f": {advice}" if advice else "")
            yield Finding("error", name, text, others)


def _gains(rates: Mapping[str, Array]) -> dict[str, float]:
    """Return the gain of each measurement that agrees with the first measurement that shows
    turns."""
    reference, *others = [n for n, rate in rates.items() if spread(rate) > MIN_TURNING] or [""]
    gains = {reference: 1.0} if reference else {}
    for name in others:
        found = relation(rates[reference], rates[name])
        if found.is_same_motion:
            gains[name] = found.sign * found.gain
    return gains


def _signs(gains: Mapping[str, float], turned: Mapping[str, bool]) -> Iterator[Finding]:
    left = [name for name, gain in gains.items() if gain > 0.0]
    right = [name for name, gain in gains.items() if gain <= 0.0]
    if len(gains) < 2:
        return
    if not right:
        names = (f"{n} (with 'sign: -1')" if turned.get(n) else n for n in left[1:])
        text = f"has the same sign in turns as {', '.join(names)}"
        yield Finding("ok", left[0], text, tuple(left[1:]))
    elif len(left) == len(right):
        text = f"has the opposite sign of {', '.join(right)} in turns; left turns must be positive"
        yield Finding("error", left[0], text, tuple(gains))
    else:
        few, many = (left, right) if len(left) < len(right) else (right, left)
        for name in few:
            hint = _sign_hint(name)
            text = f"has the opposite sign of {', '.join(many)} in turns{hint}"
            yield Finding("error", name, text, tuple(gains))


def _sign_hint(name: str) -> str:
    if name == "wheel_speeds":
        return ": left and right may be exchanged"
    if name == "gyroscope":
        return (
            ": set 'sign: -1' on all three of its axes, or on all three axes of the "
            "accelerometer (or remove it if it is set)"
        )
    return f": {sign_remedy(name)}"


MIN_BRAKING = 0.25
"""The response of the accelerometer is judged only if the standard deviation of the acceleration
along the vehicle is at least this [m/s^2], whatever the unit of the speed."""
HANDED = 0.7
"""The handedness of the axes is clear if the magnitude of the triple product of the unit vectors
forward, left and up is above this value."""
UNITS_APART = math.sqrt(DEG_PER_RAD)
"""A gain of a rate beyond this is nearer to a confusion of degrees and radians than to 1."""
LEAST_ACROSS = 0.4
"""The direction left is found only if the accelerometer shows at least this share of the
centripetal acceleration."""
MIN_REPORTED_DELAY = 2
"""Smallest speed delay that is reported [ticks of 0.1 s]."""
MIN_ACROSS = 0.15
"""Smallest standard deviation of the specific force in turns for a judgement [m/s^2]: twice the
effect of road bumps."""


def best_response(motion: Motion, rates: Mapping[str, Array]) -> Response | None:
    """Return the response to changes of speed and to turns; None if it is not clear."""
    found = _response(motion, rates, _shows_turns(rates))
    if found is None or motion.change is None:
        return None
    if found.gain * spread(motion.change) < MIN_BRAKING:
        return None
    return found if found.relation.explained >= LIKE**2 else None


def _response(motion: Motion, rates: Mapping[str, Array], name: str | None) -> Response | None:
    """Return the response to changes of speed and to the turns of the rate `name`, or to changes of
    speed alone; None if a signal is missing."""
    if motion.change is None or motion.accel is None or motion.speed is None or motion.up is None:
        return None
    others = None
    if name is not None:
        zero = motion.turn_zero if name == "gyroscope" else motion.turn_zero[:, :0]
        others = np.column_stack([motion.speed * rates[name], zero])
    return response(motion.accel, motion.up, motion.change, others)


def _shows_turns(rates: Mapping[str, Array]) -> str | None:
    """Return the quantity that is used as yaw rate; None if no signal shows a turn."""
    return next((name for name, rate in rates.items() if spread(rate) > MIN_TURNING), None)


def speed_findings(found: Response, unit_advice: Mapping[str, str]) -> Iterator[Finding]:
    """Check size and delay of the changes of speed against the accelerometer.

    If the speed is noisy or its delay changes, the regression on the speed gives too small a gain.
    The regression on the accelerometer gives too large a gain. The true gain is between both
    (Fuller 1987, 1.1).
    """
    gain, delay = found.gain, found.delay
    if found.relation.low <= 1.0 / ODD_GAIN < found.relation.high:
        text = (
            "its changes are too noisy or too irregular in time to check its scale against "
            "the accelerometer"
        )
        yield Finding("note", "speed", text)
    elif is_beyond(gain, ODD_GAIN):
        guess = gain_guess(1.0 / gain, unit_advice.get("speed"))
        text = f"its changes are {guess} (compared with the accelerometer)"
        yield Finding("error" if is_beyond(gain, WRONG_UNIT) else "warning", "speed", text)
    else:
        text = f"its changes show in the accelerometer (gain {gain:.2f})"
        yield Finding("ok", "speed", text)
    if delay * TICK_S > MAX_SPEED_DELAY:
        text = (
            f"is about {delay * TICK_S:.1f} s behind the accelerometer, and only "
            f"{MAX_SPEED_DELAY} s can be corrected: the calibration learns little from "
            "changes of speed"
        )
        yield Finding("warning", "speed", text)
    elif abs(delay) >= MIN_REPORTED_DELAY:
        word = "behind" if delay > 0 else "ahead of"
        text = f"is about {abs(delay) / 10:.1f} s {word} the accelerometer (this is corrected)"
        yield Finding("note", "speed", text)


def axes_findings(motion: Motion, rates: Mapping[str, Array]) -> Iterator[Finding]:
    """Check whether accelerometer and gyroscope have the same right-handed axes."""
    found = best_response(motion, rates)
    if found is None or motion.up is None:
        return
    in_turns = _response_to_turns(motion, rates)
    if in_turns is None or not is_beyond(in_turns[1], UNITS_APART):  # else its unit is wrong
        yield from tilt_findings(motion.facing(found.forward, found.delay))
    size = float(np.linalg.norm(found.across))
    if size < LEAST_ACROSS:
        return
    handed = float(np.cross(found.forward, found.across) @ motion.up) / size
    if handed < -HANDED:
        turns = _shows_turns(rates)
        text = (
            "its axes are left-handed: one axis has the wrong sign, two axes are exchanged, "
            f"or {turns} has the wrong sign"
        )
        yield Finding("error", "accelerometer", text)
    elif handed > HANDED:
        yield Finding("ok", "accelerometer", "its axes are right-handed")


def turn_gain_findings(
    motion: Motion, rates: Mapping[str, Array], unit_advice: Mapping[str, str]
) -> Iterator[Finding]:
    """Compare speed times yaw rate with the lateral specific force. This check is for drives in
    which only the gyroscope shows turns."""
    in_turns = _response_to_turns(motion, rates) if list(rates) == ["gyroscope"] else None
    if in_turns is None or not is_beyond(in_turns[1], WRONG_UNIT):
        return
    found, size = in_turns
    guess = gain_guess(1.0 / size, unit_advice.get("gyroscope"))
    text = f"compared with the lateral force in turns, its product with the speed is {guess}"
    if found.relation.explained < LIKE**2:  # nothing has confirmed the unit of the speed
        text += "; or the unit of the speed is wrong"
    yield Finding("error", "gyroscope", text)


def _response_to_turns(motion: Motion, rates: Mapping[str, Array]) -> tuple[Response, float] | None:
    """Return the response to the turns that the gyroscope shows, and the lateral force divided by
    speed times yaw rate; None if the force does not show these turns."""
    found = _response(motion, rates, "gyroscope") if "gyroscope" in rates else None
    if found is None or motion.accel is None or motion.speed is None:
        return None
    size = float(np.linalg.norm(found.across))
    if not size > 0.0:
        return None
    force = motion.accel @ (found.across / size)
    turn = less(motion.speed * rates["gyroscope"], motion.turn_zero)
    if spread(force) < MIN_ACROSS or not relation(turn, force).is_same_motion:
        return None
    return found, size
