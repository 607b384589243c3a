"""The documentation says what the code does: keys, defaults, frames, commands, examples."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import jsonschema
import msgspec
import pytest
import yaml

from imucald import cli
from imucald.config import Config, json_schema, load_config, parse_config
from imucald.config.base import Settings
from imucald.config_check import Check
from imucald.core.errors import ConfigError
from imucald.core.samples import GRAVITY
from imucald.core.typed import Document, typed
from imucald.core.yaml_lines import read_yaml
from imucald.fleet.fleet_file import FleetSettings
from imucald.inputs.wiring import compile_router
from imucald.mount.estimate import MountState
from imucald.runtime.estimators import joint_settings
from imucald.runtime.output.output_frames import OutputFrames, output_database
from imucald.runtime.session import make_engine
from imucald.runtime.summary import RunCounts, summary

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]


def blocks(page: Path, language: str) -> list[str]:
    """Code blocks of a page, without the indentation of a list that they stand in."""
    found = re.findall(rf"^( *)```{language}\n(.*?)^\1```", page.read_text(), re.M | re.S)
    return [re.sub(rf"^{indent}", "", text, flags=re.M) for indent, text in found]


def tables(page: Path) -> dict[str, dict[str, tuple[str, ...]]]:
    """Rows by heading and first cell (without its backticks)."""
    found: dict[str, dict[str, tuple[str, ...]]] = {}
    heading = ""
    for line in page.read_text().splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ").strip()
        elif line.startswith("| `"):
            first, *rest = (cell.strip() for cell in line.strip("|").split(" | "))
            found.setdefault(heading, {})[first.strip("` ")] = tuple(rest)
    return found


# configuration ---------------------------------------------------------------------------------

SECTIONS = {
    "Uds": "diagnostics",
    "MotionCompensation": "compensation",
    "Config": "Top level",
    "Triad": "axes",
    "Source": "source",
    "RawSource": "raw",
    "ParallelSensor": "parallel",
    "MessageProtection": "messages",
    "KnownMount": "mount",
    "ModelFile": "model",
    "OutputIds": "ids",
    "SecurityAccess": "security",
    "StateLimits": "states",
    "StaticTest": "static",
    "StraightMotion": "straight",
    "TargetAngle": "target_angle",
    "MethodA": "method_a",
    "Alternative": "alternative",
    "Step": "steps",
    "TravelDirection": "travel_direction",
    "ValidWhen": "valid_when",
    "Wheels": "wheel_speeds",
}
"""Where a heading is not the name of its settings."""


def heading_of(settings: type[Settings]) -> str:
    name = settings.__name__.removesuffix("Settings")
    return SECTIONS.get(name, name.lower())


def settings_in(kind: type[Settings]) -> Iterator[type[Settings]]:
    yield kind
    for field in msgspec.structs.fields(kind):
        for part in parts(field.type):
            yield from settings_in(part)


def parts(annotation: Any) -> Iterator[type[Settings]]:
    if isinstance(annotation, type) and issubclass(annotation, Settings):
        yield annotation
    for argument in get_args(annotation):
        yield from parts(argument)


ALL_SETTINGS = sorted(set(settings_in(Config)), key=lambda m: m.__name__)


@pytest.mark.parametrize("kind", ALL_SETTINGS, ids=lambda m: m.__name__)
def test_every_key_is_documented_with_its_default(kind: type[Settings]) -> None:
    heading = heading_of(kind)
    rows = tables(DOCS / "configuration.md")[heading]
    fields = msgspec.structs.fields(kind)
    assert list(rows) == [field.name for field in fields], "the same keys in the same order"
    for field in fields:
        name = field.name
        stated = rows[name][0].strip("`")
        if field.required:
            assert stated == "required", name
        elif isinstance(field.default, Settings):
            assert stated == "defaults", name
        elif field.default not in (None, (), msgspec.NODEFAULT):
            value = yaml.safe_load(stated)
            default = list(field.default) if isinstance(field.default, tuple) else field.default
            assert value == default, name
        else:
            assert stated in ("none", "{}") or stated.startswith(("the database", "as the", "estim",
                                                              "all its")), name  # fmt: skip


def test_there_is_no_key_that_does_not_exist() -> None:
    headings = {heading_of(m) for m in ALL_SETTINGS}
    assert set(tables(DOCS / "configuration.md")) == headings


def test_the_schema_carries_descriptions() -> None:
    schema = json.loads(json_schema())
    source = schema["definitions"]["SourceSettings"]["properties"]
    assert "unit in the database" in source["unit"]["description"]


def test_editors_find_no_fault_in_what_is_right_and_faults_in_what_is_not() -> None:
    """With the exported schema and an independent validator."""
    jsonschema.Draft7Validator.check_schema(json.loads(json_schema()))
    schema = jsonschema.Draft7Validator(json.loads(json_schema()))
    for path in CONFIGURATIONS:
        assert [e.message for e in schema.iter_errors(yaml.safe_load(path.read_text()))] == [], path
    for page in PAGES:
        for text in blocks(page, "yaml"):
            data = yaml.safe_load(text)
            if "signals" in data:
                assert schema.is_valid(data), page
    axes = "{x: A.X, y: A.Y, z: A.Z}"
    right = f"database: a.dbc\nsignals:\n  accelerometer: {axes}\n  speed: S.V\n"
    assert schema.is_valid(yaml.safe_load(right))
    for old, new in (
        ("a.dbc", "[]"), ("a.dbc", "7"), ("S.V", "[]"), ("S.V", "V"), ("S.V", "{unit: g, sign: 3}"),
        ("speed:", "sped:"), (axes, "{x: A.X}"), (axes, "[]"),
    ):  # fmt: skip
        assert not schema.is_valid(yaml.safe_load(right.replace(old, new))), new


def test_the_readme_leads_to_every_page_and_every_link_to_something() -> None:
    assert set(PAGES) - links(ROOT / "README.md") == {ROOT / "README.md"}
    for page in PAGES:
        assert [target for target in links(page) if not target.exists()] == [], page


def links(page: Path) -> set[Path]:
    """Files here that a page has links to."""
    found = re.findall(r"\]\(([\w./-]+)(?:#[\w-]*)?\)", page.read_text())
    return {page.parent / target for target in found}


EXAMPLES = ROOT / "config/examples"
CONFIGURATIONS = [ROOT / "config/imucald.yaml", *sorted(EXAMPLES.glob("*.yaml"))]


@pytest.mark.parametrize("path", CONFIGURATIONS, ids=lambda p: p.name)
def test_shipped_configurations_work(path: Path) -> None:
    loaded = load_config(path)
    for entry in loaded.config.database:
        if not loaded.database_path(entry).exists():
            pytest.skip(f"{entry.path} is not here")
    engine = make_engine(loaded)
    signals = yaml.safe_load(path.read_text())["signals"]
    channels = {"accel": "accelerometer", "gyro": "gyroscope", "mag": "magnetometer"}
    assert ("speed" in engine.router.channels) == bool({"speed", "wheel_speeds"} & set(signals))
    for channel, name in {**channels, "steering": "steering_wheel_angle"}.items():
        assert (channel in engine.router.channels) == (name in signals), name
    assert list(engine.output.triads[:3]) == [c for c, name in channels.items() if name in signals]
    assert engine.router.matches


def test_the_packaged_example_is_the_one_in_the_examples() -> None:
    ours = yaml.safe_load((ROOT / "daemon/imucald/data/imucald_example.yaml").read_text())
    example = yaml.safe_load((EXAMPLES / "passenger_car.yaml").read_text())
    assert ours.pop("database") == Path(example.pop("database")).name
    assert ours == example


def test_the_readme_configuration_works_on_the_example_bus() -> None:
    (text,) = blocks(ROOT / "README.md", "yaml")
    assert len(text.splitlines()) <= 16
    database = ROOT / "dbc" / "imucald_example.dbc"
    make_engine(parse_config(text.replace("car.dbc", str(database)), ROOT / "car.yaml"))


def test_configurations_in_the_documentation_are_valid() -> None:
    for page in PAGES:
        for text in blocks(page, "yaml"):
            if text.startswith("# fleet.yaml"):
                data, marks = read_yaml(text, page.name)
                assert typed(data, FleetSettings, Document(page.name, marks, "fleet file")).logs
                continue
            loaded = parse_config(text, page)
            with pytest.raises(ConfigError, match=r"car\.dbc"):  # which nobody has
                compile_router(loaded)


# output frames ---------------------------------------------------------------------------------


def test_the_frame_table_is_that_of_the_database() -> None:
    database = output_database()
    text = (DOCS / "output-frames.md").read_text()
    rows = re.findall(r"^\| `0x(\w+)` \| `(\w+)` \| .*? \| (.*) \|$", text, re.M)
    assert {name for _, name, _ in rows} == set(database.messages)
    for number, name, signals in rows:
        message = database.message(name)
        assert message.can_id == int(number, 16)
        for signal, start, stop in re.findall(r"`(\w+)` (\d+)\.\.(\d+)", signals):
            found = message.signal(signal)
            assert (found.start, found.start + found.length - 1) == (int(start), int(stop))
        for step, unit in re.findall(r"signed, ([\d.]+) (\S+?)$", signals):
            first = next(iter(message.signals.values()))
            assert float(step) == first.scale
            assert unit.replace("²", "^2") == first.unit
        assert message.signal("Counter").start == 52
        assert message.signal("Checksum").start == 56
    flags = re.search(r"flags (\d+)\.\.(\d+)", text)
    assert flags
    health = database.message("IMUCALD_Health")
    ones = [s.start for s in health.signals.values() if s.length == 1]
    assert (min(ones), max(ones)) == (int(flags[1]), int(flags[2]))
    for name in health.signals:
        assert f"`{name}`" in text or name in ("Counter", "Checksum")


def test_value_tables_are_those_of_the_database() -> None:
    text = (DOCS / "output-frames.md").read_text()
    tables_in_doc = re.findall(r"\| (Quality|State) \| name.*?\n\|[-|]+\n((?:\|.*\n)+)", text)
    database = output_database()
    quality = database.message("IMUCALD_Acceleration").signal("Quality").choices
    state = database.message("IMUCALD_Mount").signal("State").choices
    assert dict(state) == {int(s): s.name.lower() for s in MountState}
    for heading, body in tables_in_doc:
        rows = {int(n): name for n, name in re.findall(r"\| (\d) \| `(\w+)`", body)}
        assert rows == dict(quality if heading == "Quality" else state)
    assert len(tables_in_doc) == 2


def test_the_limits_of_usable_and_fine_are_those_of_the_default_estimator() -> None:
    text = (DOCS / "output-frames.md").read_text()
    config = load_config(ROOT / "config" / "imucald.yaml").config
    limits = joint_settings(config).limits
    assert config.calibration.estimator == "joint"
    for words, yaw_std, tilt_std in (
        ("cross-talk `XY`, `YX` {yaw} deg, level zero {zero} m/s²",
         limits.usable_yaw, limits.usable_tilt),
        ("deviations within {yaw} deg and {zero} m/s²", limits.fine_yaw, limits.fine_tilt),
    ):  # fmt: skip
        yaw, zero = round(math.degrees(yaw_std), 6), round(tilt_std * GRAVITY, 6)
        assert words.format(yaw=yaw, zero=zero) in text


def test_the_consumers_check_accepts_ours_and_refuses_damage() -> None:
    (code,) = blocks(DOCS / "output-frames.md", "python")
    scope: dict[str, Any] = {}
    exec(code, scope)
    value_of_x = scope["value_of_x"]
    output = OutputFrames(load_config(ROOT / "config" / "imucald.yaml").config)
    _, first = output.corrected("accel", (1.5, -0.25, 9.81), 2)
    _, second = output.corrected("accel", (-3.0, 0.0, 9.81), 3)
    _, missing = output.corrected("accel", None, 0)
    _, suspect = output.corrected("accel", (1.5, -0.25, 9.81), 4)
    assert value_of_x(suspect, None) is None
    assert value_of_x(first, None) == pytest.approx(1.5, abs=0.001)
    assert value_of_x(second, first[6] >> 4) == pytest.approx(-3.0, abs=0.001)
    assert value_of_x(second, second[6] >> 4) is None
    assert value_of_x(missing, None) is None
    for bit in range(64):
        damaged = bytearray(first)
        damaged[bit // 8] ^= 1 << bit % 8
        assert value_of_x(bytes(damaged), None) is None


# JSON ------------------------------------------------------------------------------------------


def test_the_json_keys_are_documented_and_in_the_example() -> None:
    engine = make_engine(load_config(ROOT / "config" / "imucald.yaml"))
    result = summary(engine, RunCounts(0, 0, {}), 0.0)
    (example,) = blocks(DOCS / "json.md", "json")
    shown = json.loads(example)
    assert list(shown) == list(result)
    assert list(shown["mount"]) == list(result["mount"])
    assert list(shown["frames"]) == list(result["frames"])
    text = (DOCS / "json.md").read_text()
    for key in Check(load_config(ROOT / "config" / "imucald.yaml")).report():
        assert f"| `{key}` |" in text


# commands and links ----------------------------------------------------------------------------


def test_commands_and_options_in_the_documentation_exist() -> None:
    (group,) = [a.choices for a in cli.build_parser()._subparsers._group_actions if a.choices]  # type: ignore[union-attr]
    parsers: dict[str, Any] = dict(group)  # type: ignore[call-overload]
    seen = set()
    for page in [*PAGES, ROOT / "config" / "imucald.yaml"]:
        for name, rest in re.findall(r"\bimucald (\w+)((?: [^\s`#]+)*)", page.read_text()):
            if name not in parsers:
                assert name not in ("check", "replay", "run", "simulate", "demo", "schema")
                continue
            seen.add(name)
            options = _options(parsers[name])
            for option in re.findall(r"--[a-z-]+", rest):
                assert option in options, f"{page.name}: imucald {name} {option}"
    assert seen >= {"check", "replay", "run", "simulate", "demo", "schema"}


def _options(parser: Any) -> set[str]:
    """Options of a command and of its actions."""
    found = {o for a in parser._actions for o in a.option_strings}
    inner = parser._subparsers._group_actions if parser._subparsers else []
    return found.union(*(_options(p) for group in inner for p in group.choices.values()))


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_named_files_exist(page: Path) -> None:
    for path in re.findall(
        r"`((?:benchmarks|config|dbc|deb|docs|\.ci)/[\w./-]*)`", page.read_text()
    ):
        assert (ROOT / path).exists() or (ROOT / "daemon" / "imucald" / path).exists(), path
