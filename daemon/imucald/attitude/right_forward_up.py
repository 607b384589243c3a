"""The axes of method C's text, and rotations as four and nine plain numbers.

In that text x is to the right, y forward, z up, and the navigation axes are east, north, up.
Everything inside this package is in those axes; `text_from_vehicle` and `vehicle_angles` are the
edge where vehicle axes (ISO 8855: x forward, y left, z up) are converted, once each way.
Per sample everything is plain floats: an array of three costs more than its arithmetic.
"""

from __future__ import annotations

import math

from imucald.core.rotations import Rows, Vector

Quaternion = tuple[float, float, float, float]
"""w, x, y, z."""

IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)
TWO_PI = 2.0 * math.pi


def text_from_vehicle(x: float, y: float, z: float) -> Vector:
    """Vehicle axes (forward, left, up) -> the text's axes (right, forward, up)."""
    return -y, x, z


def vehicle_from_text(x: float, y: float, z: float) -> Vector:
    """The text's axes (right, forward, up) -> vehicle axes (forward, left, up)."""
    return y, -x, z


def vehicle_angles(C_nav_from_body: Rows) -> Vector:
    """Roll, pitch (ISO 8855: left side up, nose down) and heading clockwise from north [rad].

    C_nav_from_body is in the text's axes. Roll and pitch are those of the Z-Y-X angles of
    R_earth_from_vehicle.
    """
    # columns of C are the body's right, forward and up axes in east, north, up
    pitch = -math.atan2(C_nav_from_body[7], math.hypot(C_nav_from_body[6], C_nav_from_body[8]))
    roll = math.atan2(-C_nav_from_body[6], C_nav_from_body[8])
    heading = math.atan2(C_nav_from_body[1], C_nav_from_body[4])
    return roll, pitch, heading % TWO_PI


def text_rotation(roll: float, pitch: float, heading: float) -> Quaternion:
    """Quaternion of C_nav_from_body for ISO 8855 roll and pitch and heading from north [rad]."""
    turned = rotated(IDENTITY, 0.0, 0.0, -heading)
    nodded = rotated(turned, -pitch, 0.0, 0.0)  # about the right axis, nose up is positive
    return rotated(nodded, 0.0, roll, 0.0)


def from_vector(x: float, y: float, z: float) -> Quaternion:
    """Unit quaternion of a rotation vector [rad]."""
    square = x * x + y * y + z * z
    if square < 1e-8:  # sin and cos to double precision: the next terms are below 1e-17
        k = 0.5 - square / 48.0
        return 1.0 - square / 8.0, x * k, y * k, z * k
    angle = math.sqrt(square)
    k = math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), x * k, y * k, z * k


def product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Product p q, normalised: rotation q first, then p."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    w = pw * qw - px * qx - py * qy - pz * qz
    x = pw * qx + px * qw + py * qz - pz * qy
    y = pw * qy - px * qz + py * qw + pz * qx
    z = pw * qz + px * qy - py * qx + pz * qw
    k = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return w * k, x * k, y * k, z * k


def rotated(q: Quaternion, x: float, y: float, z: float) -> Quaternion:
    """q followed, in body axes, by a rotation vector [rad]; stays of unit length."""
    return product(q, from_vector(x, y, z))


def rows(q: Quaternion) -> Rows:
    """The rotation matrix of a unit quaternion."""
    w, x, y, z = q
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = x * y, x * z, y * z
    wx, wy, wz = w * x, w * y, w * z
    return (
        1.0 - 2.0 * (yy + zz), 2.0 * (xy - wz), 2.0 * (xz + wy),
        2.0 * (xy + wz), 1.0 - 2.0 * (xx + zz), 2.0 * (yz - wx),
        2.0 * (xz - wy), 2.0 * (yz + wx), 1.0 - 2.0 * (xx + yy),
    )  # fmt: skip


def cross(a: Vector, b: Vector) -> Vector:
    """Cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def wrapped(angle: float) -> float:
    """The same angle in [-pi, pi] [rad]."""
    return math.remainder(angle, TWO_PI)
