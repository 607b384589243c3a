"""Compare the sensor's axes with the vehicle's motion: scale, delay, handedness."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from imucald.config.base import MAX_SPEED_DELAY
from imucald.config_check.finding import (
    MIN_TICKS,
    ODD_GAIN,
    Finding,
    gain_guess,
    is_beyond,
    spread,
)
from imucald.config_check.gyro_axes import tilt_findings
from imucald.config_check.motion import Motion, less
from imucald.config_check.relation import relation
from imucald.config_check.response import Response, response
from imucald.config_check.yaw_rate_check import MIN_TURNING
from imucald.core.arrays import Array
from imucald.motion.ticks import TICK_S
from imucald.mount.contradictions import LIKE, WRONG_UNIT

MIN_BRAKING = 0.25
"""The response of the accelerometer is judged only if the standard deviation of dv/dt is at least
this [m/s^2]."""
HANDED = 0.7
"""The handedness of the axes is clear if the magnitude of the triple product of the unit vectors
forward, left and up is above this value."""
NO_SPEED = 5.0
"""A gain above this value cannot be caused by a wrong unit of speed, because the largest ratio of
two units is 3.6."""
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
    if motion.change is None or motion.accel is None or motion.speed is None or motion.up is None:
        return None
    if spread(motion.change) < MIN_BRAKING:
        return None
    name = _shows_turns(rates)
    others = None
    if name is not None:
        zero = motion.turn_zero if name == "gyroscope" else motion.turn_zero[:, :0]
        others = np.column_stack([motion.speed * rates[name], zero])
    found = response(motion.accel, motion.up, motion.change, others)
    return found if found is not None and found.relation.explained >= LIKE**2 else None


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
    up = motion.up
    if list(rates) != ["gyroscope"] or up is None:
        return
    if motion.speed is None or motion.accel is None or motion.gravity is None:
        return
    rate = rates["gyroscope"]
    # the unit of the speed was confirmed by its changes, or it was corrected
    knows_speed = best_response(motion, rates) is not None
    n = min(len(rate), len(motion.speed), len(motion.accel))
    turn = motion.speed[:n] * rate[:n]
    level = (motion.accel[:n] - motion.gravity) @ (np.eye(3) - np.outer(up, up))
    turn = less(turn, motion.turn_zero[:n])
    rows = np.isfinite(turn) & np.isfinite(level).all(axis=1)
    if np.count_nonzero(rows) < MIN_TICKS or float(np.std(turn[rows])) == 0.0:
        return
    both = np.cov(level[rows].T, turn[rows])
    across = both[3, :3] / both[3, 3]
    force, size = level[rows] @ across, float(np.linalg.norm(across))
    if float(np.std(force)) < MIN_ACROSS * size or not relation(turn[rows], force).is_same_motion:
        return
    if not is_beyond(size, WRONG_UNIT):
        return
    if knows_speed or is_beyond(size, NO_SPEED):
        name, product, other = "gyroscope", "its product with the speed", "speed"
    else:
        name, product, other = "speed", "its product with the gyroscope's rate", "gyroscope"
    guess = gain_guess(1.0 / size, unit_advice.get(name))
    text = f"compared with the lateral force in turns, {product} is {guess}"
    yield Finding(
        "error", name, text if knows_speed else f"{text}; or the unit of the {other} is wrong"
    )
