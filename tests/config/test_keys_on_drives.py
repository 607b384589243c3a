"""Method A's keys on drives with and without each signal: each has an effect, or `check` says not.

The drives are those of `published_drive`, which has the motion from no code of the package.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from imucald.config import Config, parse_config
from imucald.config.calibration import CalibrationSettings
from imucald.motion.ticks import REVERSE
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.mount.method_a.settings import PublishedSettings
from published_drive import Drive

MOUNT = Rotation.from_euler("ZYX", [2.2, 0.25, -0.3])
NAMES = {
    "gyro": ("gyroscope", {"x": "G.X", "y": "G.Y", "z": "G.Z"}),
    "speed": ("speed", "V.V"),
    "steering": ("steering_wheel_angle", "S.A"),
    "brake": ("brake", "B.B"),
    "yaw_rate": ("yaw_rate", "Y.R"),
    "reverse": ("reverse", "R.R"),
}
DRIVES = (
    (),
    ("reverse",),
    ("speed", "reverse"),
    ("speed", "gyro", "yaw_rate", "reverse"),
    ("gyro", "yaw_rate", "steering", "reverse"),
    ("gyro", "yaw_rate", "steering", "speed", "reverse"),
)
"""What each lacks."""
VALUES: dict[str, Any] = {
    "static.samples": 1000,
    "static.duration": 9.0,
    "static.threshold": [0.001] * 3,
    "static.threshold_at_zero_speed": [0.001] * 3,
    "static.standstill_speed": 0.001,
    "static.average_stops": False,
    "straight.recognise_by": ["consistency"],
    "straight.yaw_rate_limit_deg_s": 0.05,
    "straight.yaw_rate_limit_without_speed_deg_s": 0.05,
    "straight.steering_limit_deg": 0.05,
    "straight.lateral_limit": 0.001,
    "straight.min_speed_change": 1.5,
    "straight.manoeuvre_peak": 2.0,
    "straight.min_speed": 9.0,
    "straight.min_speed_without_reverse": 9.0,
    "straight.consistency_window": 40,
    "straight.consistency_range_deg": 2.0,
    "straight.consistency_mean": 0.3,
    "target_angle.sign_from": ["first_motion"],
    "target_angle.subtract_lateral": False,
    "target_angle.remove_offset_after": 0.0,
    "method_a.level": False,
}
"""For each key one value far from its default."""


@cache
def rows(lacks: tuple[str, ...]) -> list[list[float]]:
    ticks = Drive(minutes=5, seed=3, mount=MOUNT, slope_deg=0.2).ticks(*lacks)
    if "reverse" not in lacks:
        for row in ticks:
            row[REVERSE] = 0.0
    return ticks


def config(lacks: tuple[str, ...], key: str = "", letter: bool = False) -> Any:
    signals: dict[str, Any] = {"accelerometer": {"x": "A.X", "y": "A.Y", "z": "A.Z"}}
    signals |= {name: source for short, (name, source) in NAMES.items() if short not in lacks}
    calibration: dict[str, Any] = {"estimator": "published"}
    calibration["method_a"] = {"to_the_letter": letter}
    if key:
        section, _, name = key.partition(".")
        calibration.setdefault(section, {})[name] = VALUES[key]
    return parse_config(
        yaml.safe_dump({"database": "b.dbc", "signals": signals, "calibration": calibration})
    )


def found_by(loaded: Config, lacks: tuple[str, ...]) -> tuple[Any, ...]:
    """What a drive gives: state, angles, what was counted."""
    estimator = PublishedEstimator(PublishedSettings(loaded.calibration, loaded.vehicle))
    for row in rows(lacks):
        estimator.step(row)
    e = estimator.estimate()
    R = None if e.R_vehicle_from_sensor is None else e.R_vehicle_from_sensor.tobytes()
    C = None if e.covariance is None else np.asarray(e.covariance).tobytes()
    return e.state, R, C, str(sorted(e.details.items(), key=str))


@cache
def plain(lacks: tuple[str, ...], letter: bool) -> tuple[Any, ...]:
    return found_by(config(lacks, letter=letter).config, lacks)


def test_every_key_of_method_a_has_a_value() -> None:
    sections = {f.name: f.type for f in msgspec.structs.fields(CalibrationSettings)}
    keys = {
        f"{section}.{field.encode_name}"
        for section in ("static", "straight", "target_angle", "method_a")
        for field in msgspec.structs.fields(sections[section])
    }
    assert keys - {"method_a.to_the_letter"} == set(VALUES)


@pytest.mark.slow
@pytest.mark.parametrize("letter", [False, True])
@pytest.mark.parametrize("key", VALUES)
def test_a_key_has_an_effect_on_each_drive_or_is_reported(key: str, letter: bool) -> None:
    for lacks in DRIVES:
        loaded = config(lacks, key, letter)
        is_reported = any(f"calibration.{key}: has no effect" in x for x in loaded.idle_keys())
        changes = found_by(loaded.config, lacks) != plain(lacks, letter)
        if key == "straight.recognise_by" and not is_reported:
            continue  # without the other signals it is what decides anyway
        assert changes != is_reported, f"without {lacks}"
