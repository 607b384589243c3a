"""Texts about an estimate for people: the meaning of "±", the position of the sensor, the missing
evidence.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from imucald.core.angles import DEG_PER_RAD
from imucald.core.orientation_words import leaning_words, sits_words, steep_words
from imucald.mount.contradictions import WORDS
from imucald.mount.estimate import ANGLES, MountEstimate
from imucald.mount.hysteresis import SLACK
from imucald.mount.signal_blocks import NO_SAMPLES

SD_95 = 2.0
"""Half of a 95 % interval, in standard deviations. All texts for people use this half interval
after "±"."""
CONVENTION = "± is 95 % (two standard deviations)"
ABOUT = (
    f"{CONVENTION}; the state depends on the error left in corrected samples, as turns about an "
    "axis"
)
"""Text that appears once on each screen with a mount."""
VEHICLE_AXES = ("forward axis", "left axis", "up axis")
"""Names of the axes about which rotations are stated.

Roll, pitch and yaw are names of angles and not of axes: at a yaw of 90 deg, a change of the roll
angle is a rotation about the left axis.
"""
MOST_OF_A_TURN = math.cos(math.radians(30.0))
"""Smallest cosine of the angle between a rotation's axis and a vehicle axis (30 deg) at which the
rotation is described as one about the vehicle axis."""
EVIDENCE_KINDS = {
    "turn": "turns",
    "dvdt": "acceleration",
    "axis": "axis of turning",
    "gravity": "gravity",
    "before": "earlier drives",
}
"""Meaning of the last part of the name of a kind of evidence."""
SENSOR_NAMES = {"accel": "accelerometer", "gyro": "gyroscope"}
"""Channels that have another name in texts for people."""
SHOWN_AS_SECONDS = 45.0
"""Shortest time that is shown in minutes [s]."""
LEAST_SHOWN_DEG = 0.1
"""Smallest rotation [deg] that is shown as a number. A smaller rotation would be rounded to
zero."""
UPSIDE_DOWN = (
    "the sensor seems to be upside down and backwards. If it is, write 'calibration: "
    "{orientation: {up: AXIS}}'. If not, its accelerometer has inverted signs: set 'sign: "
    "-1' on its axes"
)
UNKNOWN_STD_DEG = math.degrees(1.0)
"""Standard deviation [deg] above which an angle counts as unknown."""
UNKNOWN_HALF_DEG = SD_95 * UNKNOWN_STD_DEG
"""Half of a 95 % interval [deg] above which an angle counts as unknown."""


def half_width(std_deg: float | None) -> float | None:
    """Return half of the 95 % interval [deg] for a standard deviation [deg]; None: not known."""
    if std_deg is None or not std_deg < UNKNOWN_STD_DEG:
        return None
    return SD_95 * std_deg


def plus_minus(std_deg: float | None, digits: int = 2, unit: str = "°") -> str:
    """Return a standard deviation [deg] as a text for people, such as "±0.71°"; "-" if it is not
    known."""
    half = half_width(std_deg)
    return "-" if half is None else f"±{half:.{digits}f}{unit}"


def sent_words(correction: Mapping[str, Any] | None) -> str:
    """Return the remaining errors of corrected samples as one line with ±; "" if they are not
    known.

    correction: as in docs/json.md; None from an older daemon.
    """
    if correction is None:
        return ""
    cross_talk, gyro = correction["cross_talk_std_deg"], correction["gyro_cross_talk_std_deg"]
    if all(v is None for v in (*cross_talk.values(), *gyro.values())):
        return ""
    zero = " ".join("-" if v is None else f"±{SD_95 * v:.2f}" for v in correction["zero_std_mps2"])
    of = " ".join(f"{name} {plus_minus(std)}" for name, std in cross_talk.items())
    of_rate = " ".join(f"{name} {plus_minus(std)}" for name, std in gyro.items())
    return f"cross-talk {of}, level zero {zero} m/s², rate {of_rate}"


def angle_text(value: float | None, std_deg: float | None) -> str:
    """Return an angle and its standard deviation [deg] as a text for people, such as "+14.23°
    ±0.71°"."""
    known = value is not None and half_width(std_deg) is not None
    return f"{value:+.2f}° {plus_minus(std_deg)}" if known else "-"


def angle_cells(mount: Mapping[str, Any], angle: str) -> tuple[str, str]:
    """Return the angle and its deviation as two table cells.

    mount: as in docs/json.md. An older daemon gives no deviation.
    """
    text = angle_text(mount[f"{angle}_deg"], _angle_std(mount, angle))
    value, _, spread = text.partition(" ")
    return value, spread or "-"


def _angle_std(mount: Mapping[str, Any], angle: str) -> float | None:
    """Return the deviation [deg] of an angle; None from an older daemon."""
    std: float | None = mount.get("angle_std_deg", {}).get(angle)
    return std


def judged_std(mount: Mapping[str, Any], axis: str) -> float | None:
    """Return the deviation [deg] about a vehicle axis that is compared with the limits.

    mount: as in docs/json.md. An older daemon compares the deviation of the rotation.
    """
    found: float | None = mount.get("judged_std_deg", mount["std_deg"])[axis]
    return found


def target_words(result: Mapping[str, Any], axis: str) -> tuple[str, bool]:
    """Return in words the limit for the deviation about an axis, and whether the deviation is below
    this limit.

    result: as in docs/json.md, or a status. The limit belongs to the next state. If the result has
    no progress, the limit belongs to the first state whose limit is exceeded. While the state is
    *fine* although the limit of *fine* is exceeded, the text states the limit at which *fine* ends.
    """
    mount, progress = result["mount"], result.get("progress")
    targets = mount.get("target_std_deg")
    if targets is None:
        return "", False
    std, is_fine = judged_std(mount, axis), result["state"] == "fine"
    is_open = std is None or std >= targets["usable"][axis]
    goal = "usable" if is_open and not is_fine else "fine"
    if progress is not None:
        goal = progress["goal"]
    limit = float(targets[goal][axis])
    is_reached = std is not None and std < limit
    if is_fine and not is_reached:
        return f"fine up to {plus_minus(SLACK * limit)}", True
    return f"{goal} below {plus_minus(limit)}", is_reached


def percent(share: float) -> str:
    """Return a share (0 to 1) as a percentage for people. The text is 100 % only if the share is
    complete."""
    return f"{math.floor(100.0 * share)} %"


def driving_left(seconds: float | None) -> str:
    """Return in words the driving time until a condition is met; "" if no time is needed or the
    time is unknown."""
    if not seconds:
        return ""
    if seconds < SHOWN_AS_SECONDS:
        return f"about {max(round(seconds, -1), 10.0):.0f} s of driving"
    return f"about {round(seconds / 60.0)} min of driving"


def progress_words(progress: Mapping[str, Any] | None) -> str:
    """Return the condition that takes longest, such as "to fine: up axis 34 %, about 2 min of
    driving"; "" if no condition is open.
    """
    waiting = [gate for gate in (progress or {}).get("gates", ()) if gate["share"] < 1.0]
    if progress is None or not waiting:
        return ""
    last = max(waiting, key=lambda gate: (gate["left_s"] or math.inf, -gate["share"]))
    left = driving_left(last["left_s"])
    text = f"to {progress['goal']}: {last['gate']} {percent(last['share'])}"
    return text + (f", {left}" if left else "")


def angles_line(mount: Mapping[str, Any]) -> str:
    """Return the line `roll +14.40° ±1.10°, pitch ..., yaw ...`; "" before the angles are known."""
    if mount["quaternion_wxyz"] is None:
        return ""
    texts = ((name, angle_text(mount[f"{name}_deg"], _angle_std(mount, name))) for name in ANGLES)
    return ", ".join(f"{name} {'not known' if text == '-' else text}" for name, text in texts)


def how_it_sits(estimate: MountEstimate) -> str | None:
    """Return in words where the sensor's axes point; None before there is any estimate."""
    R, std = estimate.R_vehicle_from_sensor, estimate.std
    if R is None or std is None:
        return None
    known = half_width(std[2] * DEG_PER_RAD) is not None
    return sits_words(R) if known else leaning_words(R)


def steep_note(estimate: MountEstimate) -> str | None:
    """Return the note about the angles of a steep mount; None if the mount is not steep."""
    angles, quaternion = estimate.angles, estimate.quaternion
    if angles is None or quaternion is None:
        return None
    return steep_words(angles[1], quaternion)


def mirror_note(estimate: MountEstimate) -> str | None:
    """Return the note for an unconfirmed mount that is upside down and backwards.

    An accelerometer that outputs the negative specific force leads to the same mount, although the
    sensor is upright and points forward. Returns None if the mount is another one, or if signals
    have confirmed the mount.
    """
    R, std = estimate.R_vehicle_from_sensor, estimate.std
    if R is None or std is None or not estimate.details.get("not_checked"):
        return None
    if half_width(std[2] * DEG_PER_RAD) is None:  # the forward direction is not known yet
        return None
    if not (R[0, 0] < 0.0 and R[2, 2] < 0.0):
        return None
    up = max(range(3), key=lambda i: abs(R[2, i]))
    return UPSIDE_DOWN.replace("AXIS", ("-" if R[2, up] < 0.0 else "") + "xyz"[up])


def reasons(waiting_for: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Return names of angles and their reason, such as ("roll, pitch", "a standstill"). Angles with
    the same reason are in one item.
    """
    for text in dict.fromkeys(waiting_for.values()):
        yield ", ".join(name for name, one in waiting_for.items() if one == text), text


def is_trouble(text: str) -> bool:
    """True if a reason is a problem that more driving does not solve."""
    return text.startswith("the mount ") or any(words in text for words in WORDS.values())


def reasons_line(waiting_for: Mapping[str, str]) -> str:
    """Return all reasons in one line, such as "waiting for roll, pitch: a standstill; yaw: more
    driving".
    """
    found = list(reasons(waiting_for))
    waits = [f"{names}: {text}" for names, text in found if not is_trouble(text)]
    troubles = [text for _, text in found if is_trouble(text)]
    parts = ([f"waiting for {'; '.join(waits)}"] if waits else []) + troubles
    return "; ".join(parts)


def contradicted_words(turned_deg: float | None, is_given: bool = True) -> str:
    """Return in words why a stated or saved mount is wrong.

    turned_deg: rotation between this mount and the drive's own mount [deg]; None if the drive has
    no mount of its own.
    """
    text = (
        f"the {'stated mount' if is_given else 'mount of an earlier drive'} does not fit this drive"
    )
    if turned_deg is None:
        return f"{text}: gravity would be tilted more than on any road"
    return f"{text}: it is off by {turned_deg:.0f} deg"


def doubt_words(waiting_for: Mapping[str, str]) -> str:
    """Return the contradictions among the reasons in `waiting_for`; "" if there are none."""
    return "; ".join(text for _, text in reasons(waiting_for) if is_trouble(text))


def left_out_words(details: Mapping[str, Any]) -> str:
    """Return in words the time that was not used, by signal and cause: `869 s (no valid
    accelerometer sample)`. Times of less than a second are left out."""
    parts = []
    for one in details.get("not_learnt_from", ()):
        if one["seconds"] >= 1.0:
            signal = str(one["signal"])
            signal = SENSOR_NAMES.get(signal, signal.replace("_", " "))
            cause = str(one["cause"])
            words = "jumps" if cause == "speed_jump" else cause.replace("_", " ")
            why = f"no valid {signal} sample" if cause == NO_SAMPLES else f"{signal} {words}"
            parts.append(f"{one['seconds']:.0f} s ({why})")
    return ", ".join(parts)


def is_move(shift: Mapping[str, Any]) -> bool:
    """True if an item of `details.shifts` is a moved sensor. A change within its stated interval is
    not a moved sensor."""
    return shift.get("within_deg") is None


def change_words(shift: Mapping[str, Any]) -> str:
    """Return an item of `details.shifts` as a sentence. The time of an item is the time at which
    the change was found.
    """
    prefix = "the sensor was found moved: " if is_move(shift) else ""
    return prefix + moved_words(shift)


def moved_words(shift: Mapping[str, Any]) -> str:
    """Return a sentence about a moved sensor. shift: an item of `details.shifts`.

    A change that lies within the stated interval is not a move: it widens the interval. The test
    that finds a change examines one angle at a time, and may find the rotation in another angle
    than the true one. The mount that is estimated afterwards shows the real rotation.
    """
    turn = shift.get("turn_deg")
    if not is_move(shift):
        within = f"within ±{shift['within_deg']:.1f} deg"
        if turn is not None:
            return f"the mount was determined again and is the same, {within}"
        change = f"the evidence of {shift['angle']} changed by {shift['size_deg']:+.1f} deg"
        return f"{change}, {within}: the interval was widened"
    if turn is None:
        axis = dict(zip(ANGLES, VEHICLE_AXES, strict=True))[shift["angle"]]
        return f"the drive shows {shift['size_deg']:+.1f} deg about the {axis}"
    largest = max(range(3), key=lambda axis: abs(turn[axis]))
    angle = math.hypot(*turn)
    if angle < LEAST_SHOWN_DEG:
        return f"by less than {LEAST_SHOWN_DEG:g} deg"
    text = f"{turn[largest]:+.1f} deg about the {VEHICLE_AXES[largest]}"
    if abs(turn[largest]) < MOST_OF_A_TURN * angle:
        text = f"{angle:.1f} deg ({', '.join(f'{x:+.1f}' for x in turn)} about x, y, z)"
    return f"by {text}"
