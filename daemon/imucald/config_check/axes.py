"""The sensor's axes against the vehicle's motion: scale, delay, handedness."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from imucald.config.base import MAX_SPEED_DELAY, MIN_SPEED_DELAY
from imucald.config_check.finding import (
    MIN_TICKS,
    ODD_GAIN,
    Finding,
    gain_guess,
    is_beyond,
    spread,
)
from imucald.config_check.motion import Motion, less, shifted, smooth
from imucald.config_check.relation import relation
from imucald.config_check.yaw_rate_check import MIN_TURNING
from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.contradictions import LIKE, MOVING, WRONG_UNIT
from imucald.mount.gyro_alternatives import TRIED, gyro_energies, ratios_of
from imucald.mount.log_ratios import MOST, TO_ACCUSE, TO_BE_FINE
from imucald.mount.signal_blocks import BLOCK_TICKS

MIN_BRAKING = 0.25
"""Least standard deviation of the change of speed for a judgement [m/s^2]."""
AXIS_DEG = 20.0
"""Largest plausible angle between a gyroscope's axis in turns and gravity [deg]: body roll and
cross-axis errors make a few."""
HANDED = 0.7
"""Triple product of the unit vectors forward, left and up from which their sense is clear."""
NO_SPEED = 5.0
"""A gain beyond this is none between two units of speed on a road: 3.6 is the largest."""
LEAST_ACROSS = 0.4
"""So much of the centripetal acceleration must show in the accelerometer to say where left is."""
MIN_REPORTED_DELAY = 2
"""Ticks of speed delay from which it is reported."""
MIN_ACROSS = 0.15
"""Least standard deviation of the force in turns [m/s^2]: twice what crowns and slopes leave."""
LATEST = 2.5
"""Delay of the speed up to which its size is judged [s]: a receiver that smooths, is asked once a
second, and whose answer waits."""
_DELAYS = range(round(MIN_SPEED_DELAY / TICK_S), round(LATEST / TICK_S) + 1)
"""[ticks]"""


@dataclass(frozen=True)
class Response:
    """What the accelerometer's axes (3,) show of changes of speed and of turns.

    explained: part of the motion along `along` that the change of speed explains. delay: of the
    speed behind the accelerometer [ticks].
    """

    along: Array
    across: Array
    explained: float
    delay: int


def _response(accel: Array, change: Array, turn: Array, zero: Array, delay: int) -> Response | None:
    """Least squares of the axes on change of speed and centripetal acceleration.

    zero: (n, k), what a zero error of the rate adds to `turn`: columns that are fitted too.
    """
    change = shifted(change, delay)
    rows = np.isfinite(accel).all(axis=1) & np.isfinite(change) & np.isfinite(turn)
    rows &= np.isfinite(zero).all(axis=1)
    if np.count_nonzero(rows) < MIN_TICKS or float(np.std(change[rows])) < MIN_BRAKING:
        return None
    known = np.column_stack([change[rows], turn[rows], zero[rows], np.ones(np.count_nonzero(rows))])
    coefficients, *_ = np.linalg.lstsq(known, accel[rows], rcond=None)
    along, across = coefficients[0], coefficients[1]
    if not np.linalg.norm(along) > 0.0:
        return None
    direction = along / np.linalg.norm(along)
    rest = (accel[rows] - known[:, 1:-1] @ coefficients[1:-1]) @ direction
    correlation = float(np.corrcoef(rest, change[rows])[0, 1])
    return Response(along, across, correlation * correlation, delay)


def best_response(motion: Motion, rates: Mapping[str, Array]) -> Response | None:
    """The response with the delay that explains most; None where it is not clear.

    `discovery.reference.response` asks it of speeds in any unit before turns are known.
    """
    if motion.change is None or motion.accel is None or motion.speed is None:
        return None
    name = next((name for name, r in rates.items() if spread(r) > MIN_TURNING), None)
    turn = np.zeros_like(motion.speed) if name is None else motion.speed * rates[name]
    zero = motion.turn_zero if name == "gyroscope" else motion.turn_zero[:, :0]
    fits = [_response(motion.accel, motion.change, turn, zero, delay) for delay in _DELAYS]
    best = max((fit for fit in fits if fit is not None), key=lambda f: f.explained, default=None)
    return best if best is not None and best.explained >= LIKE**2 else None


def speed_findings(response: Response, unit_advice: Mapping[str, str]) -> Iterator[Finding]:
    """Whether changes of speed show in the accelerometer as they should, and how late.

    The regression on the speed is too small where the speed is noisy or its delay changes, the
    other one (on the accelerometer) too large: the gain lies between both (Fuller 1987, 1.1).
    """
    gain, delay = float(np.linalg.norm(response.along)), response.delay
    if gain <= 1.0 / ODD_GAIN < gain / response.explained:
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


def axes_findings(
    motion: Motion, rates: Mapping[str, Array], unit_advice: Mapping[str, str]
) -> Iterator[Finding]:
    """Whether accelerometer and gyroscope make sense as right-handed sets of the same axes."""
    up = motion.up
    if up is None:
        return
    yield from _rotation_axis(motion, rates, up)
    response = best_response(motion, rates)
    if list(rates) == ["gyroscope"]:
        yield from _turn_gain(motion, rates["gyroscope"], up, unit_advice, response is not None)
    if response is None or np.linalg.norm(response.across) < LEAST_ACROSS:
        return
    yield from _gyro_axes(motion, response, up)
    along, across = response.along, response.across
    handed = float(np.cross(along, across) @ up / np.linalg.norm(along) / np.linalg.norm(across))
    if handed < -HANDED:
        text = (
            "its axes are left-handed: one axis has the wrong sign, two axes are exchanged, "
            "or the turn rate has the wrong sign"
        )
        yield Finding("error", "accelerometer", text)
    elif handed > HANDED:
        yield Finding("ok", "accelerometer", "its axes are right-handed")


def _turn_gain(
    motion: Motion, rate: Array, up: Array, unit_advice: Mapping[str, str], knows_speed: bool
) -> Iterator[Finding]:
    """Speed times yaw rate against the force across, where nothing else shows turns.

    knows_speed: its changes have shown its unit, or it was allowed for.
    """
    if motion.speed is None or motion.accel is None or motion.gravity is None:
        return
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
    text = f"{product} is {guess} (compared with the force in turns)"
    yield Finding(
        "error", name, text if knows_speed else f"{text}; or the unit of the {other} is wrong"
    )


def _gyro_axes(motion: Motion, response: Response, up: Array) -> Iterator[Finding]:
    """Whether the gyroscope carries the vertical as the accelerometer shows it (`alternatives`)."""
    if "gyro" not in motion.grid or motion.speed is None or motion.change is None:
        return
    accel, rate = motion.accel, smooth(motion.grid["gyro"])
    if accel is None or motion.gravity is None:
        return
    left = np.cross(up, response.along)
    left /= np.linalg.norm(left)
    R = np.array([np.cross(left, up), left, up])
    force = (accel - motion.gravity) @ R.T
    change = shifted(motion.change, response.delay)
    columns = np.column_stack([force[:, :2], change, motion.speed, rate])
    blocks = [
        block
        for block in np.array_split(columns, max(len(columns) // BLOCK_TICKS, 1))
        if np.isfinite(block).all() and np.abs(block[:, 3]).min() > MOVING
    ]
    if not blocks:
        return
    zeros = _gyro_zeros(motion, rate, np.concatenate(blocks)[:, 4:], up)
    total = np.zeros(len(TRIED) - 1)
    for block in blocks:
        ahead = (block[:, 0] - block[:, 2]) / GRAVITY
        left_over = [
            gyro_energies(ahead, block[:, 1] / GRAVITY, block[:, 4:] - zero, block[:, 3], R)[k]
            for k, zero in enumerate(zeros)
        ]
        total += np.clip(ratios_of(np.array(left_over)), -MOST, MOST)
    if total.min() < -TO_ACCUSE:
        text = (
            "does not tilt as the accelerometer does: one axis of the gyroscope or of the "
            "accelerometer has the wrong sign, two axes are exchanged, or the sensor moves "
            "in its holder"
        )
        yield Finding("error", "gyroscope", text)
    elif total.min() > TO_BE_FINE:
        yield Finding("ok", "gyroscope", "tilts as the accelerometer does")
    elif motion.standing is None:
        text = (
            "not checked: the sign of each axis of the gyroscope (the drive has no stop, so "
            "its zero error is unknown)"
        )
        yield Finding("note", "check", text)


def _gyro_zeros(motion: Motion, rate: Array, moving: Array, up: Array) -> list[Array]:
    """The gyroscope's zero error (3,) [rad/s] for each order and signs of its axes that are tried.

    rate, moving: (n, 3), of the whole drive and of what is judged. At rest it is what is read. In a
    drive without a stop it is fitted to each alternative: about the level axes a vehicle turns by
    nothing on the whole, whatever it turns about the vertical, so their mean is the zero error.
    """
    if motion.standing is not None:
        n = min(len(rate), len(motion.standing))
        return [np.nanmean(rate[:n][motion.standing[:n]], axis=0)] * len(TRIED)
    level = np.eye(3) - np.outer(up, up)
    return [S.T @ level @ S @ moving.mean(axis=0) for S in TRIED]


def _rotation_axis(motion: Motion, rates: Mapping[str, Array], up: Array) -> Iterator[Finding]:
    """In turns a gyroscope turns about the direction that the accelerometer calls up.

    Another question than `turning_axis`: the axis is seen in all three rates, next to a signal that
    shows turns, where a force in bends shows only which rate it follows.
    """
    names = [n for n, rate in rates.items() if n != "gyroscope" and spread(rate) > MIN_TURNING]
    if "gyro" not in motion.grid or not names:
        return
    rate, gyro = rates[names[0]], smooth(motion.grid["gyro"])
    rows = np.isfinite(rate) & np.isfinite(gyro).all(axis=1)
    if np.count_nonzero(rows) < MIN_TICKS:
        return
    axis = np.cov(gyro[rows].T, rate[rows])[3, :3]
    aligned = abs(float(axis @ up)) / max(float(np.linalg.norm(axis)), 1e-12)
    angle = math.degrees(math.acos(min(aligned, 1.0)))
    if angle > AXIS_DEG and relation(gyro @ axis, rate).is_same_motion:
        text = (
            f"turns about an axis that is {angle:.0f} deg off the vertical: one axis of the "
            "gyroscope or of the accelerometer has the wrong sign, or two axes are exchanged"
        )
        yield Finding("error", "gyroscope", text)
