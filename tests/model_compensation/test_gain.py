"""What the model is worth: corrected signals and mount against the truth, with and without it.

Drives of the simulation with one effect more than the model "before" knows of.
"""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest
from benchmarks.corrected_drive import CorrectedDrive, corrected_drive, corrected_with
from benchmarks.truth_error import DriveErrors, drive_errors, true_signals

from imucald.model_compensation import ModelCompensation, compensation_from_model
from imucald.simulation import Drive, VehicleModel, random_model, simulate
from mount_settings import joint_settings

SEEDS = (31, 32)
MINUTES = 8.0
FROM_S = 150.0


@cache
def base(seed: int) -> VehicleModel:
    return random_model(seed, "mixed", standing_first=True)


@cache
def _driven(seed: int, changes: str) -> Drive:
    return simulate(base(seed).with_changes(json.loads(changes)), seed, MINUTES)


def driven(seed: int, changes) -> Drive:
    return _driven(seed, json.dumps(changes))


def corrected(drive: Drive, compensation: ModelCompensation | None) -> CorrectedDrive:
    side = drive.model.route.driving_side
    return corrected_drive(
        drive.samples, compensation, joint_settings(vehicle={"driving_side": side})
    )


def before_and_after(changes, seeds, own_mount=True) -> tuple[list[DriveErrors], ...]:
    before, after = [], []
    for seed in seeds:
        drive = driven(seed, changes)
        for model, out in ((base(seed), before), (drive.model, after)):
            compensation = compensation_from_model(model.dump())
            if own_mount:
                found = corrected(drive, compensation)
            else:
                R = drive.truth.R_vehicle_from_sensor()
                found = corrected_with(drive.samples, compensation, R)
            out.append(drive_errors(found, drive.truth, from_s=FROM_S))
    return before, after


def rms(errors: list[DriveErrors], name: str, axes) -> float:
    return float(np.sqrt(np.mean([getattr(e, name)[list(axes)] ** 2 for e in errors])))


ALL, LEVEL = (0, 1, 2), (0, 1)
SIGNAL_CASES = {
    "accel_bias": ({"accel.bias": [0.25, -0.2, 0.15]}, "accel", ALL, 0.5),
    "lever_arm": ({"mount.lever_arm_m": [2.0, 0.5, 0.0]}, "accel", LEVEL, 0.9),
    "body_roll": ({"suspension.roll_gradient": 0.025}, "accel", (1,), 0.9),
    "gyro_bias": ({"gyro.bias": [0.01, -0.01, 0.01]}, "gyro", ALL, 0.7),
    "gyro_scale": ({"gyro.scale": [0.1, 0.1, 0.1]}, "gyro", ALL, 0.97),
    "warming": ({"gyro.bias_temperature": [0.0005, -0.0006, 0.0007]}, "gyro", ALL, 0.8),
    "g_sensitivity": ({"gyro.g_sensitivity": [0.001, 0.001, 0.001]}, "gyro", ALL, 0.7),
}
"""Changes, what is looked at, its axes, and the largest part of the error that may be left."""


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SIGNAL_CASES))
def test_corrected_signals_are_nearer_to_the_truth(name):
    """With the true mount: the signals' own error."""
    changes, signal, axes, most = SIGNAL_CASES[name]
    before, after = before_and_after(changes, SEEDS[:1], own_mount=False)
    assert rms(after, signal, axes) < most * rms(before, signal, axes)


SOFT = {"suspension.squat_gradient": 0.015, "suspension.dive_gradient": 0.002}
MOUNT_CASES = {
    "accel_scale": ({"accel.scale": [0.0, 0.08, 0.0]}, (1, 2), ALL, 0.75),
    "accel_cross_axis": ({"accel.cross_axis": [0.03, 0, -0.03, 0.02, 0, 0.03]}, (1, 2), ALL, 0.7),
    "squat_alone": (SOFT, (1,), (0,), 0.9),
    "accel_delay": ({"accel.delay_s": 0.3}, (1, 2), ALL, 1.05),
}
"""Changes, angles that they turn; axes of the force, and how much of its error may be left. The
estimator takes off most of the first two itself.
"""
MOUNT_SEEDS = range(31, 39)
"""The mount after 3 min is 0.3 to 0.5 deg off by chance, which moves the force as far as squat
does: two drives say nothing of it."""


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(MOUNT_CASES))
def test_mount_and_signals_are_nearer_to_the_truth_where_the_effect_had_turned_it(name):
    changes, angles, axes, most = MOUNT_CASES[name]
    before, after = before_and_after(changes, MOUNT_SEEDS)
    assert rms(before, "mount", angles) > 0.1, "the effect turns it"
    assert rms(after, "mount", angles) < 0.8 * rms(before, "mount", angles)
    assert np.isfinite(rms(after, "accel", axes)), "with the model, signals are sent in every drive"
    sent = [k for k, one in enumerate(before) if np.isfinite(one.accel).all()]
    if name not in ("accel_scale", "accel_cross_axis"):
        assert len(sent) == len(MOUNT_SEEDS)
    # with 8 % of gain on one axis yaw from braking and from bends lie 6 deg apart: +-1.6 deg; a
    # cross-axis error of 2 to 3 % leaves yaw less known than *usable* asks for in some drives
    assert sent, "without it a mount that contradicts itself may send nothing, but not in all"
    before, after = [before[k] for k in sent], [after[k] for k in sent]
    assert rms(after, "accel", axes) < most * rms(before, "accel", axes)


@pytest.mark.slow
def test_a_delay_that_the_model_has_wrong_is_still_found():
    """Nobody looked: the file says what a new file says, no delay."""
    drive = driven(31, {"speed.delay_s": 0.25})
    wrong = drive.model.with_changes({"speed.delay_s": 0.0})
    found = corrected(drive, compensation_from_model(wrong.dump()))
    assert float(found.estimate.details["speed_delay"]) == pytest.approx(0.25, abs=0.05)


@pytest.mark.slow
def test_a_known_delay_of_speed_need_not_be_learnt():
    """The estimator sees signals of one time: what it would find as delay is nothing."""
    drive = driven(31, {"speed.delay_s": 0.4})
    known = corrected(drive, compensation_from_model(drive.model.dump()))
    unknown = corrected(drive, None)
    assert abs(float(known.estimate.details["speed_delay"])) < 0.05
    assert float(unknown.estimate.details["speed_delay"]) > 0.3
    assert np.isfinite(known.accel.values).all(axis=1).mean() > 0.5


@pytest.mark.slow
def test_nothing_of_the_noise_is_made_louder():
    """Single samples, vibration and all: with lever arm and suspension no axis is worse."""
    drive = driven(31, {"mount.lever_arm_m": [1.5, 0.3, 0.5]})
    data = drive.model.dump()
    bare = {**data, "mount": {}, "suspension": {}}
    force, rate = true_signals(drive.truth, True)
    R = drive.truth.R_vehicle_from_sensor()
    errors = []
    for model in (bare, data):
        found = corrected_with(drive.samples, compensation_from_model(model), R)
        both = []
        for series, true in ((found.accel, force), (found.gyro, rate)):
            wanted = np.stack([np.interp(series.t, drive.truth.t, x) for x in true.T], axis=1)
            both.append(np.sqrt(((series.values - wanted) ** 2).mean(axis=0)))
        errors.append(np.concatenate(both))
    assert (errors[1] < 1.01 * errors[0]).all()
    assert (errors[1][[0, 1, 3, 4]] < 0.98 * errors[0][[0, 1, 3, 4]]).all()


@pytest.mark.slow
def test_the_trial_without_a_model_is_the_plain_pipeline():
    drive = driven(31, {"speed.delay_s": 0.4})
    plain, empty = corrected(drive, None), corrected(drive, compensation_from_model({}))
    assert np.array_equal(plain.accel.values, empty.accel.values, equal_nan=True)
    assert np.array_equal(
        plain.estimate.R_vehicle_from_sensor, empty.estimate.R_vehicle_from_sensor
    )
