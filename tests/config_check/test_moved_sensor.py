"""A sensor that is moved in a recording is named, in place of signals that are right."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.config.vehicle import VehicleSettings
from imucald.config_check.judgement import judge
from imucald.config_check.motion import Motion, TickMeans
from imucald.config_check.moved_sensor import sensor_move
from imucald.core.arrays import Array
from imucald.simulation import random_model, simulate

VEHICLE = VehicleSettings(track=1.53, wheelbase=2.68, steering_ratio=15.5)
TICK_RATE = 10.0


@functools.cache
def drive(seed: int = 9102) -> dict[str, Array]:
    """The signals of six minutes of driving, by channel, at ticks."""
    means = TickMeans()
    means.add_samples(simulate(random_model(seed, standing_first=True), seed, 6.0).samples)
    return means.grid()


def moved(pitch_deg: float, at: float, channels: tuple[str, ...] = ("accel", "gyro")) -> Motion:
    """The motion with sensors that are turned about their y axis from a time on [s]."""
    turn = Rotation.from_euler("y", pitch_deg, degrees=True).as_matrix()
    grid = dict(drive())
    for name in channels:
        values = grid[name].copy()
        values[round(at * TICK_RATE) :] @= turn.T
        grid[name] = values
    return Motion(grid, planar=False)


@pytest.mark.parametrize(("pitch", "at"), [(90.0, 180.0), (-40.0, 240.0), (22.0, 120.0)])
def test_the_move_is_found_with_its_angle_and_its_time(pitch: float, at: float) -> None:
    found = sensor_move(moved(pitch, at))
    assert found is not None
    assert found.deg == pytest.approx(abs(pitch), abs=3.0)
    assert found.before <= at <= found.after
    assert found.after - found.before <= 60.0


def test_without_stops_the_parts_of_the_drive_show_it() -> None:
    motion = moved(30.0, 180.0)
    grid = {**motion.grid, "speed": np.maximum(motion.grid["speed"], 5.0)}
    found = sensor_move(Motion(grid, planar=False))
    assert found is not None
    assert found.before <= 180.0 <= found.after


def test_a_fixed_sensor_and_a_loose_one_are_not_said_to_be_moved_once() -> None:
    assert sensor_move(moved(0.0, 100.0)) is None
    assert sensor_move(moved(8.0, 100.0)) is None, "roads may do this"
    grid = dict(drive())
    swing = np.deg2rad(25.0) * np.sin(np.arange(len(grid["accel"])) * 2.0 * np.pi / 700.0)
    turns = Rotation.from_rotvec(np.outer(swing, [0.0, 1.0, 0.0]))
    grid["accel"] = turns.apply(np.nan_to_num(grid["accel"]))
    assert sensor_move(Motion(grid, planar=False)) is None


def test_check_names_the_move_and_blames_no_signal() -> None:
    """Before, gravity was 'removed', two axes were 'exchanged', or nothing was found."""
    found = list(judge(moved(90.0, 180.0), VEHICLE))
    (warning,) = (f for f in found if f.level in ("error", "warning"))
    assert warning.quantity == "accelerometer"
    assert "the sensor was moved between" in warning.text
