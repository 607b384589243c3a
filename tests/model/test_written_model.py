"""A model file key by key: only what stands in it counts, and every mistake is reported."""

import pytest

from imucald.core.errors import ConfigError
from imucald.model.written import read_written

TEXT = """
speed: {delay_s: 0.2, colour: red}
wings: {span_m: 3}
accel:
  bias: [0.1, 0, 0]
  full_scale: null
"""


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text(TEXT)
    return read_written(path, "car.yaml")


def test_a_key_that_is_not_there_has_no_default(file):
    assert file.value("speed", "delay_s") == 0.2
    assert file.value("speed", "scale") is None
    assert file.value("chassis", "wheelbase_m") is None
    assert file.value("accel", "full_scale", 9.0) is None


def test_values_have_the_types_of_the_schema(file):
    assert file.value("accel", "bias") == (0.1, 0.0, 0.0)
    assert all(type(x) is float for x in file.value("accel", "bias"))


def test_keys_of_later_versions_are_named_and_nothing_else(file):
    assert file.unknown == ["speed.colour", "wings"]
    file.check()


def test_all_mistakes_of_what_is_asked_for_are_reported_at_once(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text("accel:\n  bias: [0, x, 0]\n  lsb: -1\n  scale: 3\ngyro: 4\n")
    file = read_written(path, "car.yaml")
    assert file.value("accel", "bias", "absent") == "absent"
    file.value("accel", "lsb")
    file.value("accel", "lsb")
    file.refuse("accel", "delay_s", "is odd")
    with pytest.raises(ConfigError) as caught:
        file.check()
    lines = str(caught.value).splitlines()
    assert lines[0] == "car.yaml:5: gyro: must be a mapping"
    assert "car.yaml:2: accel.bias[1]: must be a number" in lines[1]
    assert "car.yaml:3: accel.lsb: must be a number at least 0" in lines[2]
    assert lines[3:] == ["car.yaml:1: accel.delay_s: is odd"]  # not in the file: its section's line


def test_a_mapping_has_no_lines():
    file = read_written({"accel": {"lsb": "x"}}, "model")
    file.value("accel", "lsb")
    with pytest.raises(ConfigError, match=r"^model: accel\.lsb: must be a number"):
        file.check()
