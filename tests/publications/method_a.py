"""Method A (application CN 201610826380), claim by claim, in plain numpy.

Claims 8 and 9 print their formulas as pictures, which are missing: marked *reconstructed*.
"""

from __future__ import annotations

import math
from itertools import combinations

import numpy as np


def is_static(samples, thresholds) -> bool:
    """Claim 7: on each axis the largest less the smallest value is at most the threshold."""
    return all(
        max(s[i] for s in samples) - min(s[i] for s in samples) <= thresholds[i] for i in range(3)
    )


def deflection_angles(J):
    """Claim 8, *reconstructed*: each axis against its own in a level frame, in a vertical plane.

    x and y against the horizontal, z against the vertical, so that with the size of gravity
    sin(alpha), sin(beta), cos(gamma) are the direction of J.
    """
    beside = [float(np.linalg.norm(np.cross(J, axis))) for axis in np.eye(3)]
    # asin and acos keep no digits near their ends: the same angles by their tangents
    return math.atan2(J[0], beside[0]), math.atan2(J[1], beside[1]), math.atan2(beside[2], J[2])


def vertical(alpha, beta, gamma):
    """Direction of gravity from the three angles alone (unit vector, sensor axes)."""
    return np.array([math.sin(alpha), math.sin(beta), math.cos(gamma)])


def turn_about(axis, angle):
    """Rodrigues' formula; axis (3,) of length 1."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + math.sin(angle) * K + (1.0 - math.cos(angle)) * (K @ K)


def levelling(J):
    """Claim 9, *reconstructed*: the shortest turn that takes J to the vertical.

    About J x z by the angle gamma. Upside down that axis keeps no digits by subtraction; J's own
    horizontal part gives it. Exactly upside down every horizontal axis is as short: x.
    """
    size = math.sqrt(J[0] ** 2 + J[1] ** 2 + J[2] ** 2)
    x, y = J[0] / size, J[1] / size
    beside = math.hypot(x, y)
    if beside == 0.0:
        return np.eye(3) if J[2] > 0.0 else turn_about((1.0, 0.0, 0.0), math.pi)
    return turn_about((y / beside, -x / beside, 0.0), math.atan2(beside, J[2] / size))


def group_angles(accel, J=None):
    """Claim 2: the angle of each group, from its two horizontal components.

    lambda_i such that claim 5's turn puts the whole acceleration on +x (L'y = 0, L'x > 0).
    """
    R = accel if J is None else accel @ levelling(J).T
    return np.array([-math.atan2(y, x) for x, y, *_ in R])


def between(a, b):
    """Size of the difference of two angles."""
    d = (a - b) % (2.0 * math.pi)
    return min(d, 2.0 * math.pi - d)


def agree(angles, spread) -> bool:
    """Claim 2: the errors between the angles lie within the set range.

    An arc holds them all when no more than `spread` is needed, counted from some of them.
    """
    if len(angles) == 1:
        return True
    best = min(max((b - a) % (2.0 * math.pi) for b in angles) for a in angles)
    return best <= spread


def straight(steering=None, yaw_rate=None, steering_limit=math.inf, yaw_rate_limit=math.inf,
             need="any"):  # fmt: skip
    """Claim 4, "at least one of": the steering wheel, the angular rate, or both of them."""
    tests = []
    if steering is not None:
        tests.append(np.abs(steering) <= steering_limit)
    if yaw_rate is not None:
        tests.append(np.abs(yaw_rate) <= yaw_rate_limit)
    return np.logical_or.reduce(tests) if need == "any" else np.logical_and.reduce(tests)


def target_angle(angles, weights, accelerating=None):
    """Claims 2 and 3: the target angle from those of the set; a braking is turned by 180 deg.

    The weighted circular mean by components; the claim only says "according to".
    """
    x = y = 0.0
    for i, (angle, weight) in enumerate(zip(angles, weights, strict=True)):
        sign = 1.0 if accelerating is None or accelerating[i] else -1.0
        x += sign * weight * math.cos(angle)
        y += sign * weight * math.sin(angle)
    return math.atan2(y, x)


def corrected(L, target):
    """Claim 5: L'x = Lx cos - Ly sin, L'y = Lx sin + Ly cos; (N, 2 or 3)."""
    out = np.array(L, dtype=float)
    out[:, 0] = L[:, 0] * math.cos(target) - L[:, 1] * math.sin(target)
    out[:, 1] = L[:, 0] * math.sin(target) + L[:, 1] * math.cos(target)
    return out


def corrected_sensor(values, J, target):
    """Claim 6, end: tilt first, then the target angle, for every parallel sensor (N, 3)."""
    return corrected(values @ levelling(J).T, target)


def solve(accel, J, usable, accelerating, least):
    """Claims 1 to 6 on one recording: the rotation sensor -> vehicle (3, 3), and lambda.

    usable: (N,) bool, straight by claim 2 or 4; least: horizontal size that varies at all.
    """
    R = accel @ levelling(J).T
    size = np.hypot(R[:, 0], R[:, 1])
    use = usable & (size >= least)
    lam = target_angle(group_angles(R[use]), size[use], np.asarray(accelerating)[use])
    return corrected_sensor(np.eye(3), J, lam).T, lam


def all_pairs_within(angles, spread) -> bool:
    """Claim 2 read pair by pair; the same as `agree` below 120 deg."""
    return all(between(a, b) <= spread for a, b in combinations(angles, 2))
