"""Sensor errors that the simulation put in are gone: samples are those of a flawless sensor."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from imucald.core.samples import Series
from imucald.model_compensation import compensation_from_model
from imucald.simulation import Drive, VehicleModel, random_model, simulate

QUIET = {
    f"{sensor}.{key}": value
    for sensor in ("accel", "gyro")
    for key, value in {
        "noise_density": 0.0, "lsb": 0.0, "bias_walk": 0.0, "full_scale": None,
        "bias": [0, 0, 0], "scale": [0, 0, 0], "cross_axis": [0] * 6,
        "bias_temperature": [0, 0, 0], "loss": 0.0,
    }.items()
}  # fmt: skip
QUIET |= {"gyro.g_sensitivity": [0, 0, 0], "temperature.lsb": 0.0, "temperature.rate_hz": 50.0}
QUIET |= {
    f"{name}.{key}": 0.0
    for name in ("yaw_rate", "steering", "lateral_accel", "longitudinal_accel")
    for key in ("noise", "lsb", "offset", "scale")
}
QUIET |= {"speed.noise_mps": 0.0, "speed.lsb": 0.0, "speed.scale": 0.0, "speed.dead_band_mps": 0.0}
QUIET |= {"wheel_speeds.noise_mps": 0.0, "wheel_speeds.lsb": 0.0, "wheel_speeds.scale": [0] * 4}
QUIET |= {"wheel_speeds.dead_band_mps": 0.0, "mag.enabled": True}
QUIET |= {"mag.noise_t": 0.0, "mag.lsb": 0.0, "mag.hard_iron_t": [0, 0, 0]}


@cache
def flawless() -> VehicleModel:
    return random_model(5, "mixed").with_changes(QUIET)


@cache
def drive() -> Drive:
    return simulate(flawless(), 5, 2.0)


EXACT = {
    "accel": {
        "accel.bias": [0.3, -0.2, 0.1],
        "accel.scale": [0.05, -0.08, 0.1],
        "accel.cross_axis": [0.03, -0.02, 0.08, 0.01, -0.05, 0.04],
    },
    "gyro": {
        "gyro.bias": [0.03, -0.02, 0.01],
        "gyro.scale": [0.12, -0.05, 0.02],
        "gyro.cross_axis": [0.03, -0.02, 0.01, 0.01, -0.05, 0.04],
    },
    "mag": {"mag.hard_iron_t": [1e-5, -2e-5, 3e-6]},
    "speed": {"speed.scale": -0.1},
    "wheel_speeds": {"wheel_speeds.scale": [0.02, 0.05, -0.1, 0.1]},
    "yaw_rate": {"yaw_rate.offset": 0.03, "yaw_rate.scale": 0.15},
    "steering": {"steering.offset": -0.2, "steering.scale": 0.1},
    "lateral_accel": {"lateral_accel.offset": 0.3, "lateral_accel.scale": -0.2},
    "longitudinal_accel": {"longitudinal_accel.offset": -0.4, "longitudinal_accel.scale": 0.1},
}


def flawed(changes) -> tuple[dict[str, Series], dict[str, Series]]:
    model = flawless().with_changes(changes)
    raw = simulate(model, 5, 2.0).samples
    return raw, compensation_from_model(model.dump()).samples(raw)


@pytest.mark.slow
@pytest.mark.parametrize("channel", sorted(EXACT))
def test_what_the_model_knows_is_gone(channel):
    raw, found = flawed(EXACT[channel])
    true = drive().samples[channel]
    assert np.abs(raw[channel].values - true.values).max() > 1e-6
    assert np.array_equal(found[channel].t, true.t)
    rolling = np.abs(true.values) > 0.01 if "speed" in channel else slice(None)
    np.testing.assert_allclose(found[channel].values[rolling], true.values[rolling], atol=1e-9)
    for other in set(found) - {channel}:
        np.testing.assert_allclose(found[other].values, drive().samples[other].values, atol=1e-12)


@pytest.mark.parametrize("sensor", ["accel", "gyro"])
def test_the_drift_with_temperature_is_gone(sensor):
    drift = np.array([0.02, -0.01, 0.03]) * (1.0 if sensor == "accel" else 0.1)
    raw, found = flawed({f"{sensor}.bias_temperature": drift.tolist()})
    true = drive().samples[sensor].values
    later = drive().samples[sensor].t > 0.1  # before the first temperature it is not known
    wrong = np.abs(found[sensor].values - true)[later].max()
    assert wrong < 2e-3 * np.abs(raw[sensor].values - true)[later].max()


def test_without_a_temperature_the_drift_is_left():
    raw, _ = flawed({"accel.bias_temperature": [0.02, 0, 0]})
    cold = {c: s for c, s in raw.items() if c != "temperature"}
    model = flawless().with_changes({"accel.bias_temperature": [0.02, 0, 0]})
    found = compensation_from_model(model.dump()).samples(cold)
    assert np.array_equal(found["accel"].values, raw["accel"].values)


def test_a_temperature_that_cannot_be_leaves_the_one_before():
    model = {"accel": {"bias_temperature": [0.01, 0, 0]}}
    samples = {
        "accel": Series(np.arange(4.0), np.array([[0.0, 0.0, 9.8 + 0.1 * k] for k in range(4)])),
        "temperature": Series(np.array([0.5, 1.5, 2.5]), np.array([45.0, 215.0, -99.0])),
    }
    found = compensation_from_model(model).samples(samples)["accel"].values[:, 0]
    np.testing.assert_allclose(found, [0.0, -0.2, -0.2, -0.2])


def test_what_the_gyroscope_feels_of_the_force_is_gone():
    felt = [0.003, -0.002, 0.0015]
    raw, found = flawed({"gyro.g_sensitivity": felt})
    true = drive().samples["gyro"].values

    def wrong(values):
        return np.sqrt(((values - true) ** 2).mean(axis=0))

    assert (wrong(found["gyro"].values) < 0.03 * wrong(raw["gyro"].values)).all()


def test_a_speed_made_of_wheels_is_made_of_corrected_ones():
    model = {"wheel_speeds": {"scale": [0.1, 0.0, 0.0, -0.1]}, "speed": {"scale": 0.5}}
    stage = compensation_from_model(model).sensor_correction(derived_speed=True)
    wheels, speed = (11.0, 9.0, 12.0, 9.9), (9.95,)  # truly 10, 9, 12, 11
    out, refused = stage.frame(0.0, [("wheel_speeds", wheels), ("speed", speed)])
    assert refused == []
    assert dict(out)["speed"] == pytest.approx((10.5,))
    out, _ = stage.frame(0.0, [("yaw_rate", (0.1,))])
    assert out == [("yaw_rate", (0.1,))]


def test_what_was_clipped_or_cannot_be_is_refused():
    model = {
        "accel": {"full_scale": 20.0, "lsb": 0.01, "scale": [-0.7, 0.0, 0.0]},
        "lateral_accel": {"scale": -0.79},
    }
    compensation = compensation_from_model(model)
    t = np.arange(6.0)
    force = np.array([[0, 0, 9.8], [0, 0, -20.0], [0, 19.99, 9], [25.0, 0, 9], [70.0, 0, 9.8]])
    values = np.vstack([force, [[0.0, 0.0, 19.9]]])
    across = np.array([10.0, 50.0, -41.0, 0.0, 0.0, 41.0])
    found = compensation.samples({"accel": Series(t, values), "lateral_accel": Series(t, across)})
    # at the rail: refused; beyond it there is none; 70 / 0.3 is no acceleration of a car
    assert found["accel"].t.tolist() == [0.0, 3.0, 5.0]
    assert found["lateral_accel"].t.tolist() == [0.0, 2.0, 3.0, 4.0, 5.0]
    stage = compensation.sensor_correction()
    for i, v in enumerate(values.tolist()):
        out, refused = stage.frame(float(i), [("accel", v)])
        assert (refused == []) == (i in (0, 3, 5)) == (len(out) == 1)
