"""What is suspicious in the signals of a drive: units, signs, axes; for `imucald check`.

Every judgement needs enough motion and a clear correlation, and stays silent without. Thresholds
are wide: squat, superelevation and offsets change a gain by a third, a wrong unit by over 2.5.
Miles for kilometres are less: speed is held against a narrower one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from imucald.config.calibration import OrientationSettings, SensorAxis
from imucald.config_check.axes import (
    MIN_BRAKING,
    OTHER_UNIT,
    Response,
    axes_findings,
    best_response,
    speed_findings,
)
from imucald.config_check.finding import (
    CLEAR,
    MIN_TICKS,
    Array,
    Finding,
    gain_between,
    gain_guess,
    is_wrong,
    spread,
)
from imucald.config_check.motion import Motion, smooth
from imucald.config_check.turning_axis import turning_axis_findings
from imucald.config_check.yaw_rate_check import MIN_TURNING, yaw_rate_findings
from imucald.core.samples import GRAVITY
from imucald.mount.alternatives import NOT_CHECKED
from imucald.mount.stated_orientation import CLEAR as CLEAR_PART
from imucald.mount.stated_orientation import unit_vector

REST_WRONG, REST_ODD = 0.25, 0.03
"""Parts by which gravity at rest may be off before it is a wrong unit, or worth a word."""
PLANAR_REST = 1.5
"""What a level accelerometer may show at rest [m/s^2]: slope and offset."""
GYRO_REST = math.radians(5.0)
"""Largest plausible gyro offset at rest [rad/s]."""
REVERSE_SPEED = 5.0
"""Nobody reverses faster for long [m/s]."""
REVERSE_SHARE = 0.1
"""Part of the time above that speed that reverse may be on: a lever passing by."""
WHEELS_DIFFER = 0.1
"""Part by which the speed may differ from the wheels': worn and wrong tyres make 5 %, displays show
up to 10 % more (UN R39)."""
MIN_BRAKING_TICKS = 50
"""Ticks with and without brake that a judgement of it needs: 5 s."""

NOT_STATED = OrientationSettings()


def judge(
    motion: Motion,
    track: float,
    wheelbase: float,
    steering_ratio: float,
    stated: OrientationSettings = NOT_STATED,
) -> Iterator[Finding]:
    """Yield everything that the motion shows about units, signs and axes.

    A wrong scale of accelerometer or speed is reported once and then allowed for, so that it is not
    reported again for every signal that is compared with them. stated: how a person says that the
    sensor sits.
    """
    yield from _at_rest(motion)
    of_up = list(_up(motion, stated.up))
    yield from of_up
    backwards = list(_reverse(motion))
    if backwards:
        yield from backwards
        motion = motion.without("reverse")
    is_scaled = False
    if not motion.planar and motion.gravity is not None:
        motion = motion.scaled(accel=GRAVITY / float(np.linalg.norm(motion.gravity)))
        response = best_response(motion, motion.turn_rates(track, wheelbase, steering_ratio))
        if response is not None:
            yield from speed_findings(response)
            if not any(finding.level == "error" for finding in of_up):  # that is the mirror image
                yield from _forward(response, stated.forward)
            gain = float(np.linalg.norm(response.along))
            if is_wrong(gain):
                motion = motion.scaled(speed=gain)
                is_scaled = True
    rates = motion.turn_rates(track, wheelbase, steering_ratio)
    yield from yaw_rate_findings(rates)
    yield from _along(motion)
    if not motion.planar:
        yield from axes_findings(motion, rates)
        yield from turning_axis_findings(motion)
    yield from (f for f in _speed_against_wheels(motion) if not (is_scaled and f.level == "ok"))
    yield from _brake(motion)
    yield from _not_checked(motion, rates, stated)


def _up(motion: Motion, up: SensorAxis | None) -> Iterator[Finding]:
    """Whether gravity is where a person says that it is."""
    if up is None or motion.up is None or motion.planar:
        return
    part = float(motion.up @ unit_vector(up))
    if part < -CLEAR_PART:
        text = f"its {up} points down, and 'calibration: orientation' says up: "
        yield Finding("error", "accelerometer", f"{text}'sign: -1' on all axes, or that line")
    elif part > CLEAR_PART:
        yield Finding("ok", "accelerometer", f"its {up} points up, as 'orientation' says")
    else:
        text = f"'calibration: orientation' says {up}, which lies nearly level: name another axis"
        yield Finding("warning", "accelerometer", text)


def _forward(response: Response, forward: SensorAxis | None) -> Iterator[Finding]:
    """Whether the force of a rising speed is where a person says that forward is."""
    if forward is None:
        return
    ahead = response.along / np.linalg.norm(response.along)
    part = float(ahead @ unit_vector(forward))
    if part < -CLEAR_PART:
        text = f"its {forward} points back, and 'calibration: orientation' says forward: {forward}"
        yield Finding("error", "accelerometer", f"{text}; correct that line")
    elif part > CLEAR_PART:
        yield Finding("ok", "accelerometer", f"its {forward} points forward, as 'orientation' says")
    else:
        text = f"'calibration: orientation' says forward: {forward}, which points across, or up"
        yield Finding("warning", "accelerometer", f"{text}: name another axis")


def _speed_against_wheels(motion: Motion) -> Iterator[Finding]:
    """Both are measured at the wheels; they agree within a few per cent but for a wrong unit."""
    if motion.speed is None or "wheel_speeds" not in motion.grid:
        return
    wheels = np.abs(smooth(motion.grid["wheel_speeds"])).mean(axis=1)
    n = min(len(wheels), len(motion.speed))
    speed, wheels = np.abs(motion.speed[:n]), wheels[:n]
    fast = np.nan_to_num(np.minimum(speed, wheels)) > 1.0
    if np.count_nonzero(fast) < MIN_TICKS:
        return
    ratio = float(np.median(speed[fast] / wheels[fast]))
    if not 1.0 / OTHER_UNIT < ratio < OTHER_UNIT:
        yield Finding("error", "speed", f"against the wheels' speeds {gain_guess(ratio)}")
    elif abs(ratio - 1.0) > WHEELS_DIFFER:
        yield Finding("warning", "speed", f"is {ratio:.2f} times the wheels' speeds")
    else:
        yield Finding("ok", "speed", f"is that of the wheels ({ratio:.2f} times)")


def _not_checked(
    motion: Motion, rates: Mapping[str, Array], stated: OrientationSettings
) -> Iterator[Finding]:
    """What the drive, or its signals, could not show."""
    left: list[str] = []
    turning = [name for name, rate in rates.items() if spread(rate) > MIN_TURNING]
    if not turning:
        left.append("signs and units of what shows turns (no bends, or no such signal)")
    elif len(turning) == 1:
        left.append(f"the sign of {turning[0]} in turns (nothing beside it)")
    if turning == ["gyroscope"] and stated == NOT_STATED and "heading" not in motion.grid:
        left.append(f"{NOT_CHECKED}; the mount stays usable and is never fine")
    if motion.speed is None:
        left.append("all that needs the speed")
    elif motion.change is not None and spread(motion.change) < MIN_BRAKING:
        left.append("the accelerometer against changes of speed (too few)")
    if "gyro" not in motion.grid and not motion.planar:
        left.append("the accelerometer's axes against a gyroscope's (there is none)")
    for text in left:
        yield Finding("note", "check", f"not checked: {text}")


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
        yield Finding("error", "accelerometer", f"{text}: {gain_guess(ratio)}")
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


def _along(motion: Motion) -> Iterator[Finding]:
    """Signals that must follow the change of speed."""
    if motion.change is None or spread(motion.change) < MIN_BRAKING:
        return
    signals = {}
    if "longitudinal_accel" in motion.grid:
        signals["longitudinal_acceleration"] = motion.grid["longitudinal_accel"]
    if motion.planar and motion.accel is not None:
        signals["accelerometer.x"] = motion.accel[:, 0]
    for name, signal in signals.items():
        gain, correlation = gain_between(motion.change, signal)
        if abs(correlation) < CLEAR:
            continue
        if gain < 0.0 and name == "accelerometer.x":
            text = "is negative when the vehicle accelerates: backwards mounted, or 'sign: -1'"
            yield Finding("warning", name, text)
        elif gain < 0.0:
            text = "is negative when the vehicle accelerates; set 'sign: -1'"
            yield Finding("warning", name, text)
        elif is_wrong(gain):
            text = f"against the change of speed {gain_guess(gain)}"
            yield Finding("warning", name, text)
        else:
            yield Finding("ok", name, f"follows the change of speed (gain {gain:.2f})")


def _reverse(motion: Motion) -> Iterator[Finding]:
    if motion.speed is None or "reverse" not in motion.grid:
        return
    fast = np.nan_to_num(np.abs(motion.speed)) > REVERSE_SPEED
    reverse = motion.grid["reverse"][fast]
    share = float(np.mean(reverse > 0.5)) if len(reverse) >= MIN_TICKS else 0.0
    if share > REVERSE_SHARE:
        text = f"is on for {100 * share:.0f} % of the time above 18 km/h: see 'equals:'"
        yield Finding("warning", "reverse", text)


def _brake(motion: Motion) -> Iterator[Finding]:
    if motion.speed is None or motion.change is None or "brake" not in motion.grid:
        return
    moving = (np.nan_to_num(np.abs(motion.speed)) > 1.0) & np.isfinite(motion.change)
    brake = motion.grid["brake"] > 0.5
    on, off = motion.change[moving & brake], motion.change[moving & ~brake]
    if min(len(on), len(off)) >= MIN_BRAKING_TICKS and on.mean() > off.mean() + 0.1:
        text = "is on when the vehicle accelerates: see 'equals:' and 'above:'"
        yield Finding("warning", "brake", text)
