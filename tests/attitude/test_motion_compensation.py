"""Method B against rigid-body kinematics written out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucald.attitude.motion_compensation import (
    MotionCompensation,
    SpeedAverager,
    deflection,
)
from imucald.config.attitude import MotionCompensationSettings

G = 9.80665
UP = np.array([0.0, 0.0, G])


def felt(attitude: Rotation, acceleration) -> tuple[float, float, float]:
    """Specific force in body axes (x right, y forward, z up) of an acceleration in the earth's."""
    x, y, z = attitude.inv().apply(np.asarray(acceleration) + UP)
    return float(x), float(y), float(z)


def nose_up(pitch: float, right_down: float = 0.0) -> Rotation:
    """Attitude with the nose in the north."""
    return Rotation.from_rotvec([pitch, 0, 0]) * Rotation.from_rotvec([0, right_down, 0])


def driven(settings, speeds, samples):
    """Feed (t, speed) and (t, force, rate) in order of time; return the last result."""
    compensation = MotionCompensation(settings)
    events = sorted([(t, 0, v) for t, v in speeds] + [(t, 1, (f, w)) for t, f, w in samples],
                    key=lambda e: e[:2])  # fmt: skip
    result = None
    for t, kind, value in events:
        if kind:
            result = compensation.take_sample(t, *value)
        else:
            compensation.speed(t, value)
    return result


def test_acceleration_on_a_hill_is_taken_out():
    """Along the road, speed by wheels: what is left is gravity on the slope."""
    pitch, a = math.radians(7.0), 2.5
    along = nose_up(pitch).apply([0.0, a, 0.0])
    samples = [(0.1 * k, felt(nose_up(pitch), along), (0.0, 0.0, 0.0)) for k in range(200)]
    speeds = [(0.1 * k, 10.0 + a * 0.1 * k) for k in range(200)]
    result = driven(MotionCompensationSettings(), speeds, samples)
    assert result.raw_pitch == pytest.approx(pitch, abs=1e-9)
    assert result.pitch == pytest.approx(pitch, abs=1e-4)
    assert math.hypot(*result.force) == pytest.approx(G, abs=1e-9)


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.5, 0.5), st.floats(1.0, 30.0))
def test_a_turn_is_taken_out_whole(pitch, roll, yaw_rate, speed):
    """omega x v in full, at any lean: the body moves along its own forward axis."""
    attitude = nose_up(pitch, roll)
    w_earth = np.array([0.0, 0.0, yaw_rate])
    w = attitude.inv().apply(w_earth)
    velocity = attitude.apply([0.0, speed, 0.0])
    force = felt(attitude, np.cross(w_earth, velocity))
    result = driven(
        MotionCompensationSettings(), [(0.0, speed), (1.0, speed)], [(1.0, force, tuple(w))]
    )
    assert result.raw_pitch == pytest.approx(pitch, abs=1e-9)
    assert result.raw_roll == pytest.approx(math.atan2(math.sin(roll), math.cos(roll)), abs=1e-9)


@given(st.tuples(*[st.floats(-1, 1)] * 3), st.tuples(*[st.floats(-1, 1)] * 3))
def test_a_lever_arm_is_taken_out(w, change):
    """omega' x l + omega x (omega x l), the rate growing evenly."""
    lever = np.array([1.2, -0.4, 0.6])  # forward, left, up
    arm = np.array([-lever[1], lever[0], lever[2]])
    w, change = np.array(w), np.array(change)
    dt = 0.01
    before = w - change * dt
    extra = np.cross(change, arm) + np.cross(w, np.cross(w, arm))
    settings = MotionCompensationSettings(lever_arm=tuple(lever))
    compensation = MotionCompensation(settings)
    compensation.take_sample(0.0, (0.0, 0.0, G), tuple(before))
    result = compensation.take_sample(dt, tuple(np.array([0, 0, G]) + extra), tuple(w))
    assert result.force == pytest.approx((0.0, 0.0, G), abs=1e-6)


def test_zero_error_of_the_gyroscope_is_taken_off():
    compensation = MotionCompensation(MotionCompensationSettings())
    compensation.zero_error = (0.01, -0.02, 0.03)
    result = compensation.take_sample(0.0, (0.0, 0.0, G), (0.11, 0.08, 0.03))
    assert result.rate == pytest.approx((0.1, 0.1, 0.0), abs=1e-15)


# deflection ------------------------------------------------------------------------------------


@given(st.floats(-0.5, 0.5), st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))
def test_deflection_is_the_error_of_the_angle(angle, a, s):
    f_x = a * math.cos(angle) + G * math.sin(angle)
    f_z = G * math.cos(angle) - a * math.sin(angle)
    assert math.atan2(f_x - s, f_z) - angle == pytest.approx(deflection(angle, a, s), abs=1e-12)


def test_an_axis_in_the_direction_of_motion_has_no_deflection():
    assert deflection(0.0, 3.0, 3.0) == 0.0


@pytest.mark.parametrize("pitch_deg", [-12.0, -6.0, 6.0, 12.0])
@pytest.mark.parametrize("a", [-4.0, 3.0])
def test_pitch_is_nearer_the_truth_with_the_deflection(pitch_deg, a):
    """Speed over the map (satellites) on a slope: the whole pitch deflects."""
    pitch = math.radians(pitch_deg)
    samples = [(0.1 * k, felt(nose_up(pitch), (0.0, a, 0.0)), (0.0, 0.0, 0.0)) for k in range(60)]
    speeds = [(0.1 * k, 30.0 + a * 0.1 * k) for k in range(60)]
    result = driven(MotionCompensationSettings(speed_is="horizontal"), speeds, samples)
    uncorrected, corrected = abs(result.raw_pitch - pitch), abs(result.pitch - pitch)
    assert uncorrected > math.radians(0.08)
    assert corrected < 0.1 * uncorrected


@pytest.mark.parametrize("roll_deg", [-10.0, -5.0, 5.0, 10.0])
@pytest.mark.parametrize("yaw_rate", [-0.3, 0.3])
def test_roll_is_nearer_the_truth_with_the_deflection(roll_deg, yaw_rate):
    """Rate times speed as one number: the body's roll deflects the lateral axis."""
    roll, speed = math.radians(roll_deg), 12.0
    attitude = nose_up(0.0, roll)
    w = tuple(attitude.inv().apply([0.0, 0.0, yaw_rate]))
    force = felt(attitude, (-yaw_rate * speed, 0.0, 0.0))
    samples = [(0.1 * k, force, w) for k in range(100)]
    speeds = [(0.1 * k, speed) for k in range(100)]
    settings = MotionCompensationSettings(centripetal="plane", speed_is="horizontal")
    result = driven(settings, speeds, samples)
    uncorrected, corrected = abs(result.raw_roll - roll), abs(result.roll - roll)
    assert uncorrected > math.radians(0.1)
    assert corrected < 0.2 * uncorrected


def test_squat_deflects_and_the_slope_does_not_where_wheels_count():
    """The body pitches by 2 deg against the road when it accelerates; the road itself rises."""
    slope, squat, a = math.radians(5.0), math.radians(2.0), 5.0
    road, body = nose_up(slope), nose_up(slope + squat)
    speeds = [(0.05 * k, 8.0 + a * max(0.05 * k - 8.0, 0.0)) for k in range(201)]
    samples = []
    for k in range(201):
        t = 0.05 * k
        attitude, acceleration = (body, road.apply([0, a, 0])) if t > 8.0 else (road, (0, 0, 0))
        samples.append((t, felt(attitude, acceleration), (0.0, 0.0, 0.0)))
    result = driven(MotionCompensationSettings(), speeds, samples)
    uncorrected = abs(result.raw_pitch - slope - squat)
    assert abs(result.pitch - slope - squat) < uncorrected


# speed -----------------------------------------------------------------------------------------


def test_average_speed_is_of_the_middle_of_its_samples():
    averager = SpeedAverager(MotionCompensationSettings(average=0.2, delay=0.1))
    for k in range(20):
        found = averager.add_speed(0.05 * k, 2.0 * 0.05 * k)
    assert found.speed == pytest.approx(2.0 * (0.95 - 0.1))
    assert found.t == pytest.approx(0.95 - 0.1 - 0.1)


def test_old_speed_is_not_used():
    settings = MotionCompensationSettings(timeout=3.0)
    compensation = MotionCompensation(settings)
    for k in range(30):
        compensation.speed(0.1 * k, 2.0 * 0.1 * k)
    assert compensation.take_sample(3.0, (0.0, 2.0, G), (0.0, 0.0, 0.0)).known
    late = compensation.take_sample(6.5, (0.0, 2.0, G), (0.0, 0.0, 0.0))
    assert not late.known
    assert late.raw_pitch == pytest.approx(math.atan2(2.0, G))
