"""Zeros and gains of the accelerometer that step in mid-drive, and what a constant zero leaves."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_estimator import drive, good_around

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY, Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.contradictions import StandingFault
from imucald.mount.estimator import JointEstimator
from imucald.mount.mount_changes import MountChanges
from imucald.mount.signal_checks import WHY_GRAVITY_MOVED, Acceptance
from imucald.simulation import random_model, simulate
from mount_settings import joint_settings

EDITS = {
    "gain 10 %": (1.1, 0.0),
    "gain -5 %": (0.95, 0.0),
    "zero of the most upright axis by 1 m/s^2": (1.0, 1.0),
    "... by -0.5 m/s^2": (1.0, -0.5),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", list(EDITS))
def test_a_step_in_mid_drive_is_never_good_after_a_minute_and_says_why(name):
    at, samples = 480.0, dict(drive(minutes=15.0).samples)
    upright = drive().truth.R_vehicle_from_sensor()[2]
    axis = np.zeros(3)
    axis[np.argmax(np.abs(upright))] = 1.0
    series = samples["accel"]
    late = (series.t >= at)[:, None]
    gain, zero = EDITS[name]
    values = np.where(late, gain * series.values + zero * axis, series.values)
    samples["accel"] = Series(series.t, values)
    was_good, since, estimate = good_around(samples, at, 9000)
    assert was_good
    assert not any(since)
    assert StandingFault.ACCEL_LEVEL.value in estimate.faults
    assert "zero or gain has changed" in estimate.waiting_for["roll"]
    assert f"{estimate.details['gravity_change']['after']:.2f} m/s^2" in estimate.waiting_for["yaw"]


@pytest.mark.slow
@pytest.mark.parametrize("at", [200.0, 480.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_step_across_the_vertical_is_never_good_after_a_minute_and_says_why(at, sign):
    samples = dict(drive(minutes=20.0).samples)
    upright = drive().truth.R_vehicle_from_sensor()[2]
    axis = np.zeros(3)
    axis[np.argmin(np.abs(upright))] = sign
    series = samples["accel"]
    samples["accel"] = Series(series.t, series.values + (series.t >= at)[:, None] * axis)
    was_good, since, estimate = good_around(samples, at, 12000)
    assert was_good
    assert not any(since)
    assert StandingFault.ACCEL_ZERO.value in estimate.faults
    assert "zero has changed" in estimate.waiting_for["roll"]


@pytest.mark.slow
def test_a_zero_that_steps_back_is_a_fault_no_more():
    samples = dict(drive(minutes=20.0).samples)
    upright = drive().truth.R_vehicle_from_sensor()[2]
    series = samples["accel"]
    during = ((series.t >= 400.0) & (series.t < 700.0))[:, None]
    samples["accel"] = Series(series.t, series.values + during * upright)
    estimator, faults = JointEstimator(joint_settings()), []
    for row in ticks_from_samples(samples, 0, 12000, {}).tolist():
        estimator.step(row)
        faults.append(StandingFault.ACCEL_LEVEL.value in estimator.faults)
    assert all(faults[4600:7000])
    assert not faults[-1]


def test_nothing_is_good_while_it_is_not_known_what_moved_gravity():
    agreed: Any = SimpleNamespace(alternatives=SimpleNamespace(missing=lambda _: None))
    changes = MountChanges()
    flags = {"is_delay_beyond": False, "has_speed": True, "has_speed_now": True}
    for is_open in (True, False):
        question = Acceptance(agreed, changes, is_open, are_signs_known=False, **flags)
        assert question.missing_to_be_good() == (WHY_GRAVITY_MOVED if is_open else None)


@pytest.mark.slow
def test_a_vertical_that_a_gyroscope_alone_carries_accuses_no_accelerometer():
    """No speed for two minutes, and a gyroscope of steps so coarse that it is off by 0.4 deg/s."""
    lost, samples = (480.0, 600.0), dict(drive(minutes=15.0).samples)
    samples.pop("wheel_speeds", None)
    samples.pop("yaw_rate", None)
    speed, gyro = samples["speed"], samples["gyro"]
    has = (speed.t < lost[0]) | (speed.t > lost[1])
    samples["speed"] = Series(speed.t[has], speed.values[has])
    wrong = ((gyro.t >= lost[0]) & (gyro.t <= lost[1]))[:, None]
    samples["gyro"] = Series(gyro.t, gyro.values + np.radians(0.4) * wrong)
    estimator, accused = JointEstimator(joint_settings()), []
    for row in ticks_from_samples(samples, 0, 9000, {}).tolist():
        estimator.step(row)
        accused += [fault for fault in estimator.faults if fault.startswith("accelerometer")]
    assert not accused


@pytest.mark.slow
@pytest.mark.parametrize("zero", [(0.3, 0.0), (0.0, -0.3)], ids=["along", "across"])
def test_a_zero_is_taken_off_as_well_as_stated(zero):
    made = drive()
    R = made.truth.R_vehicle_from_sensor()
    put_on = R.T @ np.array([*zero, 0.0])
    accel = made.samples["accel"]
    samples = {**made.samples, "accel": Series(accel.t, accel.values + put_on)}
    estimator = JointEstimator(joint_settings())
    for row in ticks_from_samples(samples, 0, 6000).tolist():
        estimator.step(row)
    estimate = estimator.estimate()
    applied, sent = estimate.correction, estimate.sent
    assert applied is not None
    assert sent is not None
    # on level ground, the mean lean of the roads set aside
    expected = joint_settings().vehicle.crown_mean
    on_roads = rotation_from_vector([made.truth.mean_crown() - expected, 0.0, 0.0]) @ R
    felt = on_roads.T[:, 2] * GRAVITY + made.model.accel.bias + put_on
    left = np.array(applied.applied("accel", felt))
    stated = np.array([sent.zero_x, sent.zero_y])
    assert (np.abs(left[:2]) < 2.0 * stated).all()
    assert (stated < 0.45).all()


@pytest.mark.slow
def test_a_step_of_the_zero_is_not_named_a_wrong_unit_while_its_cause_is_open():
    """1 m/s^2 across the vehicle are as much as the force of a bend."""
    made = simulate(random_model(1880001), 1880001, 4.5)
    accel = made.samples["accel"]
    values = accel.values.copy()
    values[accel.t >= 187.0, 1] += 1.0
    samples = {**made.samples, "accel": Series(accel.t, values)}
    estimator, faults = JointEstimator(joint_settings()), set()
    for row in ticks_from_samples(samples, 0, 2700).tolist():
        estimator.step(row)
        faults.update(estimator.faults)
    assert "accelerometer_zero" in faults
    assert not {fault for fault in faults if fault.endswith("_unit")}
