"""A stuck sensor is seen to be stuck, whatever the model takes out of it."""

import numpy as np
import pytest
from benchmarks.corrected_drive import corrected_drive

from imucald.core.rotations import vector_from_rotation
from imucald.core.samples import Series
from imucald.model_compensation import compensation_from_model
from imucald.simulation import random_model, simulate

SEED, MINUTES = 47, 5.0


@pytest.mark.slow
@pytest.mark.parametrize("channel", ["gyro", "accel"])
def test_terms_that_change_from_sample_to_sample_do_not_make_a_stuck_sensor_move(channel):
    model = random_model(SEED, standing_first=True).with_changes(
        {
            "gyro.g_sensitivity": [0.002, -0.003, 0.001],
            "gyro.bias_temperature": [3e-4, -2e-4, 1e-4],
            "accel.bias_temperature": [3e-3, -2e-3, 1e-3],
            "temperature.rate_hz": 5.0,
        }
    )
    drive = simulate(model, SEED, MINUTES)
    sensor, speed = drive.samples[channel], drive.samples["speed"]
    values = sensor.values.copy()
    moving = np.interp(sensor.t, speed.t, np.abs(speed.values)) > 3.0
    frozen = 0
    for start in np.arange(90.0, 60.0 * MINUTES - 20.0, 30.0):
        inside = (sensor.t >= start) & (sensor.t < start + 10.0)
        if moving[inside].all():
            values[inside] = values[np.argmax(inside)]
            frozen += 1
    assert frozen >= 2
    samples = {**drive.samples, channel: Series(sensor.t, values)}
    compensation = compensation_from_model(model.dump())
    estimate = corrected_drive(samples, compensation).estimate
    assert estimate is not None
    counted = estimate.details["frozen_ticks"]
    assert isinstance(counted, dict)
    assert counted[channel]["stuck"] >= 95 * frozen
    assert estimate.R_vehicle_from_sensor is not None
    assert estimate.std is not None
    true = drive.truth.R_vehicle_from_sensor()
    error = vector_from_rotation(true @ estimate.R_vehicle_from_sensor.T)
    assert (np.abs(error) < 3.5 * np.array(estimate.std)).all()
