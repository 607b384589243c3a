"""Faults of samples and stamps are told with channel, size and place; sound signals have none."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hidden import Effect, HiddenDrive, hidden_drive
from imucald.core.samples import Samples, Series
from imucald.diagnosis.faults import Fault, corrected, extend, find_faults, spoilt
from imucald.diagnosis.recording import read_samples
from imucald.model.model import VehicleModel, model_from_mapping
from imucald.runtime.session import open_config

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent.parent
DATA = ROOT.parent / "shared" / "data"
SEED, MINUTES = 21, 10.0
REAL = ("css_canmod_164", "kingston_2008", "quat_orient_21", "vehsense_2017_10_23_2245",
        "vehsense_2017_10_25_1829", "wrx_sti", "neu_circles", "ped_ethz")  # fmt: skip


@cache
def drive(*effects: Effect) -> HiddenDrive:
    return hidden_drive(SEED, effects, MINUTES)


def model() -> VehicleModel:
    return model_from_mapping(dict(drive().model), "model")


def faults_with(**changed: Series) -> list[Fault]:
    """Faults of the sound drive in which some channels are changed."""
    return find_faults({**drive().samples, **changed}, model())


def held(series: Series, first: int, seconds: float) -> Series:
    """The signal stands still from a row on."""
    values = series.values.copy()
    values[first : np.searchsorted(series.t, series.t[first] + seconds)] = values[first]
    return Series(series.t, values)


def without(series: Series, lost: NDArray[np.bool_]) -> Series:
    return Series(series.t[~lost], series.values[~lost])


# what is hidden is found --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("cause", "form", "size", "key"),
    [
        ("saturation", "accel", "medium", "accel.full_scale"),
        ("saturation", "gyro", "large", "gyro.full_scale"),
        ("saturation", "yaw_rate", "medium", "yaw_rate.full_scale"),
        ("dropouts", "speed", "medium", "speed.loss"),
        ("dropouts", "accel", "large", "accel.loss"),
        ("stuck_signal", "gyro", "medium", "gyro.stuck_share"),
        ("stuck_signal", "steering", "medium", "steering.stuck_share"),
        ("stuck_signal", "speed", "large", "speed.stuck_share"),
        ("stuck_signal", "lateral_accel", "large", "lateral_accel.stuck_share"),
        ("clock_drift", "cycle", "medium", "gyro.clock_drift_ppm"),
        ("clock_drift", "stamps", "medium", "accel.stamps_ppm"),
        ("clock_drift", "stamps", "large", "accel.stamps_ppm"),
    ],
)
def test_a_hidden_fault_is_told_alone_and_with_its_size(cause, form, size, key):
    hidden = drive(Effect(cause, size, form))
    (found,) = find_faults(hidden.samples, model())
    assert found.cause == cause
    assert found.signal == ("accel" if cause == "clock_drift" else form)
    estimate, true = found.parameters[key], hidden.parameters[key]
    assert abs(estimate.value - true) < 3.0 * estimate.std
    assert abs(estimate.value / true - 1.0) < 0.15
    assert found.score > 5.0


@pytest.mark.parametrize("seed", [31, 32])
def test_a_sound_drive_has_no_fault(seed):
    sound = hidden_drive(seed, (), 20.0)
    assert find_faults(sound.samples, model_from_mapping(dict(sound.model), "model")) == []


@pytest.mark.parametrize(
    "effect",
    [
        Effect("signal_delay", "large", "gyro"),
        Effect("signal_delay", "large", "yaw_rate"),
        Effect("sensor_lowpass", "large", "accel"),
        Effect("sensor_lowpass", "large", "yaw_rate"),
        Effect("mount_shift", "large"),
        Effect("wheel_speed_scale", "large"),
        Effect("gyro_bias_temperature", "large"),
    ],
)
def test_what_is_physics_is_no_fault(effect):
    assert find_faults(drive(effect).samples, model()) == []


def test_two_faults_of_one_drive_are_both_told():
    both = drive(Effect("dropouts", "medium", "steering"), Effect("stuck_signal", "large", "gyro"))
    found = {(f.cause, f.signal) for f in find_faults(both.samples, model())}
    assert found == {("dropouts", "steering"), ("stuck_signal", "gyro")}


# drop-outs ----------------------------------------------------------------------------------------


def test_single_lost_frames_within_the_model_files_loss_are_no_dropout():
    series = drive().samples["accel"]
    lost = np.random.default_rng(1).random(len(series.t)) < 0.002
    lossy = model().with_changes({"accel.loss": 0.002})
    changed = {**drive().samples, "accel": without(series, lost)}
    assert find_faults(changed, lossy) == []


def test_single_lost_frames_far_beyond_it_are():
    series = drive().samples["accel"]
    lost = np.random.default_rng(1).random(len(series.t)) < 0.02
    (found,) = faults_with(accel=without(series, lost))
    assert found.cause == "dropouts"
    assert found.parameters["accel.loss"].value == pytest.approx(lost.mean(), rel=0.03)


def test_frames_that_are_late_are_not_lost():
    """A busy bus holds frames back, up to three periods; all of them come."""
    series = drive().samples["gyro"]
    rng = np.random.default_rng(2)
    late = np.where(rng.random(len(series.t)) < 0.02, rng.uniform(0.0, 0.03, len(series.t)), 0.0)
    delayed = Series(np.maximum.accumulate(series.t + late), series.values)
    assert faults_with(gyro=delayed) == []


def test_a_hole_in_all_signals_is_the_logs():
    holed = {}
    for name, series in drive().samples.items():
        lost = np.zeros(len(series.t), dtype=bool)
        for start in range(60, 540, 60):
            lost |= (series.t > start) & (series.t < start + 3.0)
        holed[name] = without(series, lost)
    assert [f for f in find_faults(holed, model()) if f.cause == "dropouts"] == []


def test_answers_that_are_polled_have_no_cycle_to_drop_out_of():
    speed = drive().samples["speed"]
    rng = np.random.default_rng(3)
    t = np.cumsum(0.09 + rng.exponential(0.015, 7000))
    t = t[t < speed.t[-1]]
    polled = Series(t, np.interp(t, speed.t, speed.values))
    assert faults_with(speed=polled) == []


# stuck and saturated ------------------------------------------------------------------------------


def test_a_signal_frozen_at_its_extreme_is_stuck_and_not_saturated():
    yaw = drive().samples["yaw_rate"]
    (found,) = faults_with(yaw_rate=held(yaw, int(np.argmax(np.abs(yaw.values))), 9.0))
    assert (found.cause, found.signal) == ("stuck_signal", "yaw_rate")


def test_an_axis_of_the_accelerometer_frozen_with_the_others_is_not_saturated():
    accel = drive().samples["accel"]
    top = int(np.argmax(np.abs(accel.values).max(axis=1)))
    (found,) = faults_with(accel=held(accel, top, 8.0))
    assert (found.cause, found.signal) == ("stuck_signal", "accel")
    (stretch,) = found.spoilt
    assert stretch[0] == pytest.approx(accel.t[top], abs=0.05)
    assert stretch[1] - stretch[0] == pytest.approx(8.0, abs=0.05)


def test_coarse_steps_and_a_parked_car_are_not_stuck():
    """Steps of a real module: 0.125 m/s^2 and 0.25 deg/s; a speed in whole km/h at 2 Hz."""
    samples = drive().samples
    speed = samples["speed"]
    slow = Series(speed.t[::25], np.rint(speed.values[::25] * 3.6) / 3.6)
    coarse = {
        name: Series(samples[name].t, np.rint(samples[name].values / step) * step)
        for name, step in (("accel", 0.125), ("gyro", np.deg2rad(0.25)), ("yaw_rate", 0.01))
    }
    alone: Samples = {**coarse, "speed": slow, "steering": samples["steering"]}
    fitting = model().with_changes({"speed.rate_hz": 2.0})
    assert find_faults(alone, fitting) == []


def test_a_steering_wheel_at_its_stop_is_not_saturated():
    steering = drive().samples["steering"]
    stop = 0.6 * float(np.abs(steering.values).max())
    clipped = Series(steering.t, np.clip(steering.values, -stop, stop))
    assert [f for f in faults_with(steering=clipped) if f.cause == "saturation"] == []


# clocks -------------------------------------------------------------------------------------------


def test_stamps_that_run_off_are_set_right():
    hidden = drive(Effect("clock_drift", "large", "stamps"))
    faults = find_faults(hidden.samples, model())
    straight = corrected(hidden.samples, faults)
    assert find_faults(straight, model()) == []
    sound = drive().samples
    for name in ("accel", "gyro"):
        np.testing.assert_allclose(straight[name].t, sound[name].t, atol=0.01)
    assert straight["speed"] is hidden.samples["speed"]


def test_a_slow_cycle_with_true_stamps_is_left_as_it_is():
    hidden = drive(Effect("clock_drift", "large", "cycle"))
    faults = find_faults(hidden.samples, model())
    assert corrected(hidden.samples, faults) is hidden.samples


def test_a_clock_that_the_model_file_knows_is_no_fault():
    hidden = drive(Effect("clock_drift", "large", "cycle"))
    known = model().with_changes(
        {
            f"{name}.clock_drift_ppm": hidden.parameters["accel.clock_drift_ppm"]
            for name in ("accel", "gyro")
        }
    )
    assert find_faults(hidden.samples, known) == []


def test_another_rate_than_the_model_files_is_no_drift():
    half = {name: Series(s.t[::2], s.values[::2]) for name, s in drive().samples.items()}
    assert [f for f in find_faults(half, model()) if f.cause == "clock_drift"] == []


# the model file -----------------------------------------------------------------------------------


def test_the_model_file_takes_the_faults():
    hidden = drive(
        Effect("saturation", "large", "accel"),
        Effect("dropouts", "medium", "speed"),
        Effect("stuck_signal", "medium", "yaw_rate"),
        Effect("clock_drift", "medium", "cycle"),
    )
    faults = find_faults(hidden.samples, model())
    extended = extend(model(), faults)
    true = hidden.parameters
    assert extended.accel.full_scale == pytest.approx(true["accel.full_scale"], abs=0.002)
    gaps = sum(gap.duration_s for gap in extended.speed.dropouts)
    assert gaps / (60.0 * MINUTES) == pytest.approx(true["speed.loss"], rel=0.1)
    still = sum(gap.duration_s for gap in extended.yaw_rate.stuck)
    assert still / (60.0 * MINUTES) == pytest.approx(true["yaw_rate.stuck_share"], rel=0.05)
    assert extended.gyro.clock_drift_ppm == pytest.approx(true["gyro.clock_drift_ppm"], abs=3.0)
    assert {"speed", "yaw_rate"} <= set(spoilt(faults))
    assert extend(model(), []) is not None


# measured drives ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", REAL)
def test_measured_drives_have_no_fault(name):
    log = DATA / name / "drive.log.gz"
    if not log.exists():
        pytest.skip(f"the measured drive {name} is not beside the repository")
    loaded = open_config(ROOT / "config" / "examples" / f"{name}.yaml")
    assert find_faults(read_samples(loaded, [log]).samples, VehicleModel()) == []
