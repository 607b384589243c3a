"""Configuration -> estimator: each key reaches the setting that it names, and no other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import pytest
import yaml
from msgspec import Struct

from imucald.config import Config, parse_config
from imucald.mount.estimator import FullEstimator
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.runtime.estimators import estimator_for, full_settings, published_settings

BASE: dict[str, Any] = {
    "database": "bus.dbc",
    "vehicle": {"driving_side": "right"},
    "signals": {
        "accelerometer": {"x": "A.X", "y": "A.Y", "z": "A.Z"},
        "steering_wheel_angle": "S.A",
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


def changed(settings: Callable[[Config], Any], path: str, value: object) -> dict[str, Any]:
    """The settings that a key changes, with their new values; nested ones dotted."""
    before, after = (flat(asdict(settings(config(c)))) for c in ({}, {path: value}))
    return {key: after[key] for key in after if after[key] != before[key]}


def flat(data: dict[str, Any], head: str = "") -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in data.items():
        nested = isinstance(value, dict) and head.count(".") < 1
        found |= flat(value, f"{head}{key}.") if nested else {f"{head}{key}": value}
    return found


PUBLISHED: list[tuple[str, Any, dict[str, Any]]] = [
    ("vehicle.driving_side", "left", {"crown": -0.012}),
    ("vehicle.driving_side", "unknown", {"crown": 0.0, "crown_std": math.hypot(0.012, 0.0065)}),
    ("vehicle.crown_percent", 2.0, {"crown": 0.02}),
    ("vehicle.crown_spread_percent", 2.0, {"crown_std": 0.02}),
    ("vehicle.wheelbase", 3.1, {"wheelbase": 3.1}),
    ("vehicle.steering_ratio", 12.0, {"steering_ratio": 12.0}),
    ("calibration.accelerometer_bias", 0.3, {"accel_bias_std": 0.3}),
    ("calibration.accelerometer_range", 20.0, {"accel_range": 20.0}),
    ("calibration.speed_delay", 0.2, {"speed_delay": 0.2}),
    ("calibration.states.usable_yaw_deg", 5.0, {"usable_yaw_std": math.radians(5.0)}),
    ("calibration.states.usable_tilt_deg", 5.0, {"usable_tilt_std": math.radians(5.0)}),
    ("calibration.states.fine_yaw_deg", 0.5, {"fine_yaw_std": math.radians(0.5)}),
    ("calibration.states.fine_tilt_deg", 0.5, {"fine_tilt_std": math.radians(0.5)}),
    ("calibration.static.samples", 30, {"static.count": 30}),
    ("calibration.static.duration", 3.0, {"static.seconds": 3.0}),
    ("calibration.static.threshold", [1.0, 2.0, 3.0], {"static.thresholds": (1.0, 2.0, 3.0)}),
    (
        "calibration.static.threshold_at_zero_speed",
        [4.0, 5.0, 6.0],
        {"static.thresholds_at_zero_speed": (4.0, 5.0, 6.0)},
    ),
    ("calibration.static.standstill_speed", 0.1, {"standstill_speed": 0.1}),
    ("calibration.static.average_stops", False, {"average_stops": False}),
    ("calibration.straight.recognise_by", ["steering"], {"recognisers": ("steering",)}),
    ("calibration.straight.yaw_rate_limit_deg_s", 3.0, {"yaw_rate_limit": math.radians(3.0)}),
    (
        "calibration.straight.yaw_rate_limit_without_speed_deg_s",
        3.0,
        {"yaw_rate_limit_without_speed": math.radians(3.0)},
    ),
    ("calibration.straight.steering_limit_deg", 4.0, {"steering_limit": math.radians(4.0)}),
    ("calibration.straight.lateral_limit", 0.0, {"lateral_limit": 0.0}),
    ("calibration.straight.min_speed_change", 0.5, {"min_speed_change": 0.5}),
    ("calibration.straight.manoeuvre_peak", 1.5, {"manoeuvre_peak": 1.5}),
    ("calibration.straight.min_speed", 3.0, {"min_speed": 3.0}),
    ("calibration.straight.consistency_window", 40, {"consistency_window": 40}),
    ("calibration.straight.consistency_range_deg", 9.0, {"consistency_spread": math.radians(9.0)}),
    ("calibration.target_angle.sign_from", ["turn"], {"sign_sources": ("turn",)}),
    ("calibration.target_angle.subtract_lateral", False, {"subtract_lateral": False}),
    ("calibration.target_angle.remove_offset_after", 0.0, {"remove_offset_after": 0.0}),
    ("signals.accelerometer", {"x": "A.X", "y": "A.Y"}, {"planar": True}),
]
FULL: list[tuple[str, Any, dict[str, Any]]] = [
    ("vehicle.driving_side", "left", {"driving_side": "left"}),
    (
        "vehicle.driving_side",
        "unknown",
        {"driving_side": "none", "crown_std": math.hypot(0.012, 0.0065)},
    ),
    ("vehicle.crown_percent", 2.0, {"crown_mean": 0.02}),
    ("vehicle.crown_spread_percent", 2.0, {"crown_std": 0.02}),
    ("vehicle.wheelbase", 3.1, {"wheelbase": 3.1}),
    ("vehicle.steering_ratio", 12.0, {"steering_ratio": 12.0}),
    ("vehicle.track", 1.9, {"track": 1.9}),
    ("calibration.accelerometer_bias", 0.3, {"accel_bias_std": 0.3}),
    ("calibration.accelerometer_range", 20.0, {"accel_range": 20.0}),
    ("calibration.cross_axis", 0.01, {"accel_cross_axis_std": 0.01}),
    ("calibration.states.usable_yaw_deg", 5.0, {"usable_std": math.radians(5.0)}),
    ("calibration.states.usable_tilt_deg", 5.0, {"usable_tilt_std": math.radians(5.0)}),
    ("calibration.states.fine_yaw_deg", 0.5, {"fine_std": math.radians(0.5)}),
    ("calibration.states.fine_tilt_deg", 0.5, {"fine_tilt_std": math.radians(0.5)}),
]


@pytest.mark.parametrize(("path", "value", "expected"), PUBLISHED, ids=lambda v: str(v)[-40:])
def test_a_key_reaches_method_a(path: str, value: object, expected: dict[str, Any]) -> None:
    assert changed(published_settings, path, value) == expected


@pytest.mark.parametrize(("path", "value", "expected"), FULL, ids=lambda v: str(v)[-40:])
def test_a_key_reaches_the_full_estimator(
    path: str, value: object, expected: dict[str, Any]
) -> None:
    assert changed(full_settings, path, value) == expected


def test_a_stated_delay_of_speed_is_taken_for_almost_certain() -> None:
    free, told = (
        full_settings(config(c)).delays["speed"] for c in ({}, {"calibration.speed_delay": 0.25})
    )
    assert told.mean == 0.25
    assert told.std < free.std
    assert free == EstimatorSettings().delays["speed"]


def test_no_key_of_the_calibration_is_left_out() -> None:
    tried = {path for path, _, _ in PUBLISHED + FULL}
    tried |= {"calibration.estimator", "calibration.speed_delay", "vehicle.id"}
    model = config()
    assert set(leaves(model.calibration, "calibration")) | set(
        leaves(model.vehicle, "vehicle")
    ) == tried - {"signals.accelerometer"}


def leaves(model: Struct, head: str) -> list[str]:
    found: list[str] = []
    for name in model.__struct_fields__:
        value, path = getattr(model, name), f"{head}.{name}"
        found += leaves(value, path) if isinstance(value, Struct) else [path]
    return found


def test_the_estimator_is_the_one_asked_for() -> None:
    assert isinstance(estimator_for(config()), FullEstimator)
    published = config({"calibration.estimator": "published"})
    assert isinstance(estimator_for(published), PublishedEstimator)
