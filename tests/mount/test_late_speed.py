"""A speed that comes late, as receivers and phones send it, contradicts nothing."""

from __future__ import annotations

import math

import numpy as np
import pytest
from test_estimator import GOOD, drive

from imucald.config.base import MAX_SPEED_DELAY
from imucald.core.rotations import vector_from_rotation
from imucald.core.samples import Samples, Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.contradictions import Contradictions
from imucald.mount.estimate import MountState
from imucald.mount.estimator import JointEstimator
from mount_settings import joint_settings
from signal_block import block


def late(seconds: float) -> Samples:
    """The usual drive with its speed alone, 1 Hz, and so much later than it is there."""
    alone = {c: s for c, s in drive().samples.items() if c in ("accel", "gyro", "speed")}
    speed = alone["speed"]
    seldom = np.searchsorted(speed.t, np.arange(speed.t[0], speed.t[-1], 1.0))
    return {**alone, "speed": Series(speed.t[seldom] + seconds, speed.values[seldom])}


def run(samples: Samples, minutes: float) -> tuple[JointEstimator, set[MountState], set[str]]:
    estimator, states, faults = JointEstimator(joint_settings()), set(), set()
    for row in ticks_from_samples(samples, 0, int(600 * minutes), {}).tolist():
        estimator.step(row)
        states.add(estimator.state)
        faults.update(estimator.faults)
    return estimator, states, faults


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.8, 1.3])
def test_a_late_speed_is_no_contradiction_and_the_mount_is_found(seconds):
    estimator, states, faults = run(late(seconds), 8.0)
    own = drive().model.speed.delay_s - drive().model.accel.delay_s
    estimate = estimator.estimate()
    assert faults == set()
    assert states & set(GOOD)
    assert estimate.details["speed_delay"] == pytest.approx(seconds + own, abs=0.05)
    assert estimate.R_vehicle_from_sensor is not None
    error = vector_from_rotation(
        drive().truth.R_vehicle_from_sensor() @ estimate.R_vehicle_from_sensor.T
    )
    assert np.abs(error).max() < math.radians(1.5)


@pytest.mark.slow
def test_a_speed_later_than_what_is_sought_is_reported_and_is_no_contradiction():
    estimator, states, faults = run(late(2.0), 6.0)
    assert faults == set()
    assert not states & set(GOOD)
    words = " ".join(estimator.estimate().waiting_for.values())
    assert f"more than {MAX_SPEED_DELAY:g} s behind the accelerometer" in words


def swinging(late_ticks: int):
    """A block of a vehicle that brakes and bends, its speed late by so many ticks."""
    t = 0.1 * np.arange(64)
    accel, yaw_rate = 2.0 * np.sin(1.5 * t), 0.3 * np.sin(1.1 * t)
    force = np.column_stack([accel, 10.0 * yaw_rate, np.full(64, 9.8)])
    seen = 2.0 * np.sin(1.5 * (t - 0.1 * late_ticks))
    return block(force=force, accel=seen, speed=np.full(64, 10.0)), yaw_rate


@pytest.mark.parametrize("ticks", [0, 11, -4])
def test_force_and_speed_are_held_against_one_another_at_the_delay(ticks):
    watch = Contradictions(joint_settings())
    for _ in range(4):
        p, yaw_rate = swinging(ticks)
        watch.take_block(p, yaw_rate, True, np.eye(3), 0.0, False, 0.1 * ticks)
    assert watch.faults == ()
    assert watch.speed.pieces
    assert watch.turns.pieces


def test_a_late_speed_that_is_taken_as_it_comes_would_be_accused():
    watch = Contradictions(joint_settings())
    for _ in range(4):
        p, yaw_rate = swinging(20)
        watch.take_block(p, yaw_rate, True, np.eye(3), 0.0, False, 0.0)
    assert watch.speed.accused


def test_while_the_delay_is_not_known_the_force_is_not_asked():
    watch = Contradictions(joint_settings())
    for _ in range(4):
        p, yaw_rate = swinging(20)
        watch.take_block(p, yaw_rate, True, np.eye(3), 0.0, False, None)
    assert watch.speed.pieces == watch.turns.pieces == 0
