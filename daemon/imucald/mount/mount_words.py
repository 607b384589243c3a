"""Texts about an estimate for people: the convention for "±", the position of the sensor, the
missing evidence.
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

SD_95 = 2.0
"""Half of a 95 % interval in standard deviations, everywhere that people read "±"."""
CONVENTION = "± is 95 % (two standard deviations)"
ABOUT = (
    f"{CONVENTION}; the state depends on the error left in corrected samples, as turns about an "
    "axis"
)
"""Text that appears once on each screen with a mount."""
VEHICLE_AXES = ("forward axis", "left axis", "up axis")
"""Names of the axes about which rotations are stated.

Roll, pitch and yaw are names of angles only: at a yaw of 90 deg the roll angle is a rotation about
the left axis.
"""
MOST_OF_A_TURN = math.cos(math.radians(30.0))
"""A rotation is described as one about a vehicle axis if its axis lies within 30 deg of it."""
EVIDENCE_KINDS = {
    "turn": "turns",
    "dvdt": "acceleration",
    "axis": "axis of turning",
    "gravity": "gravity",
    "before": "earlier drives",
}
"""Meaning of the last part of an evidence's name."""
SENSOR_NAMES = {"accel": "accelerometer", "gyro": "gyroscope"}
"""Channels for which people use another name."""
SHOWN_AS_SECONDS = 45.0
"""Shortest time that is shown in minutes [s]."""
LEAST_LEFT_OUT_S = 1.0
LEAST_SHOWN_DEG = 0.1
"""A smaller rotation is not shown as a number, because it would be rounded to zero."""
UPSIDE_DOWN = (
    "the sensor seems to be upside down and backwards. If it is, write 'calibration: "
    "{orientation: {up: AXIS}}'. If not, its accelerometer has inverted signs: set 'sign: "
    "-1' on its axes"
)
STATED_WRONG = "the stated mount does not fit this drive"
SAVED_WRONG = "the mount of an earlier drive does not fit this drive"
"""Text for a mount that the drive contradicts."""
UNKNOWN_STD_DEG = math.degrees(1.0)
"""An angle with a larger standard deviation is as good as unknown [deg]."""
UNKNOWN_HALF_DEG = SD_95 * UNKNOWN_STD_DEG
"""Half of a 95 % interval above which an angle is as good as unknown [deg]."""


def half_width(std_deg: float | None) -> float | None:
    """Return half of the 95 % interval [deg] of a standard deviation [deg]; None: not known."""
    if std_deg is None or not std_deg < UNKNOWN_STD_DEG:
        return None
    return SD_95 * std_deg


def plus_minus(std_deg: float | None, digits: int = 2, unit: str = "°") -> str:
    """Format a standard deviation [deg] as people read it, "±0.71°"; "-" where it is not known."""
    half = half_width(std_deg)
    return "-" if half is None else f"±{half:.{digits}f}{unit}"


def sent_words(correction: Mapping[str, Any] | None) -> str:
    """Return the errors left in corrected samples, ± in one line; "" where they are not known.

    correction: as in docs/json.md; an older daemon gives none.
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
    """Format an angle and its standard deviation [deg] as people read them, "+14.23° ±0.71°"."""
    known = value is not None and half_width(std_deg) is not None
    return f"{value:+.2f}° {plus_minus(std_deg)}" if known else "-"


def angle_cells(mount: Mapping[str, Any], angle: str) -> tuple[str, str]:
    """Return angle and deviation in two cells.

    mount: as in docs/json.md (an older daemon gives no ±).
    """
    text = angle_text(mount[f"{angle}_deg"], _angle_std(mount, angle))
    value, _, spread = text.partition(" ")
    return value, spread or "-"


def _angle_std(mount: Mapping[str, Any], angle: str) -> float | None:
    """Return the deviation [deg] of an angle; an older daemon does not give it."""
    std: float | None = mount.get("angle_std_deg", {}).get(angle)
    return std


def judged_std(mount: Mapping[str, Any], axis: str) -> float | None:
    """Return the deviation [deg] about a vehicle axis by which a state is judged.

    mount: as in docs/json.md; an older daemon judged by the deviation of the rotation.
    """
    found: float | None = mount.get("judged_std_deg", mount["std_deg"])[axis]
    return found


def target_words(result: Mapping[str, Any], axis: str) -> tuple[str, bool]:
    """Return the limit for the deviation about an axis in words, and whether it holds.

    result: as in docs/json.md, or a status. The limit is that of the next state: without progress,
    of the first whose limit the deviation has not reached. Where *fine* is kept beyond its limit,
    it is the limit at which it ends.
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
    """Format a share (0 to 1) as people read it; 100 % only once it is complete."""
    return f"{math.floor(100.0 * share)} %"


def driving_left(seconds: float | None) -> str:
    """Return how much driving a gate still takes; "" where it takes none or the time is unknown."""
    if not seconds:
        return ""
    if seconds < SHOWN_AS_SECONDS:
        return f"about {max(round(seconds, -1), 10.0):.0f} s of driving"
    return f"about {round(seconds / 60.0)} min of driving"


def progress_words(progress: Mapping[str, Any] | None) -> str:
    """Return the condition that takes longest: "to fine: up axis 34 %, about 2 min of driving"; or
    "".
    """
    waiting = [gate for gate in (progress or {}).get("gates", ()) if gate["share"] < 1.0]
    if progress is None or not waiting:
        return ""
    last = max(waiting, key=lambda gate: (gate["left_s"] or math.inf, -gate["share"]))
    left = driving_left(last["left_s"])
    text = f"to {progress['goal']}: {last['gate']} {percent(last['share'])}"
    return text + (f", {left}" if left else "")


def angles_line(mount: Mapping[str, Any]) -> str:
    """Return `roll +14.40° ±1.10°, pitch ..., yaw ...`; "" before the angles are known."""
    if mount["quaternion_wxyz"] is None:
        return ""
    texts = ((name, angle_text(mount[f"{name}_deg"], _angle_std(mount, name))) for name in ANGLES)
    return ", ".join(f"{name} {'not known' if text == '-' else text}" for name, text in texts)


def how_it_sits(estimate: MountEstimate) -> str | None:
    """Return where the sensor's axes point, in words; None before there is any estimate."""
    R, std = estimate.R_vehicle_from_sensor, estimate.std
    if R is None or std is None:
        return None
    known = half_width(std[2] * DEG_PER_RAD) is not None
    return sits_words(R) if known else leaning_words(R)


def steep_note(estimate: MountEstimate) -> str | None:
    """Return the note that the angles of a steep mount need; None if it is not steep."""
    angles, quaternion = estimate.angles, estimate.quaternion
    if angles is None or quaternion is None:
        return None
    return steep_words(angles[1], quaternion)


def mirror_note(estimate: MountEstimate) -> str | None:
    """Return the note for an unconfirmed mount that is upside down and backwards.

    An accelerometer that outputs minus the specific force gives the same mount on a sensor that
    sits the right way round. Returns None if the mount is another one, or if signals have confirmed
    it.
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
    """Return names and reason, angles with the same reason together: ("roll, pitch", "a
    standstill").
    """
    for text in dict.fromkeys(waiting_for.values()):
        yield ", ".join(name for name, one in waiting_for.items() if one == text), text


def is_trouble(text: str) -> bool:
    """True if a reason is one that more driving does not solve."""
    return text.startswith("the mount ") or any(words in text for words in WORDS.values())


def reasons_line(waiting_for: Mapping[str, str]) -> str:
    """Return the reasons in one line: "waiting for roll, pitch: a standstill; yaw: more
    driving".
    """
    found = list(reasons(waiting_for))
    waits = [f"{names}: {text}" for names, text in found if not is_trouble(text)]
    troubles = [text for _, text in found if is_trouble(text)]
    parts = ([f"waiting for {'; '.join(waits)}"] if waits else []) + troubles
    return "; ".join(parts)


def contradicted_words(turned_deg: float | None, is_given: bool = True) -> str:
    """Return why a stated or saved mount is wrong.

    turned_deg: rotation of the drive's own mount against it [deg], if the drive has one.
    """
    text = STATED_WRONG if is_given else SAVED_WRONG
    if turned_deg is None:
        return f"{text}: gravity would be tilted more than on any road"
    return f"{text}: it is off by {turned_deg:.0f} deg"


def doubt_words(waiting_for: Mapping[str, str]) -> str:
    """Return the contradictions among the reasons for which an estimate waits; "" without any."""
    return "; ".join(text for _, text in reasons(waiting_for) if is_trouble(text))


CAUSES_LEFT_OUT = {"no valid samples": "no valid sample", "speed_jump": "jumps"}


def left_out_words(details: Mapping[str, Any]) -> str:
    """Return the data that were not used, by signal, cause and time; "" for less than a second."""
    parts = []
    for one in details.get("not_learnt_from", ()):
        if one["seconds"] >= LEAST_LEFT_OUT_S:
            signal = str(one["signal"])
            signal = SENSOR_NAMES.get(signal, signal.replace("_", " "))
            cause = str(one["cause"])
            words = CAUSES_LEFT_OUT.get(cause, cause.replace("_", " "))
            parts.append(f"{signal}: {words} for {one['seconds']:.0f} s")
    return ", ".join(parts)


def is_move(shift: Mapping[str, Any]) -> bool:
    """True if an item of `details.shifts` is a moved sensor and not a change within its
    interval.
    """
    return shift.get("within_deg") is None


def change_words(shift: Mapping[str, Any]) -> str:
    """Return an item of `details.shifts` as a sentence; its time is the time at which it was
    found.
    """
    prefix = "the sensor was found moved: " if is_move(shift) else ""
    return prefix + moved_words(shift)


def moved_words(shift: Mapping[str, Any]) -> str:
    """Return a sentence about a moved sensor. shift: an item of `details.shifts`.

    A change that lies within the stated interval is no move: it widens the interval. The test that
    finds a change looks at one angle, and may see the rotation about another axis there. The mount
    that is found afterwards shows the real rotation.
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
