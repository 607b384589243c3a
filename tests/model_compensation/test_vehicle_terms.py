"""Lever arm and suspension: motions whose truth is known in closed form; noise stays as it is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.core.samples import GRAVITY
from imucald.model_compensation import compensation_from_model
from imucald.model_compensation.filters import SuspensionFilter
from imucald.model_compensation.terms import SuspensionTerms

DT = 0.01
CHANNELS = {"accel", "gyro"}


def stage(model, suspension=True):
    return compensation_from_model(model, suspension).vehicle_correction(CHANNELS)


def run(made, rates, forces, dt=DT):
    """Corrected forces (N, 3) and rates (N, 3) of samples in vehicle axes."""
    found, turning = [], []
    for i, (w, f) in enumerate(zip(rates.tolist(), forces.tolist(), strict=True)):
        turning.append(made.frame(i * dt, {"gyro": tuple(w)})["gyro"])
        found.append(made.frame(i * dt + 0.3 * dt, {"accel": tuple(f)})["accel"])
    return np.array(found), np.array(turning)


def at_lever(w, dw, arm):
    return np.cross(dw, arm) + np.cross(w, np.cross(w, arm))


@pytest.mark.parametrize("arm", [(1.5, 0.0, 0.0), (-2.0, 0.5, 0.8)])
def test_the_lever_arm_of_a_steady_turn_is_gone(arm):
    n = 300
    w = np.tile([0.02, -0.03, 0.6], (n, 1))
    forces = np.tile([0.3, 2.0, GRAVITY], (n, 1)) + at_lever(w[0], np.zeros(3), arm)
    found, _ = run(stage({"mount": {"lever_arm_m": list(arm)}}), w, forces)
    np.testing.assert_allclose(found[50:], np.tile([0.3, 2.0, GRAVITY], (n - 50, 1)), atol=1e-6)


def test_of_slow_steering_little_of_the_lever_arm_is_left():
    """A lane change: yaw rate swings at 0.3 Hz; the observer lags by 50 ms."""
    arm = np.array([1.5, 0.3, 0.0])
    t = np.arange(2000) * DT
    omega = 2.0 * math.pi * 0.3
    w = np.zeros((len(t), 3))
    dw = np.zeros_like(w)
    w[:, 2], dw[:, 2] = 0.3 * np.sin(omega * t), 0.3 * omega * np.cos(omega * t)
    more = np.array([at_lever(a, b, arm) for a, b in zip(w, dw, strict=True)])
    found, _ = run(stage({"mount": {"lever_arm_m": arm.tolist()}}), w, more)
    assert np.sqrt((found[200:] ** 2).mean()) < 0.15 * np.sqrt((more[200:] ** 2).mean())


def test_a_gyroscope_that_fell_silent_takes_nothing_off():
    made = stage({"mount": {"lever_arm_m": [1.0, 0.0, 0.0]}})
    made.frame(0.0, {"gyro": (0.0, 0.0, 1.0)})
    assert made.frame(0.2, {"accel": (0.0, 0.0, 9.8)})["accel"] == pytest.approx((1.0, 0, 9.8))
    assert made.frame(0.3, {"accel": (0.0, 0.0, 9.8)})["accel"] == (0.0, 0.0, 9.8)
    made.frame(0.4, {"gyro": (0.0, 0.0, 1.0)})
    made.gap()
    assert made.frame(0.41, {"accel": (0.0, 0.0, 9.8)})["accel"] == (0.0, 0.0, 9.8)


def leaning_body(fx, fy, lean):
    """What sensors in the body say of (fx, fy, g) in road axes: rotation matrices, no shortcut."""
    roll, pitch = lean
    cr, sr, cp, sp = math.cos(roll), math.sin(roll), math.cos(pitch), math.sin(pitch)
    R_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    R_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    return (R_y @ R_x).T @ np.array([fx, fy, GRAVITY])


GRADIENTS = {"suspension": {"squat_gradient": 0.006, "dive_gradient": 0.01, "roll_gradient": 0.017}}


@pytest.mark.parametrize(("fx", "fy"), [(3.0, 0.0), (-4.0, 0.0), (0.0, 5.0), (-2.0, -3.0)])
def test_a_body_at_rest_on_its_springs_is_put_upright(fx, fy):
    lean = (0.017 * fy, -(0.006 if fx > 0 else 0.01) * fx)
    force = leaning_body(fx, fy, lean)
    forces = np.tile(force, (400, 1))
    found, _ = run(stage(GRADIENTS), np.zeros_like(forces), forces)
    left = np.abs(found[-1] - [fx, fy, GRAVITY]).max()
    assert left < 0.02 * np.abs(force - [fx, fy, GRAVITY]).max()
    off, _ = run(stage(GRADIENTS, suspension=False), np.zeros_like(forces), forces)
    assert np.array_equal(off, forces)


def test_the_rate_of_leaning_is_taken_off_the_gyroscope():
    """Side force that swings slowly: all of the body's roll rate is its springs'."""
    omega = 2.0 * math.pi * 0.2
    t = np.arange(3000) * DT
    roll = 0.03 * np.sin(omega * t)
    forces = np.array([leaning_body(0.0, r / 0.017, (r, 0.0)) for r in roll])
    rates = np.zeros_like(forces)
    rates[:, 0] = 0.03 * omega * np.cos(omega * t)
    _, found = run(stage(GRADIENTS), rates, forces)
    assert np.abs(found[500:]).max() < 0.2 * np.abs(rates).max()


def test_an_accelerometer_that_fell_silent_in_mid_swing_turns_no_rate():
    made = stage(GRADIENTS)
    for i in range(50):  # the body swings while the force still rises
        made.frame(i * DT, {"accel": (0.0, 0.08 * i, GRAVITY)})
    assert made.frame(0.51, {"gyro": (0.1, 0.2, 0.3)})["gyro"] != (0.1, 0.2, 0.3)
    assert made.frame(3.0, {"gyro": (0.1, 0.2, 0.3)})["gyro"] == pytest.approx((0.1, 0.2, 0.3))


def test_a_sensor_of_ten_a_second_and_one_of_a_thousand_lean_the_same():
    for rate in (10.0, 1000.0):
        suspension = SuspensionFilter(SuspensionTerms(roll=0.01, squat=0.004, dive=0.004))
        for i in range(int(4.0 * rate)):
            lean = suspension.push(i / rate, 2.0, 0.0 if i < rate else 3.0)
        assert lean[0] == pytest.approx(0.03 / (1.0 + 0.01 * GRAVITY), rel=1e-3)
        assert lean[1] == pytest.approx(-0.008 / (1.0 + 0.004 * GRAVITY), rel=1e-3)


USUAL = {"suspension": {"squat_gradient": 0.0035, "dive_gradient": 0.004, "roll_gradient": 0.008}}


def shaken(rng, rms, n):
    """Vibration as of a body on the road: white above 2 Hz, less below."""
    keep = math.exp(-2.0 * math.pi * 2.0 * DT)
    white = rng.normal(0.0, 1.0, (n, 3))
    out = np.zeros_like(white)
    for i in range(1, n):
        out[i] = keep * out[i - 1] + white[i] - white[i - 1]
    return rms * out / out.std(axis=0)


@pytest.mark.parametrize(
    "model", [{"mount": {"lever_arm_m": [1.5, 0.3, 0.5]}}, USUAL], ids=["lever", "suspension"]
)
def test_noise_is_hardly_made_louder(model):
    """A consumer part at 100 Hz on a bad road; a long lever, the springs of most cars.

    What is added to the rates is less than what suspension there is in a drive (see `test_gain`).
    """
    rng = np.random.default_rng(7)
    n = 6000
    rates = rng.normal(0.0, 0.0042, (n, 3)) + np.array([0.0, 0.0, 0.2])
    forces = shaken(rng, 0.15, n) + np.array([0.5, 3.0, GRAVITY])
    found, turning = run(stage(model), rates, forces)
    assert (found[100:].std(axis=0) < 1.05 * forces[100:].std(axis=0)).all()
    assert (turning[100:].std(axis=0) < 1.35 * rates[100:].std(axis=0)).all()


def test_the_mount_coming_and_going_begins_the_filters_anew():
    made = stage({**GRADIENTS, "mount": {"lever_arm_m": [1.0, 0.0, 0.0]}})
    fresh = stage({**GRADIENTS, "mount": {"lever_arm_m": [1.0, 0.0, 0.0]}})
    for i in range(50):
        made.frame(i * DT, {"gyro": (0.0, 0.0, 1.0)})
        made.frame(i * DT, {"accel": (2.0, 3.0, 9.8)})
    assert made.frame(0.5, {"gyro": None, "accel": None}) == {"gyro": None, "accel": None}
    later = {"gyro": (0.0, 0.0, 0.5), "accel": (1.0, 1.0, 9.8)}
    assert made.frame(0.51, dict(later)) == fresh.frame(0.51, dict(later))
