"""What the estimator is told of a model; the configuration's own words come first."""

from __future__ import annotations

import pytest

from imucald.config import VehicleSettings, parse_config
from imucald.inputs.wiring import compile_router
from imucald.model_compensation import compensation_from_model
from imucald.mount.estimator import JointEstimator
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.runtime.estimators import estimator_for
from imucald.runtime.session import make_engine, open_compensation, open_config
from paths import ROOT
from simulated_bus import CONFIG, drive

MODEL = {
    "road": {"crown_mean": 0.02},
    "chassis": {
        "wheelbase_m": 3.1,
        "steering_ratio": 17.0,
        "track_m": 1.7,
        "understeer_gradient": 0.004,
    },
    "accel": {"delay_s": 0.05},
    "speed": {"delay_s": 0.3},
}
TEXT = """
database: x.dbc
signals:
  accelerometer: {x: A.X, y: A.Y, z: A.Z}
  steering_wheel_angle: A.S
  speed: A.V
"""


def full(text: str):
    loaded = parse_config(TEXT + text)
    model = compensation_from_model(MODEL)
    estimator = estimator_for(loaded.config, model, loaded.keys_in("vehicle"))
    assert isinstance(estimator, JointEstimator)
    return estimator._settings


def test_crown_chassis_and_delays_come_from_the_model():
    found = full("vehicle: {driving_side: left}")
    assert found.crown == pytest.approx(-0.02)
    assert found.vehicle.crown_std == pytest.approx(0.0065), "the spread is the configuration's"
    assert found.uses_steering
    vehicle = found.vehicle
    assert (vehicle.wheelbase, vehicle.steering_ratio, vehicle.track) == (3.1, 17.0, 1.7)
    assert found.understeer == 0.004
    assert found.delays["speed"].mean == 0.0, "its ticks are brought together"
    assert found.delays["speed"].std < EstimatorSettings().delays["speed"].std


def test_the_lever_arm_comes_from_the_model():
    model = {"mount": {"lever_arm_m": [1.5, 0.0, 0.2]}}
    found = compensation_from_model(model).joint_settings(EstimatorSettings())
    assert found.lever_arm == (1.5, 0.0, 0.2)
    model["mount"]["lever_arm"] = False
    assert compensation_from_model(model).joint_settings(found).lever_arm == (0.0, 0.0, 0.0)


def test_roads_that_a_model_says_are_rough_come_from_it():
    model = {"road": {"bank_rms": 0.05, "grade_rms": 0.015}}
    found = compensation_from_model(model).joint_settings(EstimatorSettings())
    assert found.slope == 0.05
    model["road"]["bank"] = False
    assert compensation_from_model(model).joint_settings(found).slope == 0.02


def test_what_the_configuration_says_counts():
    found = full("vehicle: {driving_side: right, crown_percent: 0.5, wheelbase: 2.9}")
    assert found.crown == pytest.approx(0.005)
    assert found.vehicle.wheelbase == 2.9
    assert found.vehicle.steering_ratio == 17.0


def test_a_default_that_the_configuration_says_counts_as_well(tmp_path):
    default = VehicleSettings().wheelbase
    (tmp_path / "model.yaml").write_text("chassis: {wheelbase_m: 3.1, track_m: 1.7}\n")
    text = CONFIG.read_text()
    assert "  wheelbase:" not in text
    text = text.replace("vehicle:\n", f"model: model.yaml\nvehicle:\n  wheelbase: {default}\n")
    assert "  track:" not in text
    path = tmp_path / "car.yaml"
    path.write_text(text)
    engine = make_engine(open_config(path, [ROOT / "dbc" / "imucald_example.dbc"]))
    vehicle = engine.pipeline.estimator._settings.vehicle
    assert (vehicle.wheelbase, vehicle.track) == (default, 1.7)
    engine.restart_calibration()
    assert engine.pipeline.estimator._settings.vehicle.wheelbase == default


def test_an_unknown_side_of_the_road_stays_unknown():
    assert full("").crown == 0.0


def test_method_a_gets_the_same():
    config = parse_config(
        TEXT + "calibration: {estimator: published}\nvehicle: {driving_side: right}"
    )
    settings = estimator_for(config.config, compensation_from_model(MODEL))._settings
    assert settings.crown == pytest.approx(0.02)
    assert settings.calibration.speed_delay == 0.0
    assert (settings.vehicle.wheelbase, settings.vehicle.steering_ratio) == (3.1, 17.0)


def test_a_configured_speed_delay_counts_more_than_the_models(tmp_path):
    (tmp_path / "car.yaml").write_text("accel: {delay_s: 0.05}\nspeed: {delay_s: 0.3}\n")
    text = f"{TEXT}model: car.yaml\n"
    loaded = parse_config(text, tmp_path / "config.yaml")
    assert open_compensation(loaded).shifts()["accel"] == pytest.approx(0.3)
    loaded = parse_config(f"{text}calibration: {{speed_delay: 0.1}}\n", tmp_path / "config.yaml")
    compensation = open_compensation(loaded)
    shifts = compensation.shifts()
    assert compensation.joint_settings(EstimatorSettings()).delays["speed"].std < 0.05
    assert shifts["accel"] - shifts["speed"] == pytest.approx(0.1)


def test_a_model_of_the_simulated_car_fits_its_bus():
    """Every channel of the example bus that the model speaks of is one that the router gives."""
    channels = compile_router(open_config(CONFIG)).channels
    found = compensation_from_model(drive().model.dump())
    assert not [note for note in found.notes_for(channels) if "needs" in note]
