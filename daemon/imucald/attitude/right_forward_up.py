"""The right-forward-up axes of method C's publication.

In these axes x is to the right, y forward, z up, and the navigation axes are east, north, up.
Everything inside this package uses these axes. `rfu_from_vehicle`, `vehicle_from_rfu` and
`vehicle_angles` convert from and to vehicle axes (ISO 8855: x forward, y left, z up), once each
way. Computations per sample use plain floats, because an array of three costs more than its
arithmetic.
"""

from __future__ import annotations

import math

from imucald.core.rotations import Rows, Vector

TWO_PI = 2.0 * math.pi


def rfu_from_vehicle(x: float, y: float, z: float) -> Vector:
    """Vehicle axes (forward, left, up) -> right-forward-up axes."""
    return -y, x, z


def vehicle_from_rfu(x: float, y: float, z: float) -> Vector:
    """Right-forward-up axes -> vehicle axes (forward, left, up)."""
    return y, -x, z


def vehicle_angles(C_nav_from_body: Rows) -> Vector:
    """Roll, pitch (ISO 8855: left side up, nose down) and heading clockwise from north [rad].

    C_nav_from_body is in right-forward-up axes. Roll and pitch are the Z-Y-X angles of
    R_earth_from_vehicle.
    """
    # Columns of C are the body's right, forward and up axes in east, north, up.
    pitch = -math.atan2(C_nav_from_body[7], math.hypot(C_nav_from_body[6], C_nav_from_body[8]))
    roll = math.atan2(-C_nav_from_body[6], C_nav_from_body[8])
    heading = math.atan2(C_nav_from_body[1], C_nav_from_body[4])
    return roll, pitch, heading % TWO_PI


def wrapped(angle: float) -> float:
    """Return the same angle in [-pi, pi] [rad]."""
    return math.remainder(angle, TWO_PI)
