"""A first rotation without prior knowledge: level from gravity, yaw from the direction of the
responses.
"""

from __future__ import annotations

import math

from imucald.core.rotations import Matrix3, levelling_rotation, rotation_from_angles
from imucald.mount.evidence_gravity import GravityEvidence
from imucald.mount.evidence_response import ResponseEvidence

SIGN_SURE = 0.3
"""Correlation of lateral force and turning above which forward and backward are distinguished."""
MIN_WINDOWS, MIN_WINDOWS_WITHOUT_SPEED = 2, 6
MIN_POWER = 20.0
"""Motion [(m/s^2)^2], summed over the windows, that a direction needs."""


def first_rotation(gravity: GravityEvidence, response: ResponseEvidence) -> tuple[Matrix3, bool]:
    """Return R (3, 3), sensor to level axes, and whether its yaw is known."""
    level = levelling_rotation(gravity.mean_force())
    if response.without_speed:
        direction, sureness = response.principal_direction(level)
        if response.windows < MIN_WINDOWS_WITHOUT_SPEED or not sureness > SIGN_SURE:
            return level, False
        return rotation_from_angles(0.0, 0.0, -direction) @ level, True
    to_a, to_v, power_a, power_v = response.direction_sums()
    if response.windows < MIN_WINDOWS or power_a + power_v < MIN_POWER:
        return level, False
    a, v = level @ to_a, level @ to_v
    forward = complex(a[0], a[1]) + complex(v[1], -v[0])
    return rotation_from_angles(0.0, 0.0, -math.atan2(forward.imag, forward.real)) @ level, True
