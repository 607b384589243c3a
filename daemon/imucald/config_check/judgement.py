"""Find suspicious units, signs and axes in the signals of a drive, for `imucald check`.

A check gives a finding only if there is enough motion and a clear correlation. The thresholds are
wide: squat, superelevation and offsets change a gain by up to a third, but a wrong unit changes it
by a factor of more than 2.5. A confusion of miles and kilometres changes the gain by less, so the
threshold for the speed is narrower.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType

import numpy as np

from imucald.config.calibration import OrientationSettings, SensorAxis
from imucald.config.vehicle import VehicleSettings
from imucald.config_check.axes import (
    MIN_BRAKING,
    MIN_TURNING,
    axes_findings,
    best_response,
    gain_findings,
    sign_findings,
    speed_findings,
    turn_gain_findings,
)
from imucald.config_check.finding import (
    TURN_SIGN,
    Finding,
    gain_guess,
    is_beyond,
    spread,
)
from imucald.config_check.motion import MIN_TICKS, Motion, smooth, speed_ratio
from imucald.config_check.moved_sensor import sensor_move
from imucald.config_check.relation import relation
from imucald.config_check.single_fault import explained
from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.drive.roads import SLOPE
from imucald.mount.alternatives import NOT_CHECKED
from imucald.mount.contradictions import WRONG_UNIT
from imucald.mount.mirror import AT_REST, DOUBTED, REMEDY, names_of, probability
from imucald.mount.stated_orientation import CLEAR as CLEAR_PART
from imucald.mount.stated_orientation import unit_vector

REST_WRONG, REST_ODD = 0.25, 0.03
"""Relative errors of gravity at rest: above REST_WRONG the unit is wrong, above REST_ODD a note is
reported."""
PLANAR_REST = 1.5
"""Largest reading of a level accelerometer (two axes) at rest [m/s^2], caused by slope and
offset."""
GYRO_REST = math.radians(5.0)
"""Largest plausible gyro offset at rest [rad/s]."""
REVERSE_SPEED = 7.0
"""Largest speed in reverse for a longer time [m/s]."""
REVERSE_SHARE = 0.1
"""Largest plausible share of the time above `REVERSE_SPEED` in which the reverse signal is on. The
signal is on for a moment when the gear lever passes reverse."""
WHEELS_DIFFER = 0.1
"""Largest plausible relative difference between the speed and the wheel speeds. Worn and wrong
tyres cause 5 %; displayed speeds are up to 10 % too high (UN R39)."""
TURNING = 0.05
"""Smallest yaw rate of a turn [rad/s]: a bend with a radius of 200 m at 10 m/s."""
ONE_SIDED_TURNS = 5
"""A signal with at least this number of turns, all to the same side, is suspicious. By chance, five
turns are to the same side in one of 16 drives, but then the noise about zero has both signs."""
TWICE_SLOPES = 2.0 * SLOPE
"""Twice the rms slope of roads (tangent). Steeper roads are rare, so a larger specific force along
the road is caused by changes of speed."""

_WHEELS = ("wheel_speeds",)

NOT_STATED = OrientationSettings()
WITHOUT_GRAVITY = (
    "gravity is already removed (a 'linear' or 'user' acceleration); give the readings "
    "of the sensor itself"
)
UP_REMEDY = (
    "correct that line, or invert the signs of all axes ('sign: -1', or remove it if it is set)"
)
FORWARD_REMEDY = "correct that line"


def judge(
    motion: Motion,
    vehicle: VehicleSettings,
    stated: OrientationSettings = NOT_STATED,
    unit_advice: Mapping[str, str] = MappingProxyType({}),
    turned: Mapping[str, bool] = MappingProxyType({}),
    never_negative: Mapping[str, str] = MappingProxyType({}),
    signs_of_speed: str = "",
) -> Iterator[Finding]:
    """Yield all findings that the motion shows about units, signs and axes.

    A wrong scale of accelerometer or speed, or a single wrong sign, is reported once and then
    corrected. Therefore the same fault is not reported again for every signal that is compared with
    the wrong signal. stated: the orientation of the sensor that the user states. unit_advice:
    advice for quantities with a stated unit (see `unit_advice`). turned: for each quantity, whether
    the configuration reverses the signs of all its axes. never_negative: for each quantity that was
    never negative, the signals that may contain its sign. signs_of_speed: the keys that set the
    sign of the speed, if this sign is used as the reverse signal; else "".
    """
    if (move := sensor_move(motion)) is not None:
        text = f"{move.words}. Check a log without the move: this log contains two mounts"
        yield Finding("warning", "accelerometer", text)
        yield from _speed_against_wheels(motion, unit_advice.get("speed"))
        yield from _reverse(motion, signs_of_speed)
        return
    yield from _at_rest(motion, unit_advice.get("accelerometer"))
    yield from _constant_speed(motion)
    of_up: list[Finding] = []
    if motion.up is not None and not motion.planar:
        of_up += _stated_axis(stated.up, "up", motion.up, "down", UP_REMEDY)
    yield from of_up
    backwards = list(_reverse(motion, signs_of_speed))
    yield from backwards
    if any(finding.level != "ok" for finding in backwards):
        motion = motion.without("reverse")
    is_scaled = False
    if not motion.planar and motion.gravity is not None:
        motion = motion.scaled(accel=GRAVITY / float(np.linalg.norm(motion.gravity)))
        response = best_response(motion, motion.turn_rates(vehicle))
        if response is not None:
            yield from speed_findings(response, unit_advice)
            gain = response.gain
            if not any(finding.level == "error" for finding in of_up):  # else it is mirrored
                ahead = response.forward
                yield from _stated_axis(stated.forward, "forward", ahead, "back", FORWARD_REMEDY)
            if is_beyond(gain, WRONG_UNIT):
                motion = motion.scaled(speed=gain)
                is_scaled = True
    rates = motion.turn_rates(vehicle)
    of_signs = list(_signs_and_axes(motion, rates, turned))
    named, motion = explained(of_signs, motion, lambda m: _signs_and_axes(m, m.turn_rates(vehicle)))
    yield from named
    rates = motion.turn_rates(vehicle)
    yield from gain_findings(rates, unit_advice)
    yield from _magnitudes(rates, never_negative)
    if stated == NOT_STATED and "heading" not in motion.grid and not motion.planar:
        yield from _mirrored(of_signs, turned)
    yield from _along(motion, unit_advice)
    if not motion.planar:
        yield from turn_gain_findings(motion, rates, unit_advice)
    yield from (
        f
        for f in _speed_against_wheels(motion, unit_advice.get("speed"))
        if not (is_scaled and f.level == "ok")
    )
    yield from _brake(motion)
    yield from _not_checked(motion, rates, stated)


def _signs_and_axes(
    motion: Motion,
    rates: Mapping[str, Array],
    turned: Mapping[str, bool] = MappingProxyType({}),
) -> Iterator[Finding]:
    yield from sign_findings(rates, turned)
    if not motion.planar:
        yield from axes_findings(motion, rates)


def _magnitudes(rates: Mapping[str, Array], never_negative: Mapping[str, str]) -> Iterator[Finding]:
    """Find signals that show turns to only one side."""
    for name, bits in never_negative.items():
        rate = rates.get(name)
        if rate is None:
            continue
        turning = np.nan_to_num(np.abs(rate)) > TURNING
        turns = np.count_nonzero(np.diff(turning.astype(np.int8)) > 0)
        if turns >= ONE_SIDED_TURNS:
            where = f"in {bits}" if bits else "in another signal"
            text = (
                f"the signal is never negative in {turns} turns. If its sign is {where}, name that "
                "signal with 'sign_signal:'. If the database misses that the signal is signed, "
                "correct the database (in a DBC: '-' in place of '+' behind '@0' or '@1')"
            )
            yield Finding("warning", name, text)


def _mirrored(of_turns: Sequence[Finding], turned: Mapping[str, bool]) -> Iterator[Finding]:
    """Check whether signals agree only because the configuration reverses all of them.

    of_turns: findings about the signals that show turns.
    """
    agree = next((f for f in of_turns if f.level == "ok" and f.beside), None)
    if agree is None:
        return
    shown = {name: turned[name] for name in (agree.quantity, *agree.beside) if name in turned}
    right = "if it does, write 'calibration: {orientation: {up: AXIS}}'"
    if not shown:
        return
    if not turned.get("accelerometer", True):
        if probability(shown) >= DOUBTED:
            names = names_of(shown)
            text = (
                f"its signs are not certain, since 'sign: -1' is set for {names}: {REMEDY}; {right}"
            )
            yield Finding("warning", "accelerometer", text)
        return
    # the result without the configured signs
    shown = {name: is_turned == (name == "gyroscope") for name, is_turned in shown.items()}
    if 1.0 - probability(shown) >= DOUBTED:
        text = (
            f"the signs of its axes follow from {names_of(shown)} only. Check them: "
            f"{AT_REST}; {right}"
        )
        yield Finding("warning", "accelerometer", text)


def _stated_axis(
    stated: SensorAxis | None, direction: str, found: Array, opposite: str, remedy: str
) -> Iterator[Finding]:
    """Check whether the axis that the user states for a direction ("up" or "forward") agrees with
    the data. found: the direction in the data, unit vector (3,) in sensor axes. remedy: text for an
    axis that points in the opposite direction."""
    if stated is None:
        return
    part = float(found @ unit_vector(stated))
    line = f"'calibration: orientation' says {direction}: {stated}"
    if part < -CLEAR_PART:
        text = f"its {stated} points {opposite}, and {line}; {remedy}"
        yield Finding("error", "accelerometer", text)
    elif part > CLEAR_PART:
        text = f"its {stated} points {direction}, as 'orientation' says"
        yield Finding("ok", "accelerometer", text)
    else:
        text = f"{line}, which is neither {direction} nor {opposite}: name another axis"
        yield Finding("warning", "accelerometer", text)


def _constant_speed(motion: Motion) -> Iterator[Finding]:
    """Report a speed that never changes: an error if the accelerometer shows changes of speed.
    Cruise control can cause it with whole km/h."""
    if not motion.drives:
        return
    known = motion.grid["speed"][np.isfinite(motion.grid["speed"])]
    if np.ptp(known) > 0.0:
        return
    text = f"is {known[0]:.2f} m/s in the whole log"
    if _is_driven_both_ways(motion):
        text += (
            ", but the accelerometer shows changes of speed: the signal is stuck, or it is "
            "not the speed"
        )
        yield Finding("error", "speed", text)
    else:
        text += (
            ": the signal is stuck, or the vehicle drove at constant speed. Record a start "
            "or a braking manoeuvre to find out"
        )
        yield Finding("warning", "speed", text)


def _is_driven_both_ways(motion: Motion) -> bool:
    """True if the specific force varies in both horizontal directions by more than slopes cause.
    Bends change only the lateral force."""
    if motion.accel is None or motion.up is None:
        return False
    force = motion.accel[np.isfinite(motion.accel).all(axis=1)]
    level = force[:, :2] if motion.planar else force - np.outer(force @ motion.up, motion.up)
    if len(level) < MIN_TICKS:
        return False
    variances = np.linalg.eigvalsh(np.cov(level.T))
    return bool(variances[-2] > (TWICE_SLOPES * GRAVITY) ** 2)


def _speed_against_wheels(motion: Motion, unit_advice: str | None) -> Iterator[Finding]:
    """Compare the speed with the wheel speeds. Speed and wheel speeds agree within a few per cent
    unless a unit is wrong."""
    if motion.speed is None or "wheel_speeds" not in motion.grid:
        return
    wheels = np.abs(smooth(motion.grid["wheel_speeds"])).mean(axis=1)
    ratio = speed_ratio(motion.speed, wheels)
    if ratio is None:
        return
    if is_beyond(ratio, WRONG_UNIT):
        text = f"compared with the wheel speeds {gain_guess(ratio, unit_advice)}"
        yield Finding("error", "speed", text, _WHEELS)
    elif abs(ratio - 1.0) > WHEELS_DIFFER:
        yield Finding("warning", "speed", f"is {ratio:.2f} times the wheel speeds", _WHEELS)
    else:
        yield Finding("ok", "speed", f"agrees with the wheel speeds ({ratio:.2f} times)", _WHEELS)


def _not_checked(
    motion: Motion, rates: Mapping[str, Array], stated: OrientationSettings
) -> Iterator[Finding]:
    left: list[str] = []
    turning = [name for name, rate in rates.items() if spread(rate) > MIN_TURNING]
    if not turning:
        left.append(
            "signs and units of the gyroscope, yaw rate or steering angle (no bends, or no "
            "such signal)"
        )
    elif len(turning) == 1:
        left.append(f"the sign of {turning[0]} in turns (no other signal to compare it with)")
    if turning == ["gyroscope"] and stated == NOT_STATED and "heading" not in motion.grid:
        left.append(f"{NOT_CHECKED}; the mount becomes usable, but never fine")
    if motion.speed is None:
        left.append("all checks that need the speed")
    elif motion.change is not None and spread(motion.change) < MIN_BRAKING:
        left.append("the accelerometer against the changes of speed (too few changes)")
    if "gyro" not in motion.grid and not motion.planar:
        left.append("the axes of the accelerometer against the axes of a gyroscope (no gyroscope)")
    for text in left:
        yield Finding("note", "check", f"not checked: {text}")


def _at_rest(motion: Motion, unit_advice: str | None) -> Iterator[Finding]:
    gravity = motion.gravity
    if gravity is None or motion.accel is None:
        return
    when = "at rest" if motion.standing is not None else "on average"
    if motion.planar:
        level = float(np.hypot(gravity[0], gravity[1]))
        if motion.standing is not None and level > PLANAR_REST:
            text = (
                f"shows {level:.2f} m/s² {when}, but a sensor without z must be level. Are "
                "axes or unit wrong?"
            )
            yield Finding("warning", "accelerometer", text)
        return
    size = float(np.linalg.norm(gravity))
    ratio = size / GRAVITY
    text = f"{size:.2f} m/s² {when} (gravity is {GRAVITY:.2f})"
    if ratio < 1.0 - REST_WRONG and _lacks_gravity(motion.accel, size):
        yield Finding("error", "accelerometer", f"{text}: {WITHOUT_GRAVITY}")
    elif abs(ratio - 1.0) > REST_WRONG:
        yield Finding("error", "accelerometer", f"{text}: {gain_guess(ratio, unit_advice)}")
    elif abs(ratio - 1.0) > REST_ODD:
        yield Finding(
            "warning", "accelerometer", f"{text}: is its scale wrong, or its zero error large?"
        )
    else:
        yield Finding("ok", "accelerometer", text)
    gyro = motion.grid.get("gyro")
    if gyro is not None and motion.standing is not None:
        n = min(len(gyro), len(motion.standing))
        resting = gyro[:n][motion.standing[:n]]
        resting = resting[np.isfinite(resting).all(axis=1)]
        offset = float(np.linalg.norm(resting.mean(axis=0))) if len(resting) else 0.0
        if offset > GYRO_REST:
            text = (
                f"shows {math.degrees(offset):.1f} deg/s at rest. Is its unit wrong, or its "
                "zero error large?"
            )
            yield Finding("warning", "gyroscope", text)


def _lacks_gravity(accel: Array, size: float) -> bool:
    """True if readings (n, 3) usually differ from their mean by more than `size`, the size of the
    mean. A vehicle cannot have such readings in any unit.

    A wrong unit changes mean and variation by the same factor. Therefore the vehicle would
    accelerate with 1 g or more on average. "Usually" means the median: half of the changes are
    within 0.67 deviations (normal distribution), and single spikes do not count.
    """
    known = accel[np.isfinite(accel).all(axis=1)]
    if len(known) < MIN_TICKS:
        return False
    usual = np.median(np.abs(known - np.median(known, axis=0)), axis=0) / 0.67
    return float(np.linalg.norm(usual)) > size


def _along(motion: Motion, unit_advice: Mapping[str, str]) -> Iterator[Finding]:
    """Check the signals that must agree with the change of speed."""
    if motion.change is None or spread(motion.change) < MIN_BRAKING:
        return
    signals = {}
    if "longitudinal_accel" in motion.grid:
        signals["longitudinal_acceleration"] = motion.grid["longitudinal_accel"]
    if motion.planar and motion.accel is not None:
        signals["accelerometer.x"] = motion.accel[:, 0]
    for name, signal in signals.items():
        found = relation(motion.change, signal)
        if not found.is_same_motion:
            continue
        gain = found.sign * found.gain
        if gain < 0.0 and name == "accelerometer.x":
            text = (
                "is negative when the vehicle accelerates: the sensor is mounted backwards, "
                "or 'sign: -1' is needed"
            )
            yield Finding("warning", name, text)
        elif gain < 0.0:
            text = f"is negative when the vehicle accelerates; {TURN_SIGN}"
            yield Finding("warning", name, text)
        elif is_beyond(gain, WRONG_UNIT):
            guess = gain_guess(gain, unit_advice.get(name))
            yield Finding("warning", name, f"compared with the change of speed, it is {guess}")
        else:
            yield Finding("ok", name, f"follows the change of speed (gain {gain:.2f})")


def _reverse(motion: Motion, signs_of_speed: str) -> Iterator[Finding]:
    if motion.speed is None or "reverse" not in motion.grid:
        return
    fast = np.nan_to_num(np.abs(motion.speed)) > REVERSE_SPEED
    reverse = motion.grid["reverse"][fast]
    share = float(np.mean(reverse > 0.5)) if len(reverse) >= MIN_TICKS else 0.0
    fastest = f"{3.6 * REVERSE_SPEED:.0f} km/h"
    name, is_on = ("speed", "is negative") if signs_of_speed else ("reverse", "is on")
    if share > REVERSE_SHARE:
        keys = signs_of_speed or "'equals:' and 'above:'"
        text = f"{is_on} for {100 * share:.0f} % of the time above {fastest}: check {keys}"
        yield Finding("error" if share > 0.5 else "warning", name, text)
    elif len(reverse) >= MIN_TICKS and np.nanmax(motion.grid["reverse"]) > 0.5:
        is_off = "is positive" if signs_of_speed else "is off"
        yield Finding("ok", name, f"{is_off} above {fastest}")  # and sometimes in reverse


def _brake(motion: Motion) -> Iterator[Finding]:
    if motion.speed is None or motion.change is None or "brake" not in motion.grid:
        return
    moving = np.nan_to_num(np.abs(motion.speed)) > 1.0
    found = relation(np.where(moving, motion.change, np.nan), motion.grid["brake"])
    if not found.is_believed_of(1):
        return
    if found.sign > 0:
        text = "is on when the vehicle accelerates: check 'equals:' and 'above:'"
        yield Finding("warning", "brake", text)
    else:
        yield Finding("ok", "brake", "is on when the vehicle slows down")
