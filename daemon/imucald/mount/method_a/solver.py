"""The published variable-speed straight-line solver (method A, steps 4-6), kept as published.

Pure functions on sample arrays. The target angle lambda turns levelled axes into vehicle axes:
L'x = Lx cos(lambda) - Ly sin(lambda), L'y = Lx sin(lambda) + Ly cos(lambda). It is not the mount's
Z-Y-X yaw angle, but the two are equal for a level sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imucald.core.errors import EstimateError
from imucald.core.rotations import Matrix3, levelling_rotation
from imucald.motion.straight import steering_is_small, windows_agree, yaw_rate_is_small
from imucald.mount.method_a.levelling import levelled, tilt_angles
from imucald.mount.method_a.settings import PublishedSettings
from imucald.mount.method_a.static_test import static_windows

Floats = NDArray[np.float64]


def target_angles(levelled_accel: ArrayLike) -> Floats:
    """lambda_i = -atan2(R'y_i, R'x_i) of each levelled sample; (N, 3) or (N, 2) -> (N,) [rad]."""
    a = np.asarray(levelled_accel, dtype=float)
    result: Floats = -np.arctan2(a[:, 1], a[:, 0])
    return result


def with_sign(angles: ArrayLike, accelerating: ArrayLike) -> Floats:
    """Resolve braking, which gives lambda + 180 deg: angles (N,) [rad], accelerating (N,) bool."""
    a = np.asarray(angles, dtype=float)
    return np.where(np.asarray(accelerating, dtype=bool), a, a + math.pi)


def combined_angle(angles: ArrayLike, weights: ArrayLike) -> tuple[float, float]:
    """Circular mean [rad] of angles (N,), weighted, and the resultant's length in [0, 1]."""
    w = np.asarray(weights, dtype=float)
    a = np.asarray(angles, dtype=float)
    total = float(np.sum(w))
    if total <= 0.0:
        raise EstimateError("no sample has weight: a target angle needs accelerated motion")
    x, y = float(w @ np.cos(a)) / total, float(w @ np.sin(a)) / total
    return math.atan2(y, x), math.hypot(x, y)


def combined_axis(angles: ArrayLike, weights: ArrayLike) -> tuple[float, float]:
    """Circular mean [rad] of angles (N,) that are known up to 180 deg, and the resultant."""
    double, resultant = combined_angle(2.0 * np.asarray(angles, dtype=float), weights)
    return 0.5 * double, resultant


def rotation_about_up(angle: float) -> Matrix3:
    """Rz(angle): step 6's L' = Rz(lambda) L; (3, 3)."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def correction_rotation(static_force: ArrayLike, target_angle: float) -> Matrix3:
    """R_vehicle_from_sensor = Rz(lambda) levelling(J) (step 6).

    For the accelerometer and for any other sensor whose axes are parallel to it.
    """
    return rotation_about_up(target_angle) @ levelling_rotation(static_force)


@dataclass(frozen=True)
class PublishedSolution:
    """What the published method gives for one recording.

    static_force: J (3,) [m/s^2]; tilt: alpha, beta, gamma [rad]; target_angle: lambda [rad];
    resultant: agreement of the lambda_i, 1 is perfect; used: samples of straight variable motion.
    """

    static_force: Floats
    tilt: tuple[float, float, float]
    target_angle: float
    resultant: float
    used: int
    R_vehicle_from_sensor: Matrix3


def straight_samples(
    angles: ArrayLike,
    settings: PublishedSettings,
    steering: ArrayLike | None = None,
    yaw_rate: ArrayLike | None = None,
) -> NDArray[np.bool_]:
    """Step 4 on arrays (N,): the first preferred group whose signals are there; (N,) bool."""
    s = settings.calibration.straight
    found: dict[str, NDArray[np.bool_]] = {}
    if steering is not None:
        found["steering"] = steering_is_small(steering, s.steering_limit)
    if yaw_rate is not None:
        found["yaw_rate"] = yaw_rate_is_small(yaw_rate, s.yaw_rate_limit_without_speed)
    if "consistency" in s.recognisers:
        found["consistency"] = windows_agree(angles, s.consistency_window, s.consistency_range)
    for group in s.groups:
        if all(name in found for name in group):
            agree: NDArray[np.bool_] = np.logical_and.reduce([found[name] for name in group])
            return agree
    raise EstimateError("no recogniser of straight motion has its signal")


def solve_published(
    accel: ArrayLike,
    settings: PublishedSettings,
    accelerating: ArrayLike,
    steering: ArrayLike | None = None,
    yaw_rate: ArrayLike | None = None,
) -> PublishedSolution:
    """Method A on one recording, all arrays on the accelerometer's samples.

    accel: (N, 3) [m/s^2]; accelerating: (N,) bool, speed grows (from dv/dt, the brake switch, or
    the first motion after standstill); steering (N,) [rad]; yaw_rate (N,) [rad/s].
    Raises EstimateError where the recording holds no standstill or no variable-speed motion.
    """
    a = np.asarray(accel, dtype=float)
    test = settings.calibration.static
    count = test.samples
    static = np.flatnonzero(static_windows(a, count, test.threshold))
    if len(static) == 0:
        raise EstimateError("no standstill in the recording: nothing to level with")
    first = int(static[0]) * count
    J = a[first : first + count].mean(axis=0)
    R = levelled(a, J)
    angles = target_angles(R)
    horizontal = np.hypot(R[:, 0], R[:, 1])
    motion = horizontal >= settings.calibration.straight.min_speed_change
    motion &= straight_samples(angles, settings, steering, yaw_rate)
    if not motion.any():
        raise EstimateError("no straight variable-speed motion in the recording")
    signed = with_sign(angles, accelerating)[motion]
    target_angle, resultant = combined_angle(signed, horizontal[motion])
    return PublishedSolution(
        static_force=J,
        tilt=tilt_angles(J),
        target_angle=target_angle,
        resultant=resultant,
        used=int(np.count_nonzero(motion)),
        R_vehicle_from_sensor=correction_rotation(J, target_angle),
    )
