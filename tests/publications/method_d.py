"""Method D (CN103543289A), paragraph by paragraph, in plain numpy; angles in radians.

Formulas (1), (2), (6), (7), (8) and (12) are pictures and missing: *reconstructed* from the words.
Terminal axes: x right (horizontal axis of the text), y to the upper edge (longitudinal), z out.
"""

from __future__ import annotations

import math

import numpy as np

FULL = 2.0 * math.pi


def pitch_roll(A):
    """(1), (2), [0056]: angles of the y axis and of the x axis against the horizontal plane."""
    beside = [float(np.linalg.norm(np.cross(A, axis))) for axis in np.eye(3)]
    return math.atan2(A[1], beside[1]), math.atan2(A[0], beside[0])


def angle_first(pitch, roll):
    """[0070]: angle = (atan2(angleHengGun, angleFuYang) + 180) % 360, HengGun being roll."""
    return math.radians((math.degrees(math.atan2(roll, pitch)) + 180.0) % 360.0)


def angle_second(pitch, roll):
    """[0072]: angle = (atan2(angleFuYang, angleHengGun) + 180) % 360, FuYang being pitch."""
    return math.radians((math.degrees(math.atan2(pitch, roll)) + 180.0) % 360.0)


def azimuth_first(angle, compass):
    """[0079]."""
    return math.radians((math.degrees(angle) + math.degrees(compass) + 360.0) % 360.0)


def azimuth_second(angle, compass):
    """[0081]."""
    return math.radians((math.degrees(angle) - math.degrees(compass) + 360.0) % 360.0)


def projected(v, alpha, beta):
    """(3), (4), (5)."""
    X, Y, Z = v
    ca, sa, cb, sb = math.cos(alpha), math.sin(alpha), math.cos(beta), math.sin(beta)
    return np.array(
        [X * ca + Y * sa * sb + Z * cb * sa, Y * cb - Z * sb, -X * sa + Y * ca * sb + Z * cb * ca]
    )


def levelling_angles(B):
    """alpha and beta with which (3) to (5) do what [0088] wants: the mean lands on the vertical.

    [0093] calls alpha the y axis' angle and beta the x axis': put in so, they do not level.
    (4) is zero for tan(beta) = BY / BZ, (3) then for tan(alpha) = -BX / hypot(BY, BZ).
    """
    beta = math.atan2(B[1], B[2])
    return math.atan2(-B[0], math.hypot(B[1], B[2])), beta


def difference_correlations(waves):
    """(6) to (8): for each lag in (0, half a cycle), R_xz and R_yz of one cycle (N, 3).

    *Reconstructed*: the correlation of horizontal with vertical at +tau less that at -tau, over the
    cycle as if it repeated; plain sums, no transform.
    """
    n = len(waves)
    w = waves - waves.mean(axis=0)
    lags = range(1, n // 2)

    def R(axis, lag):
        return sum(w[i, axis] * w[(i + lag) % n, 2] for i in range(n))

    return np.array([[R(a, k) - R(a, -k) for a in (0, 1)] for k in lags])


def correlation_angle(accel):
    """401 to 409: angle of the motion to the y axis, clockwise, 0 to 360 deg; None at rest."""
    alpha, beta = levelling_angles(accel.mean(axis=0))
    waves = np.array([projected(v, alpha, beta) for v in accel])
    D = difference_correlations(waves)
    best = int(np.argmax(np.abs(D).sum(axis=1)))  # (6)
    dx, dy = D[best]
    if dx == 0.0 and dy == 0.0:
        return None
    theta = math.atan(abs(dx) / abs(dy)) if dy != 0.0 else 0.5 * math.pi  # (11)
    if dx >= 0.0:  # (12) by the quadrant of 408
        return theta if dy >= 0.0 else math.pi - theta
    return (FULL - theta) % FULL if dy >= 0.0 else math.pi + theta


def compass_angle(field, mean):
    """[0003]: horizontal projection of the head (the y axis), clockwise from the field's north.

    By vectors in terminal axes and not by (3) to (5), which leave another axis than y in place.
    """
    up = mean / np.linalg.norm(mean)
    east = np.cross(field, up)
    north = np.cross(up, east)
    return math.atan2(east[1], north[1]) % FULL


def plane_angle(mean):
    """Clockwise angle from the second coordinate system's y axis to the head's projection.

    (4) says what the plane's y axis is in terminal axes; (3) says the same of its x axis.
    """
    beta = levelling_angles(mean)[1]
    plane_y = np.array([0.0, math.cos(beta), -math.sin(beta)])
    up = mean / np.linalg.norm(mean)
    head = np.array([0.0, 1.0, 0.0]) - up[1] * up
    return math.atan2(-np.dot(up, np.cross(plane_y, head)), np.dot(plane_y, head))


def apart(a, b):
    """Size of the difference of two angles."""
    d = (a - b) % FULL
    return min(d, FULL - d)


class Choice:
    """204 to 20622: which of the two headings, cycle by cycle."""

    def __init__(self, turn=60.0, tilt_on_turn=5.0, differ=30.0, tilt=5.0):
        self.turn, self.on_turn, self.differ, self.tilt = map(
            math.radians, (turn, tilt_on_turn, differ, tilt)
        )
        self.last = None  # compass, tilt heading, correlation heading of the last cycle

    def take(self, compass, by_tilt, by_waves, pitch, roll):
        """Heading of this cycle, whether by tilt, whether a turn."""
        last, self.last = self.last, (compass, by_tilt, by_waves)
        steep = max(abs(pitch), abs(roll))
        is_turn = last is not None and apart(compass, last[0]) > self.turn  # [0038]
        if is_turn:
            use_tilt = steep >= self.on_turn  # 2051, 2052
        else:
            both = [one for one in (last, self.last) if one is not None and one[2] is not None]
            against = [apart(one[1], one[2]) >= self.differ for one in both]  # claim 3
            use_tilt = not (len(against) == 2 and all(against)) and steep >= self.tilt  # 2061-20622
        return (by_tilt if use_tilt or by_waves is None else by_waves), use_tilt, is_turn


def heading_of_cycle(accel, compass, minus_g=False):
    """Tilt and correlation headings of one cycle, clockwise from north, by the first system.

    The first system's formulas fit an accelerometer that reads -g upwards; one that reads +g is
    turned about first. The correlation angle counts from the plane's y axis ([0139]).
    """
    mean = accel.mean(axis=0)
    pitch, roll = pitch_roll(mean if minus_g else -mean)
    by_tilt = azimuth_first(angle_first(pitch, roll), compass)
    angle = correlation_angle(-accel if minus_g else accel)
    plane = compass - plane_angle(-mean if minus_g else mean)
    by_waves = None if angle is None else (angle + plane) % FULL
    return by_tilt, by_waves, pitch, roll
