"""The nine-state Kalman filter of method C: errors of attitude, gyroscope and accelerometer.

The state is x = (dp, dr, dy, bx, by, bz, dx, dy, dz). The state contains the attitude error
(rotation vector about east, north, up; C_true = exp(skew(e)) C), the random error of the gyroscope
[rad/s] and the random error of the accelerometer [m/s^2] in body axes. In right-forward-up axes of
the body, an error about the right axis is a pitch error, and an error about the forward axis is a
roll error.

The model is x_{k+1} = F x_k + w, e' = -C b, b' = w_b, d' = -d / T_a + w_d. The accelerometer's
random error is a Gauss-Markov process. The gyroscope's random error is a random walk, the
short-time form of a Gauss-Markov process. A Gauss-Markov process would forget an error that no
measurement shows (about the vertical, between two stops). Every estimate is fed back at once, so
the state is zero between updates, and only its covariance is stored.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucald.config.attitude import FilterSettings
from imucald.config.base import PerAxis, per_axis
from imucald.config.calibration import CalibrationSettings
from imucald.core.arrays import Array
from imucald.core.rotations import Rows, Vector, matrix_times

Measurement = tuple[Array, float, float, bool]
"""A measurement z = h . x + noise: h (9,), z, variance of the noise, and a flag. If the flag is
True, the variance of an unlikely z is increased.
"""

STATES = 9
YAW_STD_MAX = math.pi
"""Largest deviation of an unknown heading [rad]. At this value, its variance stops growing, so that
the numbers stay accurate.
"""
ROUNDED_S = 10.0
"""Time for which a rate without vibration stays within one step of its signal [s], while the
vehicle creeps or drives straight on a smooth road.
"""
_EYE = np.eye(STATES)


def of_axes(per_vehicle_axis: Vector) -> Vector:
    """Reorder three amounts without sign, such as deviations, from forward, left, up to right,
    forward, up.
    """
    x, y, z = per_vehicle_axis
    return y, x, z


class NineStateFilter:
    """Covariance (9, 9), and the estimated random errors that were fed back.

    bias: error of the gyroscope [rad/s]. accel_error: error of the accelerometer [m/s^2]. Both
    errors are in body axes, right-forward-up.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self.settings = settings
        self._gyro_noise = of_axes(settings.gyro_noise)
        self._gyro_random = of_axes(settings.gyro_random)
        random = settings.accel_random or CalibrationSettings().accelerometer_bias
        self.accel_random = of_axes(per_axis(random))
        """Deviations of the accelerometer's random error along right, forward, up [m/s^2]."""
        self.bias: Vector = (0.0, 0.0, 0.0)
        self.accel_error: Vector = (0.0, 0.0, 0.0)
        self.P: Array = np.zeros((STATES, STATES))

    def start(self, tilt_std: float, heading_std: float, gyro_std: PerAxis) -> None:
        """Begin again. The arguments are standard deviations [rad], [rad/s].

        The estimated gyroscope error is kept. The variance of this error also contains the random
        walk since the estimate.
        """
        gyro = [max(c**2, float(self.P[3 + i, 3 + i]))
                for i, c in enumerate(of_axes(per_axis(gyro_std)))]  # fmt: skip
        tilt = [tilt_std**2] * 2 + [heading_std**2]
        self.P = np.diag(tilt + gyro + [c**2 for c in self.accel_random])

    def turned_unseen(self, tilt_std: float, heading_std: float) -> None:
        """Add a rotation of the body that was not measured. The arguments are standard deviations
        [rad]."""
        self.P[0, 0] += tilt_std**2
        self.P[1, 1] += tilt_std**2
        self.P[2, 2] += heading_std**2
        self._hold_yaw()

    def turn_north(self, angle: float) -> None:
        """Rotate all attitudes about up by this angle [rad], for example when the first heading is
        taken.

        The errors about the level axes are rotated by the same rotation: C_true = R exp(e) C =
        exp(R e) R C.
        """
        T = np.eye(STATES)
        s, c = math.sin(angle), math.cos(angle)
        T[0:2, 0:2] = (c, -s), (s, c)
        P = T @ self.P @ T.T
        self.P = 0.5 * (P + P.T)

    def forget_heading(self) -> None:
        """Forget the heading and its correlation with the other states."""
        self.P[2, :] = self.P[:, 2] = 0.0
        self.P[2, 2] = YAW_STD_MAX**2

    def predict(
        self, C_nav_from_body: Rows, dt: float, turned: float, rounding: float = 0.0
    ) -> None:
        """Predict over dt [s]. turned: angle by which the body turned in this time [rad].

        rounding: variance of a mean rate that comes from the step size of the signal [(rad/s)^2].
        """
        s = self.settings
        keep_d = math.exp(-dt / s.accel_random_time)
        F = np.diag([1.0] * 6 + [keep_d] * 3)
        F[0:3, 3:6] = np.array(C_nav_from_body).reshape(3, 3) * -dt
        P = F @ self.P @ F.T
        g = self._gyro_noise
        least = min(g)
        grown = np.array(
            [(least * least + rounding * ROUNDED_S) * dt + (s.gyro_scale * turned) ** 2] * 3
            + [2.0 * c**2 * dt / s.gyro_random_time for c in self._gyro_random]
            + [c**2 * (1.0 - keep_d * keep_d) for c in self.accel_random]
        )
        P[np.diag_indices(STATES)] += grown
        if least < max(g):  # noise beyond that of the quietest axis turns with the body
            C = np.array(C_nav_from_body).reshape(3, 3)
            P[0:3, 0:3] += C @ np.diag([(c * c - least * least) * dt for c in g]) @ C.T
        self.P = 0.5 * (P + P.T)
        self._hold_yaw()
        dx, dy, dz = self.accel_error
        self.accel_error = (dx * keep_d, dy * keep_d, dz * keep_d)

    def update(self, measurements: Sequence[Measurement]) -> Vector:
        """Do a measurement update. Returns the attitude error to correct, about east, north, up
        [rad].

        All measurements are of the same time. Measurements with independent noise are applied one
        after another. The result is the same as for a joint update, and no inverse is needed.
        Joseph's form keeps P a valid covariance.
        """
        x = np.zeros(STATES)
        for h, z, variance, gated in measurements:
            self._take(x, h, z, variance, gated)
        bx, by, bz = self.bias
        self.bias = (bx + float(x[3]), by + float(x[4]), bz + float(x[5]))
        dx, dy, dz = self.accel_error
        self.accel_error = (dx + float(x[6]), dy + float(x[7]), dz + float(x[8]))
        return float(x[0]), float(x[1]), float(x[2])

    def _take(self, x: Array, h: Array, z: float, variance: float, gated: bool) -> None:
        """Correct x by the measurement z = h . x + noise.

        If z is far outside its expected spread, the variance of z is increased until z is inside.
        The correction is then limited, and the covariance decreases less than with a z that fits.
        """
        P = self.P
        Ph = P @ h
        expected = float(h @ Ph)
        innovation = z - float(h @ x)
        limit = self.settings.gate**2
        if gated and innovation * innovation > limit * (expected + variance):
            variance = innovation * innovation / limit - expected
        K = Ph / (expected + variance)
        A = _EYE - np.outer(K, h)
        P = A @ P @ A.T + np.outer(K, K) * variance
        self.P = 0.5 * (P + P.T)
        x += K * innovation

    def turn_body(self, D_new_from_old: Array) -> None:
        """Apply a new definition of the body's axes: v_new = D v_old, D (3, 3)."""
        D = D_new_from_old
        T = np.eye(STATES)
        T[3:6, 3:6] = T[6:9, 6:9] = D
        P = T @ self.P @ T.T
        self.P = 0.5 * (P + P.T)
        self.bias = matrix_times(D, self.bias)
        self.accel_error = matrix_times(D, self.accel_error)

    def forget_bias(self, rounding: float) -> None:
        """Reset the random part of the gyroscope error to a small value, because the constant part
        was measured again.

        rounding: variance of this measurement [(rad/s)^2].
        """
        self.bias = (0.0, 0.0, 0.0)
        self.P[3:6, :] = 0.0
        self.P[:, 3:6] = 0.0
        self.P[3:6, 3:6] = np.diag([max(c * c, rounding) for c in self._gyro_random])

    def std_along(self, x: float, y: float, z: float) -> float:
        """Return the standard deviation of the attitude error about a unit vector in east, north,
        up.
        """
        u = np.array([x, y, z])
        return math.sqrt(max(float(u @ self.P[0:3, 0:3] @ u), 0.0))

    def _hold_yaw(self) -> None:
        excess = float(self.P[2, 2]) / YAW_STD_MAX**2
        if excess > 1.0:
            k = 1.0 / math.sqrt(excess)  # a congruence: P stays a covariance
            self.P[2, :] *= k
            self.P[:, 2] *= k
