"""The command line: helps that read well, and damaged configurations reported by their line."""

from __future__ import annotations

import copy
import importlib
import json
import random
import re
import signal
import subprocess
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

import shuttle
from imucald import cli
from imucald.can.dbc.database import Database, load_database
from imucald.config import parse_config
from imucald.core.errors import ConfigError
from imucald.inputs import wiring
from imucald.runtime.session import make_engine
from paths import ROOT

START = ROOT / "config" / "imucald.yaml"
HELP_S = 3.0
"""A help takes 0.2 s on an idle machine; this is for a busy one."""


@pytest.mark.slow
@pytest.mark.parametrize("command", ["", *cli.COMMANDS])
def test_every_help_comes_quickly_and_fits_eighty_columns(command: str) -> None:
    arguments = [command] if command else []
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-m", "imucald", *arguments, "--help"],
        capture_output=True,
        text=True,
        check=True,
        env={"COLUMNS": "80", "PATH": ""},
    )
    assert time.monotonic() - began < HELP_S
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
    words = " ".join(done.stdout.split())
    assert cli.COMMANDS.get(command, "First step: imucald demo")[1:] in words


def test_every_option_has_a_help_text() -> None:
    subparsers = cli.build_parser()._subparsers
    assert subparsers is not None
    (choices,) = [a.choices for a in subparsers._group_actions if a.choices]
    for name, parser in dict(choices).items():  # type: ignore[call-overload]
        for action in parser._actions:
            assert action.help, f"{name}: {action.dest}"


def test_the_command_list_says_what_each_does(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(["--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    for name in ("run", "replay", "check", "simulate", "demo", "schema"):
        assert re.search(rf"^ +{name} ", text, re.MULTILINE)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("replaay", "did you mean 'replay'?"),
        ("", "usage: imucald"),
        ("replay --frob a.log --config b.yaml", "usage: imucald replay"),
        ("replay --conf b.yaml a.log", "--config"),
        ("fleet status --ou x", "--out"),
        ("run --config b.yaml --seconds -1", "must be a number above 0"),
        ("check --config b.yaml --seconds nan", "must be a number above 0"),
        ("init --interface can0 --seconds 0", "must be a number above 0"),
    ],
)
def test_wrong_usage_is_status_two_and_says_what_is_right(
    arguments: str, expected: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        status = cli.main(arguments.split())
    except SystemExit as stop:
        status = int(stop.code or 0)
    assert status == 2
    assert expected in capsys.readouterr().err


IN_A_DESCRIPTOR = """
class Field:
    def __set_name__(self, owner, name):
        signal.raise_signal(signal.SIGINT)
class Counters:
    field = Field()
"""
SWALLOWED = """
try:
    signal.raise_signal(signal.SIGINT)
except BaseException:
    pass
"""


@pytest.mark.parametrize("text", [IN_A_DESCRIPTOR, SWALLOWED, "signal.raise_signal(2)"])
@pytest.mark.parametrize("where", ["before the command", "in the command"])
def test_ctrl_c_while_modules_are_imported_interrupts(
    text: str,
    where: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "ctrl_c_here.py").write_text(f"import signal\n{text}\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "ctrl_c_here", raising=False)

    def run(_: object) -> int:
        importlib.import_module("ctrl_c_here")
        time.sleep(2.0)
        return 0

    def command(_: str) -> types.SimpleNamespace:
        if where == "before the command":
            run(None)
        return types.SimpleNamespace(add_arguments=lambda _: None, run=run)

    monkeypatch.setattr(cli, "_command", command)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert cli.main(["schema"]) == 130
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
    assert capsys.readouterr().err == "imucald: interrupted\n"


@pytest.mark.slow
def test_a_full_disk_and_a_reader_that_went_are_no_traceback(tmp_path: Path) -> None:
    schema = [sys.executable, "-m", "imucald", "schema"]
    with Path("/dev/full").open("w") as full:
        done = subprocess.run(schema, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (done.returncode, done.stderr) == (
        1,
        "imucald: the output cannot be written: No space left on device\n",
    )
    log = tmp_path / "drive.log"
    assert cli.main(["simulate", "--minutes", "1", "--out", str(log)]) == 0
    replay = [*schema[:-1], "replay", "--config", str(START), str(log), "--out", "-"]
    with subprocess.Popen(replay, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        assert running.stdout
        assert running.stderr
        running.stdout.readline()
        running.stdout.close()
        assert running.stderr.read() == b""
    assert running.returncode == 0


def test_a_shift_after_the_end_of_the_drive_is_refused(tmp_path, capsys):
    order = ["simulate", "--minutes", "1", "--out", str(tmp_path / "d.log"), "--shift"]
    assert cli.main([*order, "60,0,5,0"]) == 1
    assert "--shift at 60 s: the drive ends after 60 s" in capsys.readouterr().err
    assert not (tmp_path / "d.log").exists()
    assert cli.main([*order, "59,0,5,0"]) == 0
    late = "mount.shifts=[{t_s: 90, roll_deg: 0, pitch_deg: 5, yaw_deg: 0}]"
    assert cli.main([*order, "59,0,5,0", "--set", late]) == 0, "that is none of '--shift'"


def test_the_files_of_a_command_are_looked_at_before_its_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["demo", "--svg", str(tmp_path / "no" / "a.svg")]) == 1
    (tmp_path / "file").write_text("")
    bus = ["--interface", "virtual", "--channel", "x", "--seconds", "0.01"]
    state = ["--state-dir", str(tmp_path / "file")]
    assert cli.main(["run", "--config", str(START), *bus, *state]) == 1
    lines = capsys.readouterr()
    assert "no directory" in lines.err
    assert "name a folder" in lines.err
    assert lines.out == ""


def test_a_missing_file_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["check", "--config", "nowhere.yaml", "x.log"]) == 1
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert "nowhere.yaml" in text


@pytest.mark.slow
def test_output_that_knows_ascii_only_is_served(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    commands = [["simulate", "--minutes", "0.3", "--out", str(log)],
                ["check", "--config", str(START), str(log)],
                ["replay", "--config", str(START), str(log)]]  # fmt: skip
    for command in commands:
        done = subprocess.run(
            [sys.executable, "-m", "imucald", *command],
            capture_output=True,
            text=True,
            check=False,
            env={"PYTHONIOENCODING": "ascii", "PATH": ""},
        )
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr


# mistakes with their place ---------------------------------------------------------------------

BASE = f"""\
database: {ROOT / "dbc" / "imucald_example.dbc"}
vehicle:
  driving_side: right
signals:
  accelerometer:
    x: IMU_Accel.AccelX
    y: IMU_Accel.AccelY
    z: IMU_Accel.AccelZ
  gyroscope: {{x: IMU_Gyro.RateX, y: IMU_Gyro.RateY, z: IMU_Gyro.RateZ}}
  speed:
    - ESC_Speed.VehicleSpeed
    - raw: {{id: 0x7E8, when: "data[1] == 0x41", value: "data[3]"}}
      unit: km/h
  reverse: {{signal: TCU_Gear.GearPosition, equals: 1}}
messages:
  IMU_Accel:
    counter: {{signal: AccelCounter}}
    checksum: {{kind: crc8_j1850, signal: AccelChecksum, id_bytes: 2}}
output:
  ids: {{acceleration: 0x640}}
calibration:
  states: {{usable_yaw_deg: 1.0}}
"""
MISTAKES = [
    ("driving_side: right", "driving_side: rihgt", 3, "vehicle.driving_side", "'left'"),
    ("driving_side: right", "driving_seid: right", 3, "vehicle.driving_seid", "driving_side"),
    ("IMU_Accel.AccelY", "IMU_Accel.AccelV", 7, "accelerometer", "AccelX"),
    ("IMU_Accel.AccelY", "IMU_Acel.AccelY", 7, "accelerometer", "IMU_Accel"),
    ("    x: IMU_Accel.AccelX\n", "", 5, "accelerometer.x", "is missing"),
    ("unit: km/h", "unit: kg", 11, "speed[1]", "km/h"),
    ("data[3]", "data[99]", 12, "speed[1].raw", "data[99]"),
    ("data[3]", "open(1)", 12, "speed[1].raw", "not allowed"),
    ("signal: AccelCounter", "signal: Counter", 17, "messages.IMU_Accel", "AccelCounter"),
    ("id_bytes: 2", "id_bytes: 7", 18, "checksum.id_bytes", "4"),
    ("kind: crc8_j1850", "kind: crc9", 18, "checksum.kind", "crc8_j1850"),
    ("acceleration: 0x640", "acceleration: 0x200", 20, "output.ids", "0x200"),
    ("acceleration: 0x640", "acceleration: 0x641", 20, "output.ids", "same id"),
    ("ids: {acceleration: 0x640}", "checksum: crc16_ccitt", 20, "output.checksum", "crc8_j1850"),
    ("usable_yaw_deg: 1.0", "usable_yaw_deg: -1", 22, "states.usable_yaw_deg", "greater"),
    ("  reverse:", "reverse:", 14, "reverse", "unknown key"),
    ("vehicle:", "vehicle: [", 3, "YAML", ""),
    (
        "  IMU_Accel:\n    counter",
        "  IMU_Gyros:\n    counter",
        16,
        "messages.IMU_Gyros",
        "IMU_Gyro",
    ),
]


@pytest.mark.parametrize(("old", "new", "line", "key", "remedy"), MISTAKES)
def test_a_mistake_is_reported_by_file_line_key_and_remedy(
    old: str, new: str, line: int, key: str, remedy: str
) -> None:
    assert old in BASE
    with pytest.raises(ConfigError) as raised:
        make_engine(parse_config(BASE.replace(old, new, 1), Path("car.yaml")))
    text = str(raised.value)
    where = re.match(r"car\.yaml:(\d+): ", text)
    assert where, text
    assert abs(int(where[1]) - line) <= 1, text
    assert key in text
    assert remedy in text


def test_several_mistakes_are_reported_at_once() -> None:
    text = BASE.replace("right", "up").replace("1.0", "x")
    with pytest.raises(ConfigError) as raised:
        parse_config(text, Path("car.yaml"))
    assert len(str(raised.value).splitlines()) == 2


# damage ----------------------------------------------------------------------------------------

JUNK: list[Any] = [
    None, True, -1, 0, 1e308, -1e-308, 2**70, "", "x", "IMU_Accel.AccelX", "a.b", "data[0]", "∞",
    "\x7f", [], {}, [1, 2], {"x": 1}, {"signal": "IMU_Accel.AccelX"}, [[[]]], ".inf", "1_0", "0o7",
    "2020-01-01", "!!python/object:os.system", "y" * 300,
]  # fmt: skip


BASE_DATA = yaml.safe_load(BASE)


def places(data: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    if not isinstance(data, dict | list):
        return [at]
    pairs = data.items() if isinstance(data, dict) else enumerate(data)
    return [at, *(place for key, value in pairs for place in places(value, (*at, key)))]


def with_junk(rng: random.Random) -> str:
    data = copy.deepcopy(BASE_DATA)
    for _ in range(rng.choice((1, 1, 2, 4))):
        *parents, last = rng.choice(places(data)[1:])
        holder = data
        for key in parents:
            holder = holder[key]
        action = rng.random()
        if action < 0.6:
            holder[last] = rng.choice(JUNK)
        elif action < 0.8 or isinstance(holder, list):
            del holder[last]
        else:
            holder[str(rng.choice(JUNK))] = holder.pop(last)
    return yaml.safe_dump(data, allow_unicode=True)


def with_damaged_text(rng: random.Random) -> str:
    text = BASE
    for _ in range(rng.choice((1, 1, 2, 5, 20))):
        i = rng.randrange(len(text))
        action = rng.randrange(4)
        if action == 0:
            text = text[:i] + text[i + rng.choice((1, 2, 30)) :]
        elif action == 1:
            text = text[:i] + rng.choice("{}[]:,&*!|>#%@`'\"\n\t -0é\0\x85") + text[i:]
        elif action == 2:
            lines = text.split("\n")
            k = rng.randrange(len(lines))
            lines[k] = rng.choice(("", "  ", "    ")) + lines[k].strip()
            text = "\n".join(lines)
        else:
            text = text[:i] + text[rng.randrange(len(text)) :][:40] + text[i:]
        text = text or "x"
    return text


@pytest.mark.slow
@pytest.mark.parametrize("damage", [with_junk, with_damaged_text])
def test_damaged_configurations_give_an_error_with_place_or_work(
    damage: Callable[[random.Random], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thousand of each kind: nothing but ConfigError ever comes out, and it names the file."""
    known: dict[Path, Database] = {}

    def cached(path: Path) -> Database:
        if path not in known:
            known[path] = load_database(path)
        return known[path]

    monkeypatch.setattr(wiring, "load_database", cached)
    rng = random.Random(7)
    outcomes = {"error": 0, "works": 0}
    for _ in range(1000):
        text = damage(rng)
        problem = ""
        try:
            make_engine(parse_config(text, Path("car.yaml")))
        except ConfigError as error:
            problem = str(error)
        assert not problem or re.match(r"car\.yaml:\d+: \S", problem), (text, problem)
        outcomes["error" if problem else "works"] += 1
    assert outcomes["error"] > 300
    assert outcomes["works"] > 30


@pytest.mark.slow
@pytest.mark.parametrize("command", ["replay", "check"])
def test_a_reader_that_has_had_enough_is_no_error(command: str, tmp_path: Path) -> None:
    config = shuttle.write(tmp_path, cycles=1)
    work = [sys.executable, "-m", "imucald", command, str(tmp_path / "shuttle.log")]
    with subprocess.Popen(
        [*work, "--config", str(config)], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        process.stdout.close()
        assert process.wait(60) == 0
        assert process.stderr is not None
        assert b"Traceback" not in process.stderr.read()


def test_the_schema_lists_every_kind_of_checksum(capsys):
    assert cli.main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    kinds = schema["definitions"]["ChecksumSettings"]["properties"]["kind"]["enum"]
    profiles = ["e2e_p1", "e2e_p2", "e2e_p5", "e2e_p11"]
    assert kinds == ["none", "xor", "crc8_j1850", "crc16_ccitt", *profiles]
    own = schema["definitions"]["Output"]["properties"]["checksum"]["enum"]
    assert own == ["none", "xor", "crc8_j1850"]


def test_a_service_whose_program_systemd_hides_is_refused_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    order = ["install-service", "--prefix", str(tmp_path / "usr"), "--exec"]
    for hidden in ("/home/u/venv/bin/imucald", "/root/bin/imucald run", "/tmp/v/imucald"):
        assert cli.main([*order, hidden]) == 1
        error = capsys.readouterr().err
        assert "Nothing was written" in error
        assert "sudo /opt/imucald/bin/imucald install-service" in error
    assert not list(tmp_path.iterdir())


def test_an_image_gets_no_service_whose_program_systemd_would_hide(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", "/tmp/v/bin/python")
    order = ["install-service", "--root", str(tmp_path)]
    for hidden in ([], ["--exec", "/home/u/imucald"]):
        assert cli.main([*order, *hidden]) == 1
        assert "--exec /opt/imucald/bin/imucald" in capsys.readouterr().err
        assert not list(tmp_path.iterdir())
    assert cli.main([*order, "--exec", "/opt/imucald/bin/imucald"]) == 0
    (unit,) = tmp_path.rglob("imucald@.service")
    assert "  /opt/imucald/bin/imucald run " in unit.read_text()


def test_the_next_steps_of_an_installation_load_every_file_that_it_wrote(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    order = ["install-service", "--exec", "/usr/bin/imucald", "--root", str(tmp_path)]
    assert cli.main(order) == 0
    said = capsys.readouterr().out
    for step in ("sysctl --system", "udevadm control --reload", "systemctl daemon-reload"):
        assert step in said


@pytest.mark.parametrize("command", [" ", "a 'b"])
def test_a_service_whose_command_is_none_is_refused(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["install-service", "--exec", command]) == 1
    assert "--exec" in capsys.readouterr().err


def test_set_mount_says_why_status_shows_a_larger_deviation_than_the_stated_one(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit):
        cli.main(["set-mount", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert "larger than --within, because it adds the effect of load and springs" in said


@pytest.mark.parametrize("command", ["check", "replay", "diagnose", "walk", "status", "wait"])
def test_quiet_has_the_same_two_names_in_every_command(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    assert "--quiet, -q" in capsys.readouterr().out
