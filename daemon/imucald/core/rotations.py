"""ISO 8855 axes and rotations: the only module with angle conventions.

Vehicle axes: x forward, y left, z up. The name of a rotation contains both frames:
`R_vehicle_from_sensor @ v_sensor = v_vehicle`. Mount angles are the intrinsic Z-Y-X (yaw, pitch,
roll) angles of that rotation, as in ``scipy.spatial.transform.Rotation.from_euler("ZYX", [yaw,
pitch, roll])``. Positive yaw turns the sensor to the left, positive pitch turns its nose down, and
positive roll turns its left side up.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix3 = NDArray[np.float64]
"""(3, 3) float64."""
UPSIDE_DOWN = -0.5
"""If the cosine of the tilt is below this value, the levelling rotation is computed with a second
formula, which is accurate for a sensor that is nearly upside down."""
Vector = tuple[float, float, float]
Rows = tuple[float, float, float, float, float, float, float, float, float]
"""A 3 x 3 matrix as plain numbers, row by row.

For a single sample, creating an array takes longer than the multiplication.
"""
Quaternion = tuple[float, float, float, float]
"""w, x, y, z of a unit quaternion."""
IDENTITY: Quaternion = (1.0, 0.0, 0.0, 0.0)
Number = TypeVar("Number", float, NDArray[np.float64])


def times(m: Sequence[Number], v: Sequence[Number]) -> tuple[Number, Number, Number]:
    """Return matrix, row by row (9,), times vector (3,): numbers or columns of numbers."""
    a, b, c, d, e, f, g, h, i = m
    x, y, z = v
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def transposed_times(m: Rows, v: Sequence[float]) -> Vector:
    """Return the transposed matrix times a vector (3,): the inverse rotation."""
    a, b, c, d, e, f, g, h, i = m
    x, y, z = v
    return a * x + d * y + g * z, b * x + e * y + h * z, c * x + f * y + i * z


def times_columns(rows: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return matrices times vectors v (N, 3). The results are bit-identical to `times`.

    rows: (N, 9) or (1, 9), matrices row by row; further columns are ignored.
    """
    components: tuple[Any, ...] = times(list(rows.T[:9]), list(v.T))
    return np.array(components).T


def times_level(m: Rows, v: Sequence[float]) -> Vector:
    """Rotate the sample v of a level sensor with two axes about the vertical. The rotation angle is
    the yaw of the x axis in m.

    m: R_vehicle_from_sensor; the z axes of sensor and vehicle differ at most by the cross slope of
    the road. The z value of the result is unknown (NaN). Source: claim 5 of method A (application
    CN 201610826380).
    """
    c, s = m[0], m[3]
    size = math.sqrt(c * c + s * s)
    x, y = v[0], v[1]
    return (c * x - s * y) / size, (s * x + c * y) / size, math.nan


def times_level_columns(rows: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Do `times_level` for matrices (N, 9) or (1, 9) and vectors v (N, 3), with bit-identical
    results."""
    c, s, x, y = rows[:, 0], rows[:, 3], v[:, 0], v[:, 1]
    size = np.sqrt(c * c + s * s)
    out = (c * x - s * y) / size, (s * x + c * y) / size, np.full(len(v), np.nan)
    return np.stack(out, axis=1)


def applied(matrices: NDArray[np.float64], columns: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the matrix product of (..., r, 3) and (..., 3, k). The products are summed from left
    to right, because the matrix product of a library uses a different order on each processor.
    """
    first = matrices[..., :, 0, None] * columns[..., None, 0, :]
    first += matrices[..., :, 1, None] * columns[..., None, 1, :]
    first += matrices[..., :, 2, None] * columns[..., None, 2, :]
    return first


def matrix_times(R: Matrix3, v: Vector) -> Vector:
    """Return matrix R (3, 3) times vector v, as Python floats."""
    x, y, z = (float(c) for c in R @ np.array(v))
    return x, y, z


def rotation_from_angles(roll: float, pitch: float, yaw: float) -> Matrix3:
    """Return R_vehicle_from_sensor (3, 3) from intrinsic Z-Y-X mount angles [rad]."""
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def angles_from_rotation(R_vehicle_from_sensor: ArrayLike) -> tuple[float, float, float]:
    """Return roll, pitch, yaw [rad] of a rotation (3, 3). Roll is 0 if pitch is +90 or -90 deg."""
    R = np.asarray(R_vehicle_from_sensor, dtype=float)
    pitch = math.atan2(-R[2, 0], math.hypot(R[2, 1], R[2, 2]))
    if math.hypot(R[2, 1], R[2, 2]) < 1e-9:
        return 0.0, pitch, math.atan2(-R[0, 1], R[1, 1])
    return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])


def skew(v: ArrayLike) -> NDArray[np.float64]:
    """Return cross-product matrices (..., 3, 3) of vectors (..., 3): ``skew(a) @ b == cross(a,
    b)``."""
    x, y, z = np.moveaxis(np.asarray(v, dtype=float), -1, 0)
    o = np.zeros_like(x)
    return np.stack([o, -z, y, z, o, -x, -y, x, o], axis=-1).reshape(*x.shape, 3, 3)


_EYE = np.eye(3)
NEARLY = 1e-9
"""A matrix counts as a rotation if its rows are orthonormal within this tolerance."""


def rotation_from_vector(v: ArrayLike) -> Matrix3:
    """Return the rotation matrix (3, 3) of a rotation vector [rad] (3,) (Rodrigues' formula)."""
    x, y, z = np.asarray(v, dtype=float).tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    a, b = 1.0, 0.5  # of K and K K, K the cross-product matrix
    if angle >= 1e-8:
        a, b = math.sin(angle) / angle, 2.0 * (math.sin(0.5 * angle) / angle) ** 2
    result: Matrix3 = np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )
    return result


def vector_from_rotation(R: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation vector [rad] (3,) of a rotation matrix (3, 3). Its length is in [0,
    pi]."""
    w, x, y, z = quaternion_from_rotation(R)
    norm = math.sqrt(x * x + y * y + z * z)
    if norm < 1e-12:
        return np.array([2.0 * x, 2.0 * y, 2.0 * z])
    factor = 2.0 * math.atan2(norm, w) / norm
    return np.array([x * factor, y * factor, z * factor])


def quaternion_from_rotation(R: ArrayLike) -> Quaternion:
    """Convert a rotation matrix (3, 3) to its unit quaternion (w, x, y, z) with w >= 0 (Shepperd's
    method)."""
    # Plain numbers take a third of the time of array elements.
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = np.asarray(R, dtype=float).tolist()
    candidates = [
        1.0 + xx + yy + zz,
        1.0 + xx - yy - zz,
        1.0 - xx + yy - zz,
        1.0 - xx - yy + zz,
    ]
    k = candidates.index(max(candidates))
    s = 2.0 * math.sqrt(max(candidates[k], 0.0))
    if k == 0:
        q = (s / 4, (zy - yz) / s, (xz - zx) / s, (yx - xy) / s)
    elif k == 1:
        q = ((zy - yz) / s, s / 4, (xy + yx) / s, (xz + zx) / s)
    elif k == 2:
        q = ((xz - zx) / s, (xy + yx) / s, s / 4, (yz + zy) / s)
    else:
        q = ((yx - xy) / s, (xz + zx) / s, (yz + zy) / s, s / 4)
    w, x, y, z = q
    sign = -1.0 if w < 0.0 else 1.0
    norm = sign * math.sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm


def levelling_rotation(gravity_sensor: ArrayLike) -> Matrix3:
    """Return the smallest rotation that rotates the specific force at rest J (3,) to (0, 0, |J|).

    This rotation is the tilt of method A, step 3: after the rotation, the sensor's x and y axes are
    horizontal. The rotation axis is horizontal, and the angle is atan2(hypot(Jx, Jy), Jz). For a
    sensor exactly upside down, the axis is undefined; the x axis is used.
    """
    up = np.asarray(gravity_sensor, dtype=float)
    ux, uy, uz = up / np.sqrt(up @ up)
    if uz > UPSIDE_DOWN:
        k = 1.0 / (1.0 + uz)
        xx, xy, yy = ux * ux * k, ux * uy * k, uy * uy * k
    else:  # 1 + uz keeps no digits there; the direction of the horizontal part does
        side = math.hypot(ux, uy)
        if side == 0.0:
            return np.diag([1.0, -1.0, -1.0])
        cx, cy, versine = ux / side, uy / side, 1.0 - uz
        xx, xy, yy = cx * cx * versine, cx * cy * versine, cy * cy * versine
    return np.array([[1.0 - xx, -xy, -ux], [-xy, 1.0 - yy, -uy], [ux, uy, uz]])


def orthonormalised(R: ArrayLike) -> Matrix3:
    """Return the nearest rotation to a (3, 3) matrix, in the least-squares sense (polar
    decomposition).
    """
    R = np.asarray(R, dtype=float)
    left = R.T @ R - _EYE
    if np.abs(left).max() < NEARLY and _turns_right(R):
        nearest: Matrix3 = R - 0.5 * (R @ left)  # one Newton step: the error is squared
        return nearest
    U, _, Vt = np.linalg.svd(R)
    result: Matrix3 = U @ Vt
    if not _turns_right(result):  # it mirrors
        result = U @ np.diag([1.0, 1.0, -1.0]) @ Vt
    return result


def _turns_right(R: Matrix3) -> bool:
    x, y, z = R.tolist()
    return bool(sum(a * b for a, b in zip(x, cross(y, z), strict=True)) >= 0.0)


def quaternion_from_vector(x: float, y: float, z: float) -> Quaternion:
    """Return the unit quaternion of a rotation vector [rad]."""
    square = x * x + y * y + z * z
    if square < 1e-8:  # sin and cos to double precision: the next terms are below 1e-17
        k = 0.5 - square / 48.0
        return 1.0 - square / 8.0, x * k, y * k, z * k
    angle = math.sqrt(square)
    k = math.sin(0.5 * angle) / angle
    return math.cos(0.5 * angle), x * k, y * k, z * k


def quaternion_product(p: Quaternion, q: Quaternion) -> Quaternion:
    """Return the normalised product p q: the rotation q followed by the rotation p."""
    pw, px, py, pz = p
    qw, qx, qy, qz = q
    w = pw * qw - px * qx - py * qy - pz * qz
    x = pw * qx + px * qw + py * qz - pz * qy
    y = pw * qy - px * qz + py * qw + pz * qx
    z = pw * qz + px * qy - py * qx + pz * qw
    k = 1.0 / math.sqrt(w * w + x * x + y * y + z * z)
    return w * k, x * k, y * k, z * k


def quaternion_turned(q: Quaternion, x: float, y: float, z: float) -> Quaternion:
    """Return q after a further rotation by the rotation vector (x, y, z) [rad] in body axes. The
    result has unit length."""
    return quaternion_product(q, quaternion_from_vector(x, y, z))


def rotation_from_quaternion(q: Sequence[float]) -> Matrix3:
    """Return the rotation matrix (3, 3) of a unit quaternion (w, x, y, z)."""
    w, x, y, z = q
    return np.array(rows_from_quaternion((w, x, y, z))).reshape(3, 3)


def rows_from_quaternion(
    q: tuple[Number, Number, Number, Number],
) -> tuple[Number, Number, Number, Number, Number, Number, Number, Number, Number]:
    """Return the rotation matrix of a unit quaternion, row by row. The components are numbers or
    columns (N,).
    """
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
    """Return the cross product of two vectors."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
