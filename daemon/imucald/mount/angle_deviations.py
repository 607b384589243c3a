"""Standard deviations of the single angles roll, pitch and yaw.

The covariance of a mount describes a rotation about the vehicle's axes. Each of the angles is a
rotation about an axis of its own. Yaw turns about the vehicle's z axis, pitch about the y axis
after the yaw rotation, and roll about the x axis after both rotations. At a yaw of 90 deg, for
example, an uncertainty about the vehicle's x axis is an uncertainty of the pitch.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucald.core.rotations import Matrix3, Vector, angles_from_rotation

UNKNOWN_VARIANCE = 1.0
"""Variance of the rotation about z [rad^2] above which the forward direction counts as unknown."""
LARGEST_CURVATURE = 0.1
"""Largest product of the tilt's deviation [rad] and tan(pitch) at which roll and yaw count as
known.

This product is the relative change of 1 / cos(pitch) within one standard deviation. Above 0.1, a
first-order calculation is too inaccurate: with sampled rotations, intervals of 95 % contained 91 %
of the values. The roll and yaw rotations then have nearly the same axis.
"""


def angle_deviations(
    R_vehicle_from_sensor: Matrix3, covariance: Sequence[Sequence[float]]
) -> Vector:
    """Return the standard deviations [rad] of roll, pitch and yaw; inf for an angle that is not
    known.

    R_vehicle_from_sensor: (3, 3). covariance: (3, 3) of the rotation vector about the vehicle's
    axes [rad^2]. The calculation is of first order, by the kinematics of intrinsic Z-Y-X angles.
    With c and s as cosine and sine of yaw, a rotation w changes roll by (c wx + s wy) / cos(pitch),
    pitch by c wy - s wx, and yaw by wz + tan(pitch) (c wx + s wy).
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
