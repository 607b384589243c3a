"""Configuration -> estimator: it reads the configuration itself."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest
import yaml

from imucald.config import Config, parse_config
from imucald.mount.estimator import JointEstimator
from imucald.mount.estimator_settings import EstimatorSettings, MountSettings
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.runtime.estimators import estimator_for, joint_settings, published_settings

BASE: dict[str, Any] = {
    "database": "bus.dbc",
    "vehicle": {"driving_side": "right"},
    "signals": {
        "accelerometer": {"x": "A.X", "y": "A.Y", "z": "A.Z"},
        "steering_wheel_angle": "S.A",
        "speed": "S.V",
    },
}


def config(changes: dict[str, Any] | None = None) -> Config:
    """The base with keys, given as "section.part.key", set."""
    data = yaml.safe_load(yaml.safe_dump(BASE))
    for path, value in (changes or {}).items():
        *parents, last = path.split(".")
        place = data
        for part in parents:
            place = place.setdefault(part, {})
        place[last] = value
    return parse_config(yaml.safe_dump(data)).config


@pytest.mark.parametrize("settings", [published_settings, joint_settings])
def test_the_estimator_reads_the_configuration_itself(
    settings: Callable[[Config], MountSettings],
) -> None:
    whole = config({"calibration.accelerometer_bias": 0.3, "vehicle.track": 1.9})
    assert settings(whole).calibration is whole.calibration
    assert settings(whole).vehicle is whole.vehicle


@pytest.mark.parametrize(("side", "roll"), [("right", 0.02), ("left", -0.02), ("unknown", 0.0)])
def test_the_crown_leans_the_vehicle_towards_the_kerb(side: str, roll: float) -> None:
    keys = {"vehicle.driving_side": side, "vehicle.crown_percent": 2.0}
    found = joint_settings(config({**keys, "vehicle.crown_spread_percent": 1.5}))
    assert found.crown == pytest.approx(roll, abs=1e-15)
    # with an unknown side the mean of 0.02 lies to either: sqrt(0.02^2 + 0.015^2) = 0.025
    spread = 0.025 if side == "unknown" else 0.015
    assert found.vehicle.crown_std == pytest.approx(spread, abs=1e-15)


def test_limits_of_the_states_are_the_configured_ones_else_the_estimators_own() -> None:
    plain, given = (
        joint_settings(config(c)).limits for c in ({}, {"calibration.states.fine_yaw_deg": 0.9})
    )
    assert given.fine_yaw == pytest.approx(0.9 * math.pi / 180.0)
    assert given[:2] == plain[:2]
    assert published_settings(config()).limits.usable_yaw > plain.usable_yaw


def test_two_axes_are_planar_and_a_steering_signal_is_used() -> None:
    assert not published_settings(config()).planar
    planar = config({"signals.accelerometer": {"x": "A.X", "y": "A.Y"}})
    assert published_settings(planar).planar
    assert joint_settings(config()).uses_steering
    signals = {"accelerometer": BASE["signals"]["accelerometer"]}
    assert not joint_settings(config({"signals": signals})).uses_steering


def test_a_stated_delay_of_speed_is_taken_for_almost_certain() -> None:
    free, stated = (
        joint_settings(config(c)).delays["speed"] for c in ({}, {"calibration.speed_delay": 0.25})
    )
    assert stated.mean == 0.25
    assert stated.std < free.std
    assert free == EstimatorSettings().delays["speed"]


def test_the_estimator_is_the_one_asked_for() -> None:
    assert isinstance(estimator_for(config()), JointEstimator)
    published = config({"calibration.estimator": "published"})
    assert isinstance(estimator_for(published), PublishedEstimator)
    earlier = config({"calibration.estimator": "full"})
    assert isinstance(estimator_for(earlier), JointEstimator)


def test_without_speed_and_turns_method_a_finds_the_mount() -> None:
    silent = config({"signals": {k: v for k, v in BASE["signals"].items() if k != "speed"}})
    assert isinstance(estimator_for(silent), JointEstimator)
    alone = config({"signals": {"accelerometer": BASE["signals"]["accelerometer"]}})
    assert isinstance(estimator_for(alone), PublishedEstimator)


@pytest.mark.parametrize(
    ("changes", "are_turned"),
    [
        ({}, False),
        ({"signals.yaw_rate": "S.Y"}, False),
        ({"signals.yaw_rate": {"signal": "S.Y", "sign": -1}}, True),
        ({"signals.steering_wheel_angle": {"signal": "S.A", "sign": -1}}, False),  # every third is
        ({"signals.yaw_rate": {"signal": "S.Y", "sign": -1},
          "signals.accelerometer": {a: {"signal": f"A.{a}", "sign": -1} for a in "xyz"}}, False),
    ],
)  # fmt: skip
def test_a_turned_yaw_rate_beside_an_accelerometer_as_it_is_confirms_nothing(changes, are_turned):
    without = {"signals.steering_wheel_angle": None, **changes}
    data = yaml.safe_load(yaml.safe_dump(BASE))
    for path, value in without.items():
        data["signals"][path.partition(".")[2]] = value
    data["signals"] = {key: value for key, value in data["signals"].items() if value is not None}
    assert joint_settings(parse_config(yaml.safe_dump(data)).config).are_sides_turned == are_turned
