"""The size of gravity against its own past: zeros and gains of the accelerometer that step."""

from __future__ import annotations

import numpy as np
import pytest
from test_estimator import drive, good_around

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY, Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.contradictions import StandingFault
from imucald.mount.estimator import JointEstimator
from imucald.mount.force_level import ForceLevel
from imucald.mount.signal_blocks import BLOCK_TICKS
from mount_settings import joint_settings
from signal_block import block

UP = np.array([0.0, 0.0, 1.0])


def watched(
    forces: list[np.ndarray], seed: int = 0, gap: int = -1, hole: tuple[int, float] = (0, 0.0)
) -> list[bool]:
    """Whether a change stands after each block; forces: mean force of each [m/s^2].

    gap: the block before which time jumps. hole: a block, and the seconds without samples before.
    """
    rng = np.random.default_rng(seed)
    level, found = ForceLevel(), []
    for k, mean in enumerate(forces):
        block_mean = np.asarray(mean) + 0.05 * rng.standard_normal(3)
        force = block_mean + 0.5 * rng.standard_normal((BLOCK_TICKS, 3))
        if k == gap:
            level.gap()
        t = 6.4 * k + (hole[1] if k >= hole[0] else 0.0)
        level.add(block(t, force=force), np.asarray(mean) / GRAVITY)
        found.append(level.change is not None)
    return found


@pytest.mark.parametrize("step", [0.5, -0.5, 1.0])
def test_a_zero_that_steps_along_the_vertical_is_found_within_half_a_minute(step):
    found = watched([GRAVITY * UP] * 30 + [(GRAVITY + step) * UP] * 6)
    assert not any(found[:30])
    assert any(found[30:35])


def test_the_sizes_before_and_after_are_given():
    level = ForceLevel()
    for k in range(30):
        size = GRAVITY * (1.1 if k >= 20 else 1.0)
        level.add(block(6.4 * k, force=np.tile(size * UP, (BLOCK_TICKS, 1))), UP)
    assert level.change is not None
    assert level.change.before == pytest.approx(GRAVITY)
    assert level.change.after == pytest.approx(1.1 * GRAVITY)


def test_a_drift_by_temperature_is_no_step():
    """1 mg/K and 20 K within ten minutes, twice what a cabin warms by."""
    drift = np.linspace(0.0, 0.02 * GRAVITY, 94)
    assert not any(watched([(GRAVITY + more) * UP for more in drift]))


def test_the_fault_ends_when_the_level_is_back():
    found = watched([GRAVITY * UP] * 30 + [1.1 * GRAVITY * UP] * 20 + [GRAVITY * UP] * 10)
    assert all(found[35:50])
    assert not found[-1]


def test_what_was_before_the_level_came_back_is_no_past_of_it():
    found = watched([GRAVITY * UP] * 30 + [1.1 * GRAVITY * UP] * 70 + [GRAVITY * UP] * 30)
    assert all(found[35:100])
    assert not any(found[105:])


def test_a_gap_of_unknown_length_has_no_step_across_it_and_mends_none():
    stepped = [GRAVITY * UP] * 30 + [(GRAVITY + 0.5) * UP] * 20
    assert any(watched(stepped))
    assert not any(watched(stepped, gap=30))
    assert all(watched(stepped, gap=40)[36:])


def test_what_is_older_than_its_window_is_not_held_against_the_present():
    """Half an hour without samples, in which the sensor cools."""
    stepped = [GRAVITY * UP] * 30 + [(GRAVITY + 0.5) * UP] * 20
    assert any(watched(stepped, hole=(30, 60.0)))
    assert not any(watched(stepped, hole=(30, 1800.0)))


def test_a_step_has_to_stand_out_from_what_the_blocks_before_it_varied_by():
    step = [(GRAVITY + 0.4) * UP] * 6
    wide = [(GRAVITY + 0.3 * (-1.0) ** k) * UP for k in range(30)]
    assert not any(watched(wide + step))
    assert any(watched([GRAVITY * UP] * 30 + step))


def test_a_sensor_that_is_turned_shows_the_zero_of_another_axis_and_is_not_accused():
    zeros = np.array([0.3, 0.0, -0.1])
    before, after = GRAVITY * UP + zeros, GRAVITY * np.array([1.0, 0.0, 0.0]) + zeros
    assert not any(watched([before] * 30 + [after] * 20))


def test_the_largest_wave_of_a_hilly_road_is_none():
    """Every minute over a crest: 1 m/s^2 up or down for a second, as large a sum as comes back."""
    waves = [0.15 * np.sin(2.0 * np.pi * k / 9.0) for k in range(200)]
    assert not any(watched([(GRAVITY + wave) * UP for wave in waves]))


EDITS = {
    "gain 10 %": (1.1, 0.0),
    "gain -5 %": (0.95, 0.0),
    "zero of the most upright axis by 1 m/s^2": (1.0, 1.0),
    "... by -0.5 m/s^2": (1.0, -0.5),
}


def test_the_estimator_tells_of_a_gap():
    estimator, calls = JointEstimator(joint_settings()), []
    estimator._level.gap = lambda: calls.append(True)  # type: ignore[method-assign]
    estimator.gap()
    assert calls


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
        accused += [StandingFault.ACCEL_LEVEL] if estimator._level.change is not None else []
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
