"""Texts about the orientation of a sensor: the direction of each sensor axis in the vehicle.

Roll and yaw cannot be distinguished near 90 deg of pitch. Words such as "x points up, 5 deg back"
are clear for every mount.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucald.core.angles import DEG_PER_RAD
from imucald.core.rotations import Matrix3

AXES = ("x", "y", "z")
WAYS = (("forward", "back"), ("left", "right"), ("up", "down"))
"""Names of the two directions of each vehicle axis."""
UP = 2
STEEP = math.radians(70.0)
"""Pitch above which a note about roll and yaw is shown [rad].

At a pitch of 90 deg, roll and yaw are rotations about the same axis. At 70 deg, an error of one
degree about the vehicle's axes already causes an error of three degrees in yaw (1 / cos 70 deg).
"""


def axis_words(R_vehicle_from_sensor: Matrix3, axis: int) -> str:
    """Return the direction of one sensor axis in words, such as "up, 5 deg back".

    The text names the nearest of the vehicle's six directions and the angles towards other
    directions. For a horizontal direction, these are the angles to the side and up or down. For up
    and down, these are the angles towards front or back and left or right.
    """
    v = [float(c) for c in R_vehicle_from_sensor[:, axis]]
    main = max(range(3), key=lambda i: abs(v[i]))
    leans = []
    for i in range(3):
        if i == main:
            continue
        height = math.asin(max(-1.0, min(1.0, v[i])))
        angle = height if i == UP else math.atan2(v[i], abs(v[main]))
        if whole := round(abs(angle) * DEG_PER_RAD):
            leans.append((whole, f"{whole} deg {_way(i, angle)}"))
    leans.sort(key=lambda lean: -lean[0])
    words = " and ".join(text for _, text in leans)
    return _way(main, v[main]) + (f", {words}" if words else "")


def sits_words(R_vehicle_from_sensor: Matrix3) -> str:
    """Return the directions of all axes in one line: "x points up, 5 deg back; y points left; z
    points forward".
    """
    return "; ".join(
        f"{name} points {axis_words(R_vehicle_from_sensor, i)}" for i, name in enumerate(AXES)
    )


def leaning_words(R_vehicle_from_sensor: Matrix3) -> str:
    """Return a text about a mount whose forward direction is unknown: the angle between each axis
    and the horizontal plane.
    """
    parts = []
    for i, name in enumerate(AXES):
        height = math.asin(max(-1.0, min(1.0, float(R_vehicle_from_sensor[UP, i]))))
        whole = round(abs(height) * DEG_PER_RAD)
        way = _way(UP, height)
        lean = way if whole == 90 else f"{whole} deg {way}"
        parts.append(f"{name} points {lean}" if whole else f"{name} is level")
    return "; ".join(parts) + "; which way is forward is not known yet"


def steep_words(pitch: float, quaternion: Sequence[float]) -> str | None:
    """Return a note about roll, pitch and yaw of a steep mount; None if no note is needed. pitch:
    [rad]. quaternion: w, x, y, z.
    """
    if abs(pitch) <= STEEP:
        return None
    numbers = " ".join(f"{q:+.4f}" for q in quaternion)
    sign = "roll minus yaw" if pitch > 0.0 else "roll plus yaw"
    return (
        f"pitch is beyond {STEEP * DEG_PER_RAD:.0f} deg: roll and yaw cannot be "
        f"separated there, only {sign} is certain; use the words above or the quaternion w x y z = "
        f"{numbers}"
    )


def _way(i: int, value: float) -> str:
    return WAYS[i][value < 0.0]
