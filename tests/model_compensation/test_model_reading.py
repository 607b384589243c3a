"""VehicleModel files as the daemon reads them: what is used, what is told, what is a mistake."""

from __future__ import annotations

import subprocess
import sys
import typing
from pathlib import Path

import pytest

from imucald.core.errors import ConfigError
from imucald.model_compensation import compensation_from_model
from imucald.simulation import VehicleModel, random_model
from simulated_bus import CONFIG

ALL = {"accel", "gyro", "mag", "speed", "temperature", "steering", "yaw_rate"}


def written(folder: Path, text: str) -> Path:
    path = folder / "car.yaml"
    path.write_text(text)
    return path


def test_a_written_model_is_read_without_a_word_about_unknown_keys(tmp_path):
    for seed in range(5):
        model = random_model(seed, "mixed")
        found = compensation_from_model(written(tmp_path, model.to_yaml()))
        assert not [note for note in found.notes_for(ALL) if "not known" in note]
        assert found.terms == compensation_from_model(model.dump()).terms


def test_what_is_left_out_stays_in_the_signals(tmp_path):
    """Unlike in a simulated drive, where the preset of a car is taken."""
    empty = compensation_from_model(written(tmp_path, "{}"))
    assert empty.compensated(ALL) == []
    assert empty.tick_preprocessing() is None
    assert empty.vehicle_correction(ALL).neutral
    one = compensation_from_model(written(tmp_path, "accel: {bias: [0.1, 0, 0]}"))
    assert one.compensated(ALL) == ["accel.bias"]


def test_switches_are_obeyed(tmp_path):
    text = (
        "suspension: {squat_dive: false, squat_gradient: 0.01, body_roll: false, roll_gradient: 1}"
    )
    with pytest.raises(ConfigError, match="roll_gradient"):
        compensation_from_model(written(tmp_path, text))
    text = text.replace("roll_gradient: 1", "roll_gradient: 0.01")
    assert compensation_from_model(written(tmp_path, text)).terms.suspension.neutral
    text = "mount: {lever_arm: false, lever_arm_m: [1, 0, 0]}"
    assert compensation_from_model(written(tmp_path, text)).compensated(ALL) == []


@pytest.mark.parametrize(
    ("text", "place", "reason"),
    [
        ("accel:\n  bias: [1, 2]\n", ":2: accel.bias", "list of length 3"),
        ("accel:\n  bias: [1, 2, x]\n", ":2: accel.bias[2]", "must be a number"),
        ("accel:\n  bias: [1, 2, true]\n", ":2: accel.bias[2]", "must be a number"),
        (
            "accel:\n\n  scale: [0, -0.9, 0]\n",
            ":3: accel.scale",
            "is a gain that cannot be corrected",
        ),
        ("gyro: 3\n", ":1: gyro", "mapping"),
        ("- 1\n", ":1:", "mapping"),
        ("speed: {scale: .nan}\n", ":1: speed.scale", "finite"),
        ("mount:\n  lever_arm_m: [0, 99, 0]\n", ":2: mount.lever_arm_m", "longer"),
        ("suspension: {body_roll: 1}\n", ":1: suspension.body_roll", "true or false"),
        ("accel: {delay_s: -1}\n", ":1: accel.delay_s", "at least 0"),
        ("gyro: {bias: [0, 99, 0]}\n", ":1: gyro.bias", "between -20 and 20"),
        ("wheel_speeds: {scale: [0, 0, 0, -1]}\n", ":1: wheel_speeds.scale", "not an error"),
        ("accel: {bias: [1, 2\n", ":2", "YAML"),
    ],
)
def test_a_mistake_is_one_line_with_its_place(tmp_path, text, place, reason):
    with pytest.raises(ConfigError) as caught:
        compensation_from_model(written(tmp_path, text))
    message = str(caught.value)
    assert f"car.yaml{place}" in message
    assert reason in message
    assert "\n" not in message


def test_a_file_that_is_not_there_or_no_text(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        compensation_from_model(tmp_path / "none.yaml")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match="not UTF-8"):
        compensation_from_model(tmp_path / "binary")


def test_what_cannot_be_used_is_reported():
    model = {
        "accel": {"bias_temperature": [0.01, 0, 0], "lowpass_hz": 1.2, "delay_s": 0.1},
        "mount": {"yaw_deg": 30.0, "lever_arm_m": [1, 0, 0], "shifts": [{"t_s": 3}]},
        "yaw_rate": {"stuck": [{"start_s": 1, "duration_s": 2}], "clock_drift_ppm": 100},
        "heading": {"offset": 0.1},
        "aerodynamics": {"drag": 0.3},
        "suspension": {"squat_gradient": 0.005, "anti_roll": 3},
    }
    told = " ".join(compensation_from_model(model, False).notes_for({"accel", "speed"}))
    for part in (
        "accel.bias_temperature: needs signals.temperature",
        "accel.lowpass_hz",
        "accel.delay_s",
        "mount: the angles in the model are not used",
        "mount.shifts",
        "mount.lever_arm_m: needs signals.gyroscope",
        "yaw_rate.stuck",
        "yaw_rate.clock_drift_ppm",
        "heading",
        "aerodynamics: this version does not know it",
        "suspension.anti_roll: this version does not know it",
        "suspension: not corrected",
    ):
        assert part in told, part
    with_all = " ".join(compensation_from_model(model).notes_for(ALL))
    assert "needs" not in with_all


@pytest.mark.slow
def test_reading_a_model_loads_none_of_the_simulation_and_nothing_without_one(tmp_path):
    model = written(tmp_path, VehicleModel().to_yaml())
    text = CONFIG.read_text().replace("../../", f"{CONFIG.parent.parent.parent}/")
    (tmp_path / "plain.yaml").write_text(text)
    (tmp_path / "with.yaml").write_text(f"{text}\nmodel: {model}\n")
    code = """
import sys
from pathlib import Path
from imucald.runtime.session import make_engine, open_config
make_engine(open_config(Path(sys.argv[1])))
print(*(name for name in ("scipy", "imucald.simulation", "imucald.model_compensation")
        if name in sys.modules))
"""
    for name, loaded in (("plain", ""), ("with", "imucald.model_compensation")):
        command = [sys.executable, "-c", code, str(tmp_path / f"{name}.yaml")]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        assert done.stdout.strip() == loaded


def test_equal_content_has_equal_keys_and_other_content_others():
    base = {"accel": {"bias": [0.1, 0, 0]}, "mount": {"lever_arm_m": [1, 0, 0]}}
    key = compensation_from_model(base).estimate_key
    assert compensation_from_model({**base, "route": {"kind": "city"}}).estimate_key == key
    for other in (
        {"accel": {"bias": [0.1, 0, 0.01]}},
        {"speed": {"delay_s": 0.2}},
        {"suspension": {"roll_gradient": 0.01}},
        {"road": {"crown_mean": 0.02}},
        {"mount": {}},
    ):
        assert compensation_from_model({**base, **other}).estimate_key != key


def test_every_term_comes_from_a_file():
    """A term that is never read would be silently ignored."""
    from imucald.model_compensation.terms import Terms

    full = compensation_from_model(
        {
            "accel": {"bias": [0.1, 0, 0], "delay_s": 0.1},
            "gyro": {"bias": [0.1, 0, 0], "g_sensitivity": [0.001, 0, 0]},
            "mag": {"hard_iron_t": [1e-6, 0, 0]},
            "wheel_speeds": {"scale": [0.01] * 4},
            "speed": {"scale": 0.01},
            "mount": {"lever_arm_m": [1, 0, 0]},
            "suspension": {"roll_gradient": 0.01},
            "chassis": {"wheelbase_m": 3.0},
            "road": {"crown_mean": 0.01, "bank_rms": 0.03, "grade_rms": 0.02},
        }
    ).terms
    for name in typing.get_type_hints(Terms):
        assert getattr(full, name) != getattr(Terms(), name), name
