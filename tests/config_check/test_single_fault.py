"""One wrong sign or exchange of axes is named, in place of the contradictions that it causes."""

from __future__ import annotations

import functools

import numpy as np
import pytest

from imucald.config.vehicle import VehicleSettings
from imucald.config_check.finding import Finding
from imucald.config_check.judgement import judge
from imucald.config_check.motion import Motion, TickMeans
from imucald.core.arrays import Array
from imucald.simulation import random_model, simulate

VEHICLE = VehicleSettings(track=1.53, wheelbase=2.68, steering_ratio=15.5)
ALL = ("accel", "gyro", "speed", "yaw_rate", "steering", "wheel_speeds")
SEED = 4711


@functools.cache
def drive(seed: int) -> dict[str, Array]:
    """The signals of six minutes of driving, by channel, at ticks."""
    means = TickMeans()
    means.add_samples(simulate(random_model(seed, standing_first=True), seed, 6.0).samples)
    return means.grid()


def errors(channels: tuple[str, ...], **wrong: Array) -> list[Finding]:
    """Errors about some channels; wrong: matrices by channel."""
    motion = Motion({name: drive(SEED)[name] for name in channels}, planar=False)
    for channel, matrix in wrong.items():
        motion = motion.turned(channel, matrix)
    return [f for f in judge(motion, VEHICLE) if f.level == "error"]


EYE = np.eye(3)
FAULTS = {
    "x": (np.diag([-1, 1, 1]), "wrong sign of its x axis"),
    "y": (np.diag([1, -1, 1]), "wrong sign of its y axis"),
    "z": (np.diag([1, 1, -1]), "wrong sign of its z axis"),
    "x and y": (EYE[[1, 0, 2]], "exchanged axes x and y"),
    "x and z": (EYE[[2, 1, 0]], "exchanged axes x and z"),
    "y and z": (EYE[[0, 2, 1]], "exchanged axes y and z"),
    "all": (-EYE, "wrong sign of all its axes"),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize(
    ("channel", "quantity"), [("accel", "accelerometer"), ("gyro", "gyroscope")]
)
def test_the_wrong_axis_of_a_sensor_is_the_only_error(
    channel: str, quantity: str, fault: str
) -> None:
    matrix, text = FAULTS[fault]
    (found,) = errors(ALL, **{channel: matrix})
    assert found.quantity == quantity
    assert found.text.startswith(text)


@pytest.mark.slow
@pytest.mark.parametrize("fault", ["x", "z", "x and y"])
@pytest.mark.parametrize("channel", ["accel", "gyro"])
def test_the_sensor_alone_shows_its_wrong_axis(channel: str, fault: str) -> None:
    matrix, text = FAULTS[fault]
    (found,) = errors(("accel", "gyro", "speed"), **{channel: matrix})
    assert found.text.startswith(text)


def test_a_signal_that_contradicts_three_others_is_the_only_error() -> None:
    (found,) = errors(ALL, yaw_rate=-np.eye(1))
    assert (found.quantity, found.text.partition(":")[0]) == ("yaw_rate", "wrong sign")
    (found,) = errors(ALL, wheel_speeds=np.eye(4)[[1, 0, 3, 2]])
    assert (found.quantity, found.text.partition(":")[0]) == (
        "wheel_speeds",
        "left and right exchanged",
    )


@pytest.mark.slow
def test_where_two_faults_explain_the_same_both_are_named() -> None:
    """An inverted accelerometer turns the sign of the gyroscope's turns."""
    channels = ("accel", "gyro", "speed", "yaw_rate")
    for wrong in ({"yaw_rate": -np.eye(1)}, {"accel": -EYE}):
        (found,) = errors(channels, **wrong)
        assert "yaw_rate: wrong sign (" in found.text
        assert "accelerometer: wrong sign of all its axes (" in found.text


@pytest.mark.slow
def test_two_faults_at_once_are_no_single_fault() -> None:
    found = errors(ALL, gyro=FAULTS["x"][0], yaw_rate=-np.eye(1))
    assert len(found) > 1
    assert not [f for f in found if "all signals agree" in f.text]


def test_signals_that_agree_are_not_accused() -> None:
    assert errors(ALL) == []
