"""A stuck gyroscope is seen to be stuck, whatever the model takes out of it."""

import numpy as np

from imucald.compensation import compensation_from_model
from imucald.compensation.trial import corrected_drive
from imucald.frames import vector_from_rotation
from imucald.samples import Series
from imucald.simulation import random_model, simulate

SEED, MINUTES = 47, 5.0


def test_terms_that_change_from_sample_to_sample_do_not_make_a_stuck_gyroscope_move():
    model = random_model(SEED, standing_first=True).with_changes(
        {
            "gyro.g_sensitivity": [0.002, -0.003, 0.001],
            "gyro.bias_temperature": [3e-4, -2e-4, 1e-4],
            "temperature.rate_hz": 5.0,
        }
    )
    drive = simulate(model, SEED, MINUTES)
    gyro, speed = drive.samples["gyro"], drive.samples["speed"]
    values = gyro.values.copy()
    moving = np.interp(gyro.t, speed.t, np.abs(speed.values)) > 3.0
    frozen = 0
    for start in np.arange(90.0, 60.0 * MINUTES - 20.0, 30.0):
        inside = (gyro.t >= start) & (gyro.t < start + 10.0)
        if moving[inside].all():
            values[inside] = values[np.argmax(inside)]
            frozen += 1
    assert frozen >= 2
    samples = {**drive.samples, "gyro": Series(gyro.t, values)}
    compensation = compensation_from_model(model.model_dump(mode="json"))
    estimate = corrected_drive(samples, compensation).estimate
    assert estimate is not None
    counted = estimate.details["frozen_ticks"]
    assert isinstance(counted, dict)
    assert counted["stuck"] >= 95 * frozen
    assert estimate.R_vehicle_from_sensor is not None
    assert estimate.std is not None
    true = drive.truth.R_vehicle_from_sensor()
    error = vector_from_rotation(true @ estimate.R_vehicle_from_sensor.T)
    assert (np.abs(error) < 3.5 * np.array(estimate.std)).all()
