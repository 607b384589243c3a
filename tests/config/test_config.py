"""Configuration files: shorthands, bounds, and one clear line for every mistake."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucald.config import Config, json_schema, load_config, parse_config
from imucald.core.errors import ConfigError
from imucald.runtime.session import open_config
from paths import ROOT

FOLDERS = ("config/examples", "benchmarks/measured_drives")
EXAMPLES = sorted(path for folder in FOLDERS for path in (ROOT / folder).glob("*.yaml"))
HEAD = "database: a.dbc\nsignals:\n  accelerometer: {x: M.X, y: M.Y, z: M.Z}\n"


def mistakes(text: str) -> list[str]:
    with pytest.raises(ConfigError) as error:
        parse_config(text, Path("dir/car.yaml"))
    return str(error.value).splitlines()


def test_a_few_lines_are_a_configuration_with_presets():
    config = parse_config(HEAD).config
    assert config.calibration.estimator == "joint"
    assert config.output.status_rate == 1
    assert config.output.ids.acceleration == 0x640
    assert config.signals.accelerometer[0].x.sign == 1
    assert config.database[0].path == "a.dbc"


def test_shorthands_and_long_forms_are_the_same():
    long = (
        "database:\n  - {path: a.dbc}\nsignals:\n  accelerometer:\n"
        "    - {x: {signal: M.X}, y: {signal: M.Y}, z: {signal: M.Z}}\n"
        "  speed:\n    - {signal: M.V}\n    - {signal: M.W}\n"
    )
    assert parse_config(long).config == parse_config(f"{HEAD}  speed: [M.V, M.W]\n").config


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (
            f"{HEAD}  sped: M.V\n",
            "car.yaml:4: signals.sped: unknown key; did you mean 'speed'?",
        ),
        (f"{HEAD}oputput: {{}}\n", "dir/car.yaml:4: oputput: unknown key; did you mean 'output'?"),
        (
            f"{HEAD}calibration: {{fine_yaw_deg: 1}}\n",
            "calibration.fine_yaw_deg: unknown key; did you mean calibration.states.fine_yaw_deg?",
        ),
        (f"{HEAD}id: VIN\n", "car.yaml:4: id: unknown key; allowed: attitude,"),
        (f"{HEAD}output:\n  status_rate: 3\n", "dir/car.yaml:5: output.status_rate:"),
        (f"{HEAD}  speed:\n    - M.V\n    - {{unit: g}}\n", "dir/car.yaml:6: signals.speed[1]"),
        (f"{HEAD}  speed: {{signal: M.V, sign: 2}}\n", "dir/car.yaml:4: signals.speed.sign:"),
        (f"{HEAD}  speed: {{signal: M.V, range: [3, 1]}}\n", "dir/car.yaml:4: signals.speed"),
        (
            f"{HEAD}  speed: {{signal: M.V, offset: .nan}}\n",
            "car.yaml:4: signals.speed.offset:",
        ),
        (f"{HEAD}  gyroscope: {{x: M.X, y: M.Y}}\n", "only the accelerometer may lack its z"),
        (
            f"{HEAD}output:\n  ids:\n    health: 0x640\n",
            "acceleration and health have the same id 0x640",
        ),
        (f"{HEAD}output:\n  ids:\n    health: 0x20000000\n", "dir/car.yaml:6: output.ids.health:"),
        (f"{HEAD}calibration:\n  static: {{samples: 1}}\n", "calibration.static.samples:"),
        (
            "signals: {accelerometer: {x: M.X, y: M.Y}}\n",
            "dir/car.yaml:1: database: is missing; it is required",
        ),
        ("database: a.dbc\nsignals: {}\n", "signals.accelerometer: is missing"),
        ("", "dir/car.yaml:1: the file is empty; a configuration is a mapping"),
        ("# nothing yet\n", "dir/car.yaml:1: the file is empty"),
        ("[1, 2]\n", "dir/car.yaml:1: a configuration is a mapping"),
        ("a: [1\n", "not valid YAML"),
        (
            "a:\n\tb: 1\n",
            "dir/car.yaml:2: not valid YAML: found character that cannot start any token"
            "; indent with spaces, not tabs",
        ),
        ("a: 1\nb: 2\na: 3\n", "dir/car.yaml:3: the key 'a' occurs here a second time"),
        ("a: &x [1]\nb: *x\n", "dir/car.yaml:2: YAML aliases"),
        ("? [1, 2]\n: 3\n", "a key must be a plain word"),
        ("a: !!python/object:os.system x\n", "dir/car.yaml:1:"),
        ("a: 2020-01-01\n", "is neither text nor number"),
        ("a: " + "[" * 50 + "]" * 50 + "\n", "nested too deeply"),
    ],
)
def test_a_mistake_is_one_line_with_its_place(text, expected):
    found = mistakes(text)
    assert len(found) == 1
    assert expected in found[0]


def test_all_mistakes_are_reported_at_once():
    found = mistakes(f"{HEAD}  sped: M.V\n  brake: 3\noutput: {{status_rate: 0}}\n")
    assert {line.split(": ")[0] for line in found} == {f"dir/car.yaml:{n}" for n in (4, 5, 6)}


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_examples_are_valid(path):
    loaded = load_config(path)
    assert loaded.database_path(loaded.config.database[0]).suffix == ".dbc"


def test_two_axes_of_a_sensor_are_two_signals():
    text = "database: a.dbc\nsignals:\n  accelerometer: {x: A.X, y: A.Y, z: A.X}\n"
    assert mistakes(text) == [
        "dir/car.yaml:3: signals.accelerometer: x and z name the same signal, A.X"
    ]


def test_a_wheelbase_in_centimetres_is_refused():
    (found,) = mistakes(f"{HEAD}vehicle: {{wheelbase: 270}}\n")
    assert "vehicle.wheelbase: must be a number at most 15.0 (here: 270)" in found


def test_numbers_with_an_exponent_are_numbers_unless_in_quotes():
    text = HEAD + "calibration: {accelerometer_range: 2e1}\nvehicle: {track: '2e0'}\n"
    (found,) = mistakes(text)
    assert "vehicle.track: must be a number" in found
    config = parse_config(text.replace("'2e0'", "2")).config
    assert config.calibration.accelerometer_range == 20.0


def test_mistakes_of_all_kinds_are_stated_in_plain_words():
    text = (
        f"{HEAD}  speed: {{sign: 2}}\nvehicle: {{wheelbase: -1, id: 3}}\n"
        "messages:\n  A: {counter: 3}\n  B: {timeout_cycles: 1}\n"
        "calibration:\n  static: {threshold: [1, 2]}\n  straight: {recognise_by: [steering, x]}\n"
    )
    assert [line.removeprefix("dir/car.yaml:") for line in mistakes(text)] == [
        "4: signals.speed.sign: must be one of -1, 1 (here: 2)",
        "5: vehicle.wheelbase: must be a number at least 0.5 (here: -1)",
        "5: vehicle.id: must be a text, got a whole number (here: 3)",
        "7: messages.A.counter: must be a mapping or nothing, got a whole number (here: 3)",
        "8: messages.B.timeout_cycles: must be a number at least 1.5 (here: 1)",
        "10: calibration.static.threshold: must be a list of length 3, got 2",
        "11: calibration.straight.recognise_by[1]: must be one of 'yaw_rate', 'steering', "
        "'consistency' (here: 'x')",
    ]


def test_databases_given_stand_in_for_those_named(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text(HEAD, encoding="utf-8")
    loaded = open_config(path, [Path("other.dbc")])
    assert loaded.database_path(loaded.config.database[0]) == Path("other.dbc").resolve()
    with pytest.raises(ConfigError, match="names 1 database"):
        open_config(path, [Path("a.dbc"), Path("b.dbc")])


def test_files_that_are_none_are_reported(tmp_path):
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path / "absent.yaml")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_config(tmp_path)
    path = tmp_path / "latin.yaml"
    path.write_bytes(b"a: \xe4\n")
    with pytest.raises(ConfigError, match="not UTF-8"):
        load_config(path)
    path.write_bytes(b"#" * 1_000_001)
    with pytest.raises(ConfigError, match="too long"):
        load_config(path)


def test_the_schema_describes_every_key():
    schema = json.loads(json_schema())
    assert set(schema["properties"]) == set(Config.__struct_fields__)
    assert "SourceSettings" in schema["definitions"]


def test_a_database_in_the_place_of_the_configuration_is_named_as_one(tmp_path):
    path = tmp_path / "car.dbc"
    path.write_text('VERSION ""\n')
    with pytest.raises(ConfigError, match=r"car\.dbc: this is a CAN database; .*imucald init"):
        load_config(path)


@given(st.text(max_size=200))
def test_text_of_any_kind_is_a_configuration_or_an_error_of_ours(text):
    problem = None
    try:
        parse_config(text, Path("x.yaml"))
    except ConfigError as error:
        problem = str(error)
    assert problem is None or problem.startswith("x.yaml:")


YAML = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8)),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.sampled_from([*Config.__struct_fields__, "x", "y", "speed"]), inner),
    ),
    max_leaves=8,
)


@pytest.mark.slow
@given(st.dictionaries(st.sampled_from(sorted(Config.__struct_fields__)), YAML))
def test_values_of_any_kind_are_a_configuration_or_an_error_of_ours(data):
    problem = None
    try:
        parse_config(json.dumps(data), Path("x.yaml"))  # JSON is YAML
    except ConfigError as error:
        problem = str(error)
    assert problem is None or all(line.startswith("x.yaml:") for line in problem.splitlines())
