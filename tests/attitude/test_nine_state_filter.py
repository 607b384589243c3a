"""The nine-state filter: against the textbook, its own statistics, and for a day."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.stats import chi2

from imucald.attitude.kalman import STATES, YAW_STD_MAX, NineStateFilter
from imucald.config.attitude import FilterSettings
from imucald.config.calibration import CalibrationSettings
from imucald.core.rotations import quaternion_from_vector, rows_from_quaternion

G = 9.80665


BIAS = CalibrationSettings().accelerometer_bias


def started(**changes) -> NineStateFilter:
    kalman = NineStateFilter(FilterSettings(**changes))
    kalman.start(0.03, 0.5, 0.01)
    return kalman


def rotation(rng):
    return rows_from_quaternion(quaternion_from_vector(*rng.normal(0.0, 1.0, 3)))


def test_time_update_is_the_models_transition():
    """F from the continuous error model by scipy's matrix exponential."""
    s = FilterSettings()
    rng = np.random.default_rng(1)
    kalman = started()
    A = rng.normal(size=(STATES, STATES))
    kalman.P = P = A @ A.T * 1e-4
    C, dt = rotation(rng), 0.7
    M = np.zeros((STATES, STATES))
    M[0:3, 3:6] = -np.array(C).reshape(3, 3)
    M[6:9, 6:9] = -np.eye(3) / s.accel_random_time
    F = expm(M * dt)
    kalman.predict(C, dt, 0.0)
    noise = kalman.P - F @ P @ F.T
    assert noise == pytest.approx(np.diag(np.diag(noise)), abs=1e-12)
    assert np.all(np.diag(noise) > 0.0)
    assert noise[3, 3] == pytest.approx(2.0 * s.gyro_random[0] ** 2 * dt / s.gyro_random_time)
    expected = BIAS**2 * (1.0 - math.exp(-2.0 * dt / s.accel_random_time))
    assert noise[6, 6] == pytest.approx(expected)


def test_measurement_update_is_the_textbooks():
    """Several numbers one after another against all at once, with the inverse."""
    rng = np.random.default_rng(2)
    kalman = started()
    A = rng.normal(size=(STATES, STATES))
    kalman.P = P = A @ A.T
    H, z = rng.normal(size=(3, STATES)), rng.normal(size=3)
    variances = np.array([0.5, 1.0, 2.0])
    S = H @ P @ H.T + np.diag(variances)
    K = P @ H.T @ np.linalg.inv(S)
    x = K @ z
    error = kalman.update([(h, zi, r, False) for h, zi, r in zip(H, z, variances, strict=True)])
    assert pytest.approx((np.eye(STATES) - K @ H) @ P, abs=1e-9) == kalman.P
    assert error == pytest.approx(x[0:3])
    assert kalman.bias == pytest.approx(x[3:6])
    assert kalman.accel_error == pytest.approx(x[6:9])


def test_an_unlikely_measurement_is_widened():
    kalman, plain = started(), started()
    h = np.zeros(STATES)
    h[0] = 1.0
    (step, _, _), (unbounded, _, _) = (
        k.update([(h, 1.0, 1e-4, gated)]) for k, gated in ((kalman, True), (plain, False))
    )
    assert unbounded > 0.8
    assert 0.0 < step < 0.1
    assert kalman.P[0, 0] > 9.0 * plain.P[0, 0]


def test_new_axes_of_the_body_turn_its_errors():
    kalman = started()
    kalman.bias, kalman.accel_error = (0.01, 0.02, 0.03), (0.1, 0.2, 0.3)
    kalman.P[3, 3] = 4.0
    quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    kalman.turn_body(quarter)
    assert kalman.bias == pytest.approx((-0.02, 0.01, 0.03))
    assert kalman.accel_error == pytest.approx((-0.2, 0.1, 0.3))
    assert kalman.P[4, 4] == pytest.approx(4.0)


def test_errors_are_as_large_as_it_says():
    """NEES of all nine states over many runs of its own model, within its 95 % bounds."""
    s = FilterSettings(gyro_scale=0.0, accel_random_time=60.0)
    rng = np.random.default_rng(7)
    runs, steps, dt, sigma = 40, 120, 1.0, 0.004
    tilt, gyro = 0.03, 0.003
    total = np.zeros(3)
    for _ in range(runs):
        kalman = NineStateFilter(s)
        kalman.start(tilt, tilt, gyro)
        x = np.concatenate([rng.normal(0, tilt, 3), rng.normal(0, gyro, 3), rng.normal(0, BIAS, 3)])
        for k in range(steps):
            C = rows_from_quaternion(quaternion_from_vector(0.1 * math.sin(0.1 * k), 0.0, 0.05 * k))
            R = np.array(C).reshape(3, 3)
            keep = math.exp(-dt / s.accel_random_time)
            # the truth's bias less the estimate turns the attitude; then everything walks
            x[0:3] += -R @ (x[3:6] - kalman.bias) * dt
            x[0:3] += rng.normal(0, s.gyro_noise[0] * math.sqrt(dt), 3)
            x[3:6] += rng.normal(0, s.gyro_random[0] * math.sqrt(2 * dt / s.gyro_random_time), 3)
            x[6:9] = keep * x[6:9] + rng.normal(0, BIAS * math.sqrt(1 - keep**2), 3)
            kalman.predict(C, dt, 0.0)
            # the filter has fed its estimate back: errors are what is left of the state
            left = x - np.concatenate([np.zeros(3), kalman.bias, kalman.accel_error])
            measurements = []
            for axis, other, sign in ((0, 1, -1.0), (1, 0, 1.0)):
                h = np.zeros(STATES)
                h[axis] = -1.0
                h[6:9] = sign * R[other] / G
                measurements.append((h, float(h @ left) + rng.normal(0, sigma), sigma**2, True))
            h = np.zeros(STATES)
            h[2] = -1.0
            measurements.append((h, float(h @ left) + rng.normal(0, 0.03), 0.03**2, True))
            x[0:3] -= kalman.update(measurements)
            if k in (10, 50, 119):
                left = x - np.concatenate([np.zeros(3), kalman.bias, kalman.accel_error])
                total[(10, 50, 119).index(k)] += left @ np.linalg.solve(kalman.P, left)
    low, high = (chi2.ppf(p, STATES * runs) / runs for p in (0.025 / 3, 1.0 - 0.025 / 3))
    assert np.all((total / runs > low) & (total / runs < high)), (total / runs, low, high)


@pytest.mark.slow
def test_a_day_leaves_a_covariance():
    """Sixty thousand updates with tilt only: symmetric, positive, bounded; yaw stays a number."""
    kalman = NineStateFilter(FilterSettings())
    kalman.start(0.03, 0.0, 0.01)
    rng = np.random.default_rng(5)
    error = np.zeros(3)  # of the attitude; the truth's biases are zero
    for k in range(21_600):  # every four seconds
        C = rows_from_quaternion(quaternion_from_vector(0.05 * math.sin(k), 0.03, 0.4 * k))
        R = np.array(C).reshape(3, 3)
        error += R @ kalman.bias * 4.0
        left = np.concatenate([error, -np.array(kalman.bias), -np.array(kalman.accel_error)])
        kalman.predict(C, 4.0, 0.8)
        measurements = []
        for axis, other, sign in ((0, 1, -1.0), (1, 0, 1.0)):
            h = np.zeros(STATES)
            h[axis] = -1.0
            h[6:9] = sign * R[other] / G
            measurements.append((h, float(h @ left) + rng.normal(0.0, 0.005), 0.005**2, True))
        error -= kalman.update(measurements)
    P = kalman.P
    assert np.array_equal(P, P.T)
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert math.sqrt(P[2, 2]) <= YAW_STD_MAX * (1.0 + 1e-9)
    assert math.sqrt(max(P[0, 0], P[1, 1])) < math.radians(0.5)
    assert all(abs(b) < 4.0 * math.sqrt(P[i, i]) for i, b in enumerate(kalman.bias, 3))
