"""A yaw rate of the vehicle bus that is stuck, against sound ones of every resolution."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.core.samples import GRAVITY
from imucald.motion import ticks as tk
from imucald.motion.ticks import empty_rows
from imucald.mount.signal_blocks import LAG, SignalBlockMaker
from mount_settings import joint_settings

TICKS, DEG = 4800, math.pi / 180.0
SPEED, BEND_EVERY, BEND = 12.0, 300, 60
"""A bend of 6 s in every 30 s, left and right in turn, of 17 deg/s; straight between."""


def true_yaw_rate(straight: slice = slice(0, 0)) -> np.ndarray:
    k = np.arange(TICKS)
    bend = np.sin(np.pi * np.minimum(k % BEND_EVERY, BEND) / BEND)
    rate = 0.3 * bend * np.where(k // BEND_EVERY % 2, 1.0, -1.0)
    rate[straight] = 0.0
    return rate + 0.15 * DEG * np.sin(2 * np.pi * 0.013 * k)  # a lane is kept, not a line


def known(
    sent: np.ndarray, turning: np.ndarray, steering: bool = True, alone: np.ndarray | float = 0.0
) -> np.ndarray:
    """At which ticks the yaw rate is used.

    sent: what the bus says. turning: what the vehicle does. alone: what the sensor turns besides.
    """
    rng = np.random.default_rng(1)
    rows = empty_rows(TICKS)
    rows[:, tk.T] = 0.1 * (np.arange(TICKS) + 1)
    rows[:, tk.ACCEL.n] = rows[:, tk.GYRO.n] = rows[:, tk.SPEED.n] = rows[:, tk.YAW_RATE.n] = 5
    rows[:, tk.ACCEL.age] = rows[:, tk.GYRO.age] = rows[:, tk.SPEED.age] = 0.05
    rows[:, tk.ACCEL.x : tk.ACCEL.max_z + 1] = 0.05 * rng.standard_normal((TICKS, 12))
    rows[:, tk.ACCEL.z] += GRAVITY
    rows[:, tk.GYRO.x : tk.GYRO.z + 1] = 0.005 * rng.standard_normal((TICKS, 3))
    rows[:, tk.GYRO.z] += turning + alone
    rows[:, tk.SPEED.mean] = SPEED + 0.3 * rng.standard_normal(TICKS)
    rows[:, tk.YAW_RATE.mean] = sent
    settings = joint_settings()
    if steering:
        car = settings.vehicle
        rows[:, tk.STEERING.n] = 10
        rows[:, tk.STEERING.mean] = turning * car.steering_ratio * car.wheelbase / SPEED
    maker, found = SignalBlockMaker(settings), []
    for row in rows.tolist():
        if maker.push(row):
            found.append(maker.block().ok_yaw)
    return np.concatenate(found)[LAG:]


def rounded(rate: np.ndarray, step: float, noise: float = 0.0) -> np.ndarray:
    """As means over the five samples of a tick."""
    rng = np.random.default_rng(2)
    samples = rate[:, None] + noise * rng.standard_normal((len(rate), 5))
    return np.asarray((np.round(samples / step) * step).mean(axis=1))


@pytest.mark.parametrize("steering", [True, False])
@pytest.mark.parametrize("step", [0.01, 0.1, 0.5])
def test_a_yaw_rate_that_stays_while_the_vehicle_turns_is_not_used(
    step: float, steering: bool
) -> None:
    true = true_yaw_rate()
    sent = rounded(true, step * DEG, 0.1 * DEG)
    stuck = slice(2520, 3720)
    sent[stuck] = sent[2520]
    found = known(sent, true, steering)
    assert found[:2500].all(), "before, it is sound"
    bends = np.abs(true) > 0.1
    assert (found[stuck] & bends[stuck]).sum() <= 10, "a bend's first second may be believed"
    assert found[3800:].all(), "after, it is sound again"


def test_a_fine_yaw_rate_that_stays_in_a_gentle_bend_is_not_used() -> None:
    """Two degrees a second for eight seconds, which would pass for a sensor turned by 16 deg."""
    true = true_yaw_rate(straight=slice(2400, 3600))
    true[3000:3080] += 2.0 * DEG
    sent = rounded(true, 0.01 * DEG, 0.1 * DEG)
    sent[2990:3090] = sent[2990]
    found = known(sent, true)
    assert found[:2980].all()
    assert not found[3005:3075].any()


@pytest.mark.parametrize("steering", [True, False])
@pytest.mark.parametrize("step", [0.01, 0.1, 0.5, 1.0, 2.0])
def test_a_sound_yaw_rate_is_used_however_coarse(step: float, steering: bool) -> None:
    true = true_yaw_rate(straight=slice(2400, 3600))
    assert known(rounded(true, step * DEG), true, steering).all()


@pytest.mark.parametrize("cycle", [2, 5, 10])
def test_a_sender_that_repeats_its_values_is_used(cycle: int) -> None:
    true = true_yaw_rate()
    assert known(np.repeat(true[::cycle], cycle)[:TICKS], true).all()


def test_a_sensor_turned_by_hand_on_a_straight_road_accuses_no_coarse_yaw_rate() -> None:
    true = true_yaw_rate(straight=slice(2400, 3600))
    alone = np.zeros(TICKS)
    alone[3000:3020] = 0.5
    assert known(rounded(true, 1.0 * DEG), true, alone=alone).all()
