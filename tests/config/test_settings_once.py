"""Every setting stands once: in SI where it is read, and read by somebody outside `config`."""

from __future__ import annotations

import ast
import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import msgspec
import pytest
from msgspec import Struct

import imucald
from imucald.config import Config, parse_config
from imucald.config.base import Part, Radians

PACKAGE = Path(imucald.__file__).parent
MINIMAL = "database: a.dbc\nsignals: {accelerometer: {x: A.X, y: A.Y}}\n"
DEGREES = [
    ("calibration.straight.yaw_rate_limit_deg_s", "yaw_rate_limit"),
    ("calibration.straight.consistency_range_deg", "consistency_range"),
    ("calibration.states.fine_tilt_deg", "fine_tilt"),
    ("attitude.filter.gyro_noise_deg_s", "gyro_noise"),
    ("attitude.filter.declination_deg", "declination"),
    ("travel_direction.choice.tilt_on_turn_deg", "tilt_on_turn"),
    ("travel_direction.alternative.lead_deg", "lead"),
]


def section(config: Config, path: str) -> Struct:
    """The settings that a dotted key stands in."""
    found: Struct = config
    for part in path.split(".")[:-1]:
        found = getattr(found, part)
    return found


def written(path: str, value: float) -> Config:
    *parents, last = path.split(".")
    text = "".join(f"{'  ' * n}{part}:\n" for n, part in enumerate(parents))
    return parse_config(f"{MINIMAL}{text}{'  ' * len(parents)}{last}: {value}\n").config


@pytest.mark.parametrize(("path", "name"), DEGREES)
def test_degrees_of_the_file_are_read_in_radians(path: str, name: str) -> None:
    found = getattr(section(written(path, 9.0), path), name)
    per_axis = isinstance(found, tuple)
    assert found == pytest.approx((math.pi / 20.0,) * 3 if per_axis else math.pi / 20.0)


def test_a_number_per_axis_keeps_its_axis() -> None:
    text = MINIMAL + "attitude: {filter: {gyro_noise_deg_s: [9.0, 18.0, 36.0]}}\n"
    noise = parse_config(text).config.attitude.filter.gyro_noise
    assert noise == pytest.approx((math.pi / 20.0, math.pi / 10.0, math.pi / 5.0))


def test_percent_of_the_file_is_read_as_a_part() -> None:
    assert written("vehicle.crown_percent", 2.5).vehicle.crown_mean == pytest.approx(0.025)


def groups(kind: type[Struct] = Config) -> Iterator[type[Struct]]:
    """All classes of settings that a configuration is made of."""
    yield kind
    for field in msgspec.structs.fields(kind):
        for inner in (field.type, *getattr(field.type, "__args__", ())):
            if isinstance(inner, type) and issubclass(inner, Struct):
                yield from groups(inner)


def readable() -> Iterator[tuple[str, str]]:
    """Class and the name by which each key is read: in SI where the file has other units."""
    for kind in set(groups()):
        converted = {
            entry._key: name
            for name, entry in vars(kind).items()
            if isinstance(entry, Radians | Part)
        }
        for field in msgspec.structs.fields(kind):
            yield kind.__name__, converted.get(field.name, field.name)


@cache
def read_names() -> frozenset[str]:
    """Attribute names that the package reads, the definitions of settings left aside."""
    found: set[str] = set()
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Attribute):
                found.add(node.attr)
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.add(node.value)  # read by getattr
    return frozenset(found)


def test_every_unit_but_si_is_converted_in_config() -> None:
    people = ("_deg", "_deg_s", "_percent", "_ms", "_g")
    left = [entry for entry in readable() if entry[1].endswith(people)]
    assert not left


def test_every_setting_is_read() -> None:
    assert len(list(readable())) > 120
    assert not [entry for entry in readable() if entry[1] not in read_names()]


def test_a_default_that_another_key_gives_is_filled_in() -> None:
    text = "calibration: {speed_delay: 0.3, accelerometer_bias: 0.2}\n"
    attitude = parse_config(MINIMAL + text).config.attitude
    assert (attitude.compensation.delay, attitude.filter.accel_random) == (0.3, 0.2)
    own = "attitude: {compensation: {delay: 0.0}, filter: {accel_random: 0.1}}\n"
    attitude = parse_config(MINIMAL + text + own).config.attitude
    assert (attitude.compensation.delay, attitude.filter.accel_random) == (0.0, 0.1)
    assert parse_config(MINIMAL).config.attitude.compensation.delay == 0.0
