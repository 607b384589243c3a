"""Compare the sensor's axes with the vehicle's motion: scale, delay, handedness."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from imucald.config.base import MAX_SPEED_DELAY
from imucald.config_check.finding import (
    ODD_GAIN,
    Finding,
    gain_guess,
    is_beyond,
    spread,
)
from imucald.config_check.gyro_axes import tilt_findings
from imucald.config_check.motion import Motion, less
from imucald.config_check.relation import Response, relation, response
from imucald.config_check.yaw_rate_check import MIN_TURNING
from imucald.core.angles import DEG_PER_RAD
from imucald.core.arrays import Array
from imucald.motion.ticks import TICK_S
from imucald.mount.contradictions import LIKE, WRONG_UNIT

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
