"""The right-forward-up axes of method C's publication.

In these axes x is to the right, y forward, z up, and the navigation axes are east, north, up. All
computations inside this package use these axes. `rfu_from_vehicle`, `vehicle_from_rfu` and
`vehicle_angles` convert from and to vehicle axes (ISO 8855: x forward, y left, z up). Computations
per sample use plain floats, because an array of three numbers takes more time than its arithmetic.
"""

from __future__ import annotations

import math

from imucald.core.rotations import Rows, Vector


def rfu_from_vehicle(x: float, y: float, z: float) -> Vector:
    """Convert a vector from vehicle axes (forward, left, up) to right-forward-up axes."""
    return -y, x, z


def vehicle_from_rfu(x: float, y: float, z: float) -> Vector:
    """Convert a vector from right-forward-up axes to vehicle axes (forward, left, up)."""
    return y, -x, z


def vehicle_angles(C_nav_from_body: Rows) -> Vector:
    """Return roll (left side up), pitch (nose down; ISO 8855) and heading (clockwise from north)
    [rad].

    C_nav_from_body is in right-forward-up axes. Roll and pitch are the Z-Y-X angles of
    R_earth_from_vehicle.
    """
    # Columns of C are the body's right, forward and up axes in east, north, up.
    pitch = -math.atan2(C_nav_from_body[7], math.hypot(C_nav_from_body[6], C_nav_from_body[8]))
    roll = math.atan2(-C_nav_from_body[6], C_nav_from_body[8])
    heading = math.atan2(C_nav_from_body[1], C_nav_from_body[4])
    return roll, pitch, heading % math.tau


def wrapped(angle: float) -> float:
    """Return the same angle in [-pi, pi] [rad]."""
    return math.remainder(angle, math.tau)
