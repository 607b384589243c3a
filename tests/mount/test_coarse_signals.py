"""A coarse or constant speed moves no sensor, and one that was turned is found once."""

from __future__ import annotations

import numpy as np
import pytest
from test_estimator import drive

import imucald
from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY, Samples, Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimator import JointEstimator
from imucald.mount.hysteresis import GOOD
from imucald.mount.mount_words import left_out_words
from imucald.mount.offsets import GUESS_TICKS, Offsets
from imucald.simulation import random_model, simulate
from mount_settings import joint_settings
from paths import SHARED_DATA

REMOUNTED = SHARED_DATA / "inputs" / "remounted"


def run(samples: Samples, minutes: float) -> tuple[JointEstimator, list[float]]:
    """The estimator at the end, and at which times it was good [s]."""
    estimator, good = JointEstimator(joint_settings()), []
    ticks = ticks_from_samples(samples, 0, int(600 * minutes), {}).tolist()
    for k, row in enumerate(ticks):
        estimator.step(row)
        if estimator.state in GOOD:
            good.append(0.1 * k)
    return estimator, good


def in_steps(samples: Samples, step: float) -> Samples:
    """Its speed in such steps [km/h], and no wheels."""
    speed = samples["speed"]
    whole = np.round(speed.values * 3.6 / step) * step / 3.6
    others = {c: s for c, s in samples.items() if c != "wheel_speeds"}
    return {**others, "speed": Series(speed.t, whole)}


@pytest.mark.slow
@pytest.mark.parametrize(
    "seed",
    [
        9002,
        9004,
    ],
)
def test_a_speed_in_whole_kilometres_an_hour_costs_no_time_and_moves_no_sensor(seed: int) -> None:
    samples = simulate(random_model(seed), seed, 5.0).samples
    fine, coarse = (run(one, 5.0) for one in (samples, in_steps(samples, 1.0)))
    assert coarse[1][0] <= 1.5 * fine[1][0]
    assert coarse[0].estimate().details["shifts"] == []
    assert (
        coarse[0].estimate().details["frozen_ticks"].get("speed", {}).get("stuck", 0) < 0.05 * 3000
    )


@pytest.mark.slow
def test_what_is_not_learnt_from_is_named_with_signal_cause_and_time() -> None:
    made = drive()
    speed = made.samples["speed"]
    silent = (speed.t < 200.0) | (speed.t > 230.0)
    first = int(np.argmax((speed.t > 260.0) & (speed.values > 8.0)))
    held = (speed.t > speed.t[first]) & (speed.t < speed.t[first] + 60.0)
    values = np.where(held, speed.values[first], speed.values)
    others = {c: s for c, s in made.samples.items() if c != "wheel_speeds"}
    samples = {**others, "speed": Series(speed.t[silent], values[silent])}
    details = run(samples, 6.0)[0].estimate().details
    named = {(x["signal"], x["cause"]): x["seconds"] for x in details["not_learnt_from"]}
    assert 25.0 < named["speed", "no valid samples"] < 35.0
    assert named["speed", "stuck"] > 10.0
    assert f"{named['speed', 'stuck']:.0f} s (speed stuck)" in left_out_words(details)


@pytest.mark.slow
def test_a_sensor_turned_about_two_axes_with_another_zero_is_found_once() -> None:
    made = drive(9003, 12.0)
    turn = np.asarray(rotation_from_vector([0.0, 0.0, 0.7]))
    samples = dict(made.samples)
    for channel in ("accel", "gyro"):  # the zeros turn along: to the daemon they are other ones
        s = samples[channel]
        late = (s.t >= 300.0)[:, None]
        samples[channel] = Series(s.t, np.where(late, s.values @ turn, s.values))
    estimator, _ = run(samples, 12.0)
    assert len(estimator.estimate().details["shifts"]) == 1
    assert estimator.state in GOOD
    R = estimator.estimate().R_vehicle_from_sensor
    assert R is not None
    left = made.truth.R_vehicle_from_sensor() @ turn @ R.T
    assert np.degrees(np.arccos(0.5 * (np.trace(left) - 1.0))) < 2.0


def test_a_turn_rate_that_lasts_is_a_zero_error_and_a_short_one_is_a_bend() -> None:
    rng, level = np.random.default_rng(2), np.tile([0.0, 0.0, GRAVITY], (64, 1))

    def guessed(rate: float, turn: float, blocks: int) -> Offsets:
        offsets = Offsets()
        for _ in range(blocks):
            rates = np.array([0.0, 0.0, rate]) + 1e-4 * rng.standard_normal((64, 3))
            offsets.guess_gyro(rates, level, np.full(64, turn))
        return offsets

    bend = guessed(0.11, 0.1, 5)
    assert abs(bend.gyro_bias[2] - 0.01) < 0.001
    for blocks in (4, 8, 16, 32, 64):
        straight = guessed(0.01, np.radians(2.0), blocks)
        off = abs(straight.gyro_bias[2] - 0.01)
        assert off < max(0.002, 2.0 * straight.turn_zero_std)
    assert off < 0.002


def test_a_doubted_zero_of_the_gyroscope_serves_until_another_can_be_guessed() -> None:
    offsets, rng = Offsets(), np.random.default_rng(1)
    level = np.tile([0.0, 0.0, 9.8], (50, 1))
    offsets.learn_gyro(np.full((50, 3), 0.01), level)
    offsets.doubt_gyro()
    for k in range(GUESS_TICKS // 50):
        assert np.allclose(offsets.gyro_bias, 0.01), "the old one"
        is_last = k == GUESS_TICKS // 50 - 1
        rates = -0.02 + 1e-4 * rng.standard_normal((50, 3))
        assert offsets.guess_gyro(rates, level, np.zeros(50))
        assert np.allclose(offsets.gyro_bias, -0.02 if is_last else 0.01, atol=1e-3)


@pytest.mark.parametrize("zero_of_yaw_rate", [0.0, 0.008])
def test_a_bend_at_the_beginning_is_no_zero_of_the_gyroscope(zero_of_yaw_rate: float) -> None:
    """The first half minute is a slip road; the vehicle's yaw rate has a zero error itself."""
    offsets, rng = Offsets(), np.random.default_rng(2)
    zero, up = np.array([0.01, -0.005, 0.008]), np.array([0.36, -0.48, 0.8])
    for k in range(10):
        turn = 0.17 * np.linspace(0.8, 1.2, 50) if k < 6 else np.zeros(50)
        lean = np.array([0.8, 0.6, 0.0]) * (1.8 if k < 6 else 0.0)
        rate = zero + turn[:, None] * up + 0.02 * rng.standard_normal((50, 3))
        offsets.guess_gyro(rate, np.tile(9.81 * up + lean, (50, 1)), turn + zero_of_yaw_rate)
        if k >= GUESS_TICKS // 50:
            assert np.abs(offsets.gyro_bias - zero).max() < 0.03
    assert np.abs(offsets.gyro_bias - zero).max() < 0.01 + 0.5 * zero_of_yaw_rate


@pytest.mark.slow
@pytest.mark.skipif(not REMOUNTED.exists(), reason="the small inputs are absent")
def test_a_log_whose_sensor_is_turned_by_40_degrees_shows_one_move_and_is_usable_again() -> None:
    found = imucald.replay(REMOUNTED / "hand.yaml", REMOUNTED / "drive.log.gz", signals=False)
    assert found.state in ("usable", "fine")
    assert found.events["kind"].to_pylist().count("shift") == 1
