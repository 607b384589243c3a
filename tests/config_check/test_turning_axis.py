"""Axes exchanged so that gravity lies on another one, where only the gyroscope shows turns."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from imucald.config.calibration import OrientationSettings, SensorAxis
from imucald.config.vehicle import VehicleSettings
from imucald.config_check.finding import Finding
from imucald.config_check.judgement import judge
from imucald.config_check.motion import Motion, TickMeans
from imucald.core.rotations import rotation_from_angles
from imucald.core.samples import Samples, Series
from imucald.simulation import random_model, simulate

SEED = 43


@functools.cache
def alone() -> Samples:
    """Accelerometer, gyroscope and speed of a drive, in axes that are nearly the vehicle's."""
    model = random_model(SEED, standing_first=True)
    drive = simulate(model, SEED, 8.0)
    R = drive.truth.R_vehicle_from_sensor()
    out = {"speed": drive.samples["speed"]}
    for channel in ("accel", "gyro"):
        series = drive.samples[channel]
        out[channel] = Series(series.t, series.values @ R.T)
    return out


def motion(**changes: np.ndarray) -> Motion:
    samples = dict(alone())
    for channel, matrix in changes.items():
        series = samples[channel]
        samples[channel] = Series(series.t, series.values @ matrix.T)
    means = TickMeans()
    means.add_samples(samples)
    return Motion(means.grid(), planar=False)


def findings(up: SensorAxis | None = None, **changes: np.ndarray) -> list[Finding]:
    vehicle = VehicleSettings(track=1.5, wheelbase=2.7, steering_ratio=16.0)
    return list(judge(motion(**changes), vehicle, OrientationSettings(up=up)))


def accused(of: Motion) -> bool:
    """Whether an axis of a sensor is called wrong."""
    vehicle = VehicleSettings(track=1.5, wheelbase=2.7, steering_ratio=16.0)
    return any(f.level == "error" for f in judge(of, vehicle))


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2.237, 1 / 2.237, 3.6])
def test_a_wrong_unit_of_the_speed_is_no_gyroscopes(factor):
    samples = dict(alone())
    samples["speed"] = Series(samples["speed"].t, factor * samples["speed"].values)
    means = TickMeans()
    means.add_samples(samples)
    vehicle = VehicleSettings(track=1.5, wheelbase=2.7, steering_ratio=16.0)
    found = judge(Motion(means.grid(), planar=False), vehicle)
    assert {f.quantity for f in found if f.level in ("error", "warning")} == {"speed"}


@pytest.mark.slow
def test_a_wrong_unit_of_the_gyroscope_is_no_wrong_axis():
    errors = [f.text for f in findings(gyro=np.degrees(1.0) * np.eye(3)) if f.level == "error"]
    assert len(errors) == 1
    assert "deg against rad" in errors[0]


EXCHANGED = {
    "y, z": np.eye(3)[[0, 2, 1]],
    "x, z": np.eye(3)[[2, 1, 0]],
    "x, y, z in turn": np.eye(3)[[1, 2, 0]],
}


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["accel", "gyro"])
@pytest.mark.parametrize("axes", ["y, z", "x, z"])
def test_the_vertical_axis_exchanged_in_one_of_both_is_an_error(channel, axes):
    errors = [f for f in findings(**{channel: EXCHANGED[axes]}) if f.level == "error"]
    assert any(f"exchanged axes {axes.replace(', ', ' and ')}" in f.text for f in errors)


@pytest.mark.slow
def test_sound_axes_and_any_other_mount_are_no_error():
    turned = EXCHANGED["x, y, z in turn"]
    assert "error" not in {f.level for f in findings(accel=turned, gyro=turned)}
    assert "error" not in {f.level for f in findings()}


def test_a_straight_drive_says_nothing_of_the_axis_of_turning():
    rng = np.random.default_rng(1)
    n = 4000
    t = 0.1 * np.arange(n)
    speed = 15.0 + 3.0 * np.sin(0.1 * t)
    accel = np.column_stack([0.3 * np.cos(0.1 * t), np.zeros(n), np.full(n, 9.8)])
    grid = {
        "speed": speed,
        "accel": accel + rng.normal(0.0, 0.1, (n, 3)),
        "gyro": rng.normal(0.0, 0.01, (n, 3)),
    }
    assert not accused(Motion(grid, planar=False))


@pytest.mark.slow
def test_without_left_and_right_signs_are_not_checked_until_the_axis_that_points_up_is_stated():
    asked = "inverted signs of the whole accelerometer"
    assert any(asked in f.text for f in findings() if f.level == "note")
    assert not any(asked in f.text for f in findings("z"))
    assert any("points up, as" in f.text for f in findings("z") if f.level == "ok")


@pytest.mark.slow
def test_an_axis_that_is_stated_to_point_up_and_does_not_is_an_error_or_a_warning():
    down = findings("z", accel=-np.eye(3))
    assert any("points down" in f.text for f in down if f.level == "error")
    level = findings("x")
    assert any("neither up nor down" in f.text for f in level if f.level == "warning")


@pytest.mark.parametrize("zero", [(0.3, 0.3, -3.0), (-4.0, 0.5, 4.0)])
def test_a_zero_error_of_the_gyroscope_in_a_drive_with_stops_accuses_no_axis(zero):
    samples, R = dict(alone()), rotation_from_angles(0.4, 0.41, 1.01)
    for channel, error in (("accel", np.zeros(3)), ("gyro", np.radians(zero))):
        series = samples[channel]
        short = series.t < 200.0
        samples[channel] = Series(series.t[short], (series.values @ R + error)[short])
    means = TickMeans()
    means.add_samples(samples)
    assert not accused(Motion(means.grid(), planar=False))
