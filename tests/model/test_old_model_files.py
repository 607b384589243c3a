"""VehicleModel files written before the schema was one of msgspec are read as they were then.

Keys and notes below are what the program made of the same files then (commit 737ab42).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from imucald.model_compensation import compensation_from_model
from imucald.simulation import VehicleModel, load_model
from paths import ROOT, SHARED_DATA

FOLDER = ROOT / "tests" / "data" / "models"
WRITTEN = ("written_changed", "written_switched")
KEYS = {
    "written_changed": "3856fd56e60f88474e38e9dbc23c6a67fc408ba0821dc1e8182bc89f0ba12000",
    "written_switched": "baee4ac05dcefc41fff4956106e29cde26b49cb42492dff57850fc0654b162f6",
    "by_hand": "6e2546b59bb02a5b6aadf4afb7bb651aa48c42f263d11796cd43424740209985",
}
"""A saved calibration is found by these."""
NEW_LINES = ("known_to: {}\n", "leaves: {}\n", "  delay_rate: 0.0\n")
"""What files did not have then, with its default, as it is written today."""


def without_new(content: dict[str, Any]) -> dict[str, Any]:
    """A model's content without the keys that came since; they must hold their defaults."""
    assert content.pop("known_to") == {}
    assert content.pop("leaves") == {}
    assert content["speed"].pop("delay_rate") == 0.0
    return content


@pytest.mark.parametrize("name", WRITTEN)
def test_a_whole_file_is_read_and_written_again_to_the_last_byte(name):
    path = FOLDER / f"{name}.yaml"
    model = load_model(path)
    assert without_new(model.dump()) == yaml.safe_load(path.read_text())
    lines = model.to_yaml().splitlines(keepends=True)
    assert "".join(line for line in lines if line not in NEW_LINES) == path.read_text()


def test_a_whole_file_has_every_key_of_the_schema():
    """Otherwise the test above says nothing of a key that was renamed."""
    old = yaml.safe_load((FOLDER / "written_changed.yaml").read_text())
    new = without_new(VehicleModel().dump())
    assert list(new) == list(old)
    for section, content in new.items():
        if isinstance(content, dict):
            assert list(content) == list(old[section])


def test_a_short_file_is_read_with_the_defaults_of_then():
    changes = {
        "accel.bias": (0.1, -0.2, 0.01),
        "speed.delay_s": 0.2,
        "speed.scale": 0.01,
        "suspension.roll_gradient": 0.01,
        "chassis.wheelbase_m": 3.0,
    }
    assert load_model(FOLDER / "by_hand.yaml") == VehicleModel().with_changes(changes)


@pytest.mark.parametrize("name", KEYS)
def test_the_daemon_takes_the_same_terms_out_of_it(name):
    assert compensation_from_model(FOLDER / f"{name}.yaml").estimate_key == KEYS[name]


def test_the_daemon_says_the_same_of_what_it_does_not_use():
    notes = compensation_from_model(FOLDER / "written_changed.yaml").notes
    assert [note.partition(": ")[0] for note in notes] == [
        "mount",
        "mount.shifts",
        "gyro.lowpass_hz",
        "accel.delay_s",
        "gyro.delay_s",
        "accel.clock_drift_ppm",
        "gyro.clock_drift_ppm",
        "speed.dropouts",
        "yaw_rate.stuck",
    ]
    assert compensation_from_model(FOLDER / "by_hand.yaml").notes == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    "path", sorted((SHARED_DATA / "second_world").glob("*/model.yaml")), ids=str
)
def test_model_files_of_another_simulation_are_read(path: Path):
    content, whole = yaml.safe_load(path.read_text()), load_model(path).dump()
    for section, keys in content.items():
        assert {key: whole[section][key] for key in keys} == keys
    assert not [note for note in compensation_from_model(path).notes if "not known" in note]
