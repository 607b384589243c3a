"""What a model takes out of signals must not go on by itself when one of them is lost."""

import functools

import numpy as np
import pytest
from benchmarks.corrected_drive import corrected_drive

from imucald.core.rotations import vector_from_rotation
from imucald.core.samples import Samples, Series
from imucald.model_compensation import compensation_from_model
from imucald.simulation import Drive, VehicleModel, random_model, simulate

MINUTES = 15.0


@functools.cache
def leaning_drive() -> tuple[VehicleModel, Drive]:
    """A drive in a vehicle that leans more than most, and its model."""
    seed = 51
    model = random_model(seed).with_changes(
        {"suspension.roll_gradient": 0.012, "suspension.squat_gradient": 0.006}
    )
    return model, simulate(model, seed, MINUTES)


def without(samples: Samples, channels: tuple[str, ...], starts, seconds: float) -> Samples:
    """The samples with holes of some seconds in some channels."""
    out = dict(samples)
    for channel in channels:
        series = samples[channel]
        kept = np.ones(len(series.t), dtype=bool)
        for start in starts:
            kept &= (series.t < start) | (series.t >= start + seconds)
        out[channel] = Series(series.t[kept], series.values[kept])
    return out


ACCEL, BOTH = ("accel",), ("accel", "gyro")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lost", "seconds"),
    [
        (ACCEL, 0.45),
        (ACCEL, 3.0),
        (ACCEL, 9.0),
        (BOTH, 0.45),
        (BOTH, 3.0),
        (BOTH, 9.0),
    ],
)
def test_a_lost_accelerometer_makes_a_leaning_body_no_moved_sensor(lost, seconds):
    model, drive = leaning_drive()
    starts = np.arange(200.0, 60.0 * MINUTES - 20.0, 40.0)
    samples = without(drive.samples, lost, starts, seconds)
    compensation = compensation_from_model(model.dump())
    estimate = corrected_drive(samples, compensation).estimate
    assert estimate is not None
    assert estimate.details["shifts"] == []
    assert estimate.R_vehicle_from_sensor is not None
    assert estimate.std is not None
    true = drive.truth.R_vehicle_from_sensor()
    error = vector_from_rotation(true @ estimate.R_vehicle_from_sensor.T)
    assert (np.abs(error) < 3.5 * np.array(estimate.std)).all()
