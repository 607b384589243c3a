"""Words for how a sensor sits: where each of its axes points in the vehicle.

Roll and yaw cannot be told apart near 90 deg of pitch. Words such as "x points up, 5 deg back" are
clear for every mount.
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
"""Pitch beyond which roll and yaw lose their meaning.

At 90 deg they are one angle; here an error of one degree about the vehicle's axes is already three
degrees of yaw (1 / cos 70 deg).
"""


def axis_words(R_vehicle_from_sensor: Matrix3, axis: int) -> str:
    """Return where one sensor axis points, as "up, 5 deg back"; R: (3, 3).

    The text names the nearest of the vehicle's six directions and the lean to others. For a
    horizontal direction it gives heading and height; for up and down it gives the lean to each
    side.
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
    """Return the whole mount in one line: "x points up, 5 deg back; y points left; z points
    forward".
    """
    return "; ".join(
        f"{name} points {axis_words(R_vehicle_from_sensor, i)}" for i, name in enumerate(AXES)
    )


def leaning_words(R_vehicle_from_sensor: Matrix3) -> str:
    """Return the words for a mount of unknown forward direction: the angle of each axis against the
    horizontal.
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
    """Return a note to roll, pitch and yaw of a steep mount; None if the angles need no note.

    pitch: [rad]. quaternion: w, x, y, z.
    """
    if abs(pitch) <= STEEP:
        return None
    numbers = " ".join(f"{q:+.4f}" for q in quaternion)
    sign = "roll minus yaw" if pitch > 0.0 else "roll plus yaw"
    return (
        f"pitch is beyond {STEEP * DEG_PER_RAD:.0f} deg: roll and yaw are nearly the same angle "
        f"there ({sign}); use the words above or the quaternion w x y z = {numbers}"
    )


def _way(i: int, value: float) -> str:
    return WAYS[i][value < 0.0]
