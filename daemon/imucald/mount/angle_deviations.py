"""Standard deviations of roll, pitch and yaw, each as a single angle.

The covariance of a mount describes a rotation about the vehicle's axes. Each angle is a rotation
about its own axis: yaw about the vehicle's z, pitch about the y axis after the yaw rotation, roll
about the x axis after both. At a yaw of 90 deg, for example, the uncertainty about x is an
uncertainty of the pitch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucald.core.rotations import Matrix3, Vector, angles_from_rotation

UNKNOWN_VARIANCE = 1.0
"""Variance of the rotation about z [rad^2] above which the forward direction counts as unknown."""
LARGEST_CURVATURE = 0.1
"""Largest value of the deviation of the tilt [rad] times tan(pitch).

This product is the relative change of 1 / cos(pitch) within one standard deviation. Beyond a tenth,
the first order is too inaccurate (with sampled rotations, 95 % intervals hold 91 %). Roll and yaw
then act as one angle.
"""


def angle_deviations(
    R_vehicle_from_sensor: Matrix3, covariance: Sequence[Sequence[float]]
) -> Vector:
    """Standard deviations [rad] of roll, pitch and yaw; inf if an angle is not known.

    R_vehicle_from_sensor: (3, 3). covariance: (3, 3) of the rotation vector about the vehicle's
    axes [rad^2]. First order, by the kinematics of intrinsic Z-Y-X angles. With c and s the cosine
    and sine of yaw, a rotation w changes roll by (c wx + s wy) / cos(pitch), pitch by c wy - s wx,
    and yaw by wz + tan(pitch) (c wx + s wy).
    """
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = covariance
    _, pitch, yaw = angles_from_rotation(R_vehicle_from_sensor)
    knows_yaw = zz < UNKNOWN_VARIANCE
    if not knows_yaw:  # then the better known direction of x and y is unknown too
        xx = yy = max(xx, yy)
        xy = 0.0
    c, s = math.cos(yaw), math.sin(yaw)
    forward = c * c * xx + 2.0 * c * s * xy + s * s * yy
    sideways = s * s * xx - 2.0 * c * s * xy + c * c * yy
    if not math.isfinite(forward + sideways):
        return math.inf, math.inf, math.inf
    steepness = math.tan(pitch)
    of_roll = of_yaw = math.inf
    if math.sqrt(max(forward, sideways, 0.0)) * abs(steepness) < LARGEST_CURVATURE:
        of_roll = math.sqrt(max(forward, 0.0)) / math.cos(pitch)
        if knows_yaw:
            shared = c * xz + s * yz
            of_yaw = math.sqrt(max(zz + steepness * (steepness * forward + 2.0 * shared), 0.0))
    return of_roll, math.sqrt(max(sideways, 0.0)), of_yaw
