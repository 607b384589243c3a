"""Motorways: lane changes at 30 m/s, wide banked bends, and hardly a stop."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from imucald.core.rotations import vector_from_rotation
from imucald.motion import ticks
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.contradictions import Piece
from imucald.mount.estimator import JointEstimator
from imucald.mount.hysteresis import GOOD
from imucald.mount.log_ratios import pair_sums
from imucald.simulation import Drive, random_model, simulate
from imucald.simulation.imu import gain_matrix
from mount_settings import joint_settings


@cache
def motorway(seed: int) -> Drive:
    """12 min of a motorway."""
    return simulate(random_model(seed).with_changes({"route.kind": "motorway"}), seed, 12.0)


def estimated(seed: int, minutes: float) -> JointEstimator:
    estimator = JointEstimator(joint_settings())
    for row in ticks_from_samples(motorway(seed).samples, 0, int(600 * minutes)).tolist():
        estimator.step(row)
    return estimator


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1560017, 1560023, 1560037])
def test_a_body_that_rolls_late_in_lane_changes_turns_no_gyroscope(seed: int) -> None:
    """The lag of the roll looked like a gyroscope that is 2 to 4 deg off, with 0.6 deg stated."""
    estimator, made = estimated(seed, 6.0), motorway(seed)
    correction, sent = estimator.correction, estimator.estimate().sent
    assert correction is not None
    assert sent is not None
    R = made.truth.R_vehicle_from_sensor()
    left = np.reshape(correction.rate, (3, 3)) @ gain_matrix(made.model.gyro) @ R.T - np.eye(3)
    assert abs(left[0, 2]) < min(np.radians(1.0), 3.0 * sent.rate_xz)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [970001, 970005])
def test_sound_sensors_on_a_motorway_have_no_fault(seed: int) -> None:
    """A yaw rate with a zero error and little to turn for; tyres that slip before they turn."""
    estimator = estimated(seed, 12.0)
    assert estimator.faults == ()
    assert estimator.state in GOOD


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1740060, 1740061, 1740064, 1740069])
def test_a_zero_of_the_vehicles_turn_rate_is_no_zero_of_the_gyroscope(seed: int) -> None:
    """Before the first rest, a yaw rate 2 deg/s off was taken for a bend, and 1.2 deg/s of it for
    the gyroscope: a lateral force of 0.6 m/s^2 at 30 m/s.
    """
    estimator, made = JointEstimator(joint_settings()), motorway(seed)
    rows = ticks_from_samples(made.samples, 0, 6000)
    rows[:, ticks.YAW_RATE.mean] += np.radians(2.0)
    began = int(np.argmax(rows[:, ticks.SPEED.mean] > 15.0))
    judged = 0
    for row in rows[began:].tolist():
        estimator.step(row)
        if estimator.state in GOOD and row[ticks.SPEED.mean] > 2.0:
            estimate = estimator.estimate()
            assert estimate.R_vehicle_from_sensor is not None
            assert estimate.std is not None
            R = made.truth.R_vehicle_from_sensor() @ estimate.R_vehicle_from_sensor.T
            crown = made.truth.mean_crown() - joint_settings().crown
            roll = vector_from_rotation(R)[0] + crown
            assert abs(roll) < max(0.02, 3.0 * estimate.std[0])
            judged += 1
    assert judged > 600


@pytest.mark.parametrize("gain", [1.0, 3.6, 1.0 / 3.6])
@pytest.mark.parametrize("noise", [0.0, 0.8])
def test_noise_of_either_signal_is_no_wrong_unit_and_a_wrong_unit_is_one(
    gain: float, noise: float
) -> None:
    rng = np.random.default_rng(1)
    x, added = rng.standard_normal(400), noise * rng.standard_normal((2, 400))
    piece = Piece.of(pair_sums(x + added[0], gain * (x + added[1]), np.ones(400, dtype=bool)))
    assert piece.slope <= 1.02 * gain
    assert piece.other_slope >= 0.98 * gain
    if noise == 0.0 or gain == 1.0:
        assert piece.has_odd_gain == (gain != 1.0)
