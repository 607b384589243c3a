"""Effects put into a measured drive: with a model that knows them the daemon gives what it gave.

The reference is an INS beside the sensor (forward axis known to 0.3 deg), the effects are made
here, sample by sample, and share nothing with what takes them out.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmarks.corrected_drive import CorrectedDrive, corrected_drive

from imucald.config import load_config
from imucald.core.samples import Samples, Series
from imucald.diagnosis.recording import read_samples
from imucald.model_compensation import compensation_from_model
from imucald.runtime.estimators import joint_settings

ROOT = Path(__file__).parents[2]
CONFIG = ROOT / "benchmarks" / "measured_drives" / "kingston_2008.yaml"
LOG = ROOT.parent / "shared" / "data" / "kingston_2008" / "drive.log.gz"
END_S = 1800.0
FORWARD = np.array([0.0039, 0.9998, 0.0155])

pytestmark = pytest.mark.skipif(not LOG.exists(), reason="the measured drive is not here")


@cache
def measured() -> Samples:
    """Its first half hour."""
    whole = read_samples(load_config(CONFIG), [LOG]).samples
    return {c: Series(s.t[s.t < END_S], s.values[s.t < END_S]) for c, s in whole.items()}


def settings():
    return joint_settings(load_config(CONFIG).config)


@cache
def undisturbed() -> CorrectedDrive:
    return corrected_drive(measured(), None, settings())


def forward_error(drive: CorrectedDrive) -> float:
    R = drive.estimate.R_vehicle_from_sensor
    return math.degrees(math.acos(min(1.0, float(R[0] @ FORWARD) / np.linalg.norm(FORWARD))))


def force_error(drive: CorrectedDrive) -> float:
    """Of the corrected force against that of the undisturbed drive, 1 s means, rms [m/s^2]."""
    reference = undisturbed().accel
    known = np.isfinite(reference.values[:, 0]) & np.isfinite(drive.accel.values[:, 0])
    known &= reference.t > 600.0
    wrong = drive.accel.values[known] - reference.values[known]
    smooth = np.stack([np.convolve(x, np.ones(10) / 10, "valid") for x in wrong.T])
    return float(np.sqrt((smooth**2).sum(axis=0).mean()))


def skewed(samples: Samples) -> Samples:
    """Its axes are not square: x sees 4 % of y, y of z, and z is 5 % too large."""
    x, y, z = samples["accel"].values.T
    values = np.stack([x + 0.04 * y, y + 0.04 * z, 1.05 * z], axis=1)
    return {**samples, "accel": Series(samples["accel"].t, values)}


def shifted(samples: Samples) -> Samples:
    values = samples["accel"].values + np.array([0.5, -0.4, 0.3])
    return {**samples, "accel": Series(samples["accel"].t, values)}


def late_force(samples: Samples) -> Samples:
    """The accelerometer's frames come 0.4 s late; the rest of the drive stays."""
    late = Series(samples["accel"].t + 0.4, samples["accel"].values)
    return {**samples, "accel": late}


CASES = {
    "skewed": (
        skewed,
        {"accel": {"cross_axis": [0.04, 0, 0, 0.04, 0, 0], "scale": [0, 0, 0.05]}},
        1.0,
    ),
    "shifted": (shifted, {"accel": {"bias": [0.5, -0.4, 0.3]}}, 0.0),
}
"""What is done to the drive, the model that knows it, and how far it turns the mount [deg]."""


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CASES))
def test_what_was_put_into_a_measured_drive_is_taken_out(name):
    disturb, model, turned = CASES[name]
    samples = disturb(measured())
    before = corrected_drive(samples, None, settings())
    after = corrected_drive(samples, compensation_from_model(model), settings())
    # a mount that contradicts itself may send nothing: then nothing wrong was sent either
    assert not np.isfinite(before.accel.values[before.accel.t > 600.0]).any() or (
        force_error(before) > 0.2
    )
    assert force_error(after) < 0.02
    assert forward_error(before) > turned
    assert forward_error(after) == pytest.approx(forward_error(undisturbed()), abs=0.05)


@pytest.mark.slow
def test_a_late_accelerometer_is_brought_together_with_speed_and_rate():
    """Speed leads this accelerometer by 0.2 to 0.25 s as it is: a model of the car would say so.

    Unknown, the estimator finds it at the end of its search, 0.5 s.
    """
    model = {"accel": {"delay_s": 0.62}, "gyro": {"delay_s": 0.22}, "speed": {"delay_s": 0.0}}
    samples = late_force(measured())
    found = corrected_drive(samples, compensation_from_model(model), settings())
    assert forward_error(found) < 1.0
    assert abs(float(found.estimate.details["speed_delay"])) < 0.4
