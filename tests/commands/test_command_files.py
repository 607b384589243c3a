"""What commands do about files that are missing, cannot be written, or would be destroyed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from imucald import cli
from imucald.can.logs.log_reader import LogReader
from imucald.can.python_can import can
from imucald.core import compiled
from paths import ROOT

START = str(ROOT / "config" / "imucald.yaml")
DATABASE = str(ROOT / "dbc" / "imucald_example.dbc")


HEARS_CTRL_C = """
import signal, sys
from imucald import cli
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(cli.main())
"""
"""A shell ignores the signal in what it runs in the background, and children inherit that."""


@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    log = tmp_path_factory.mktemp("files") / "drive.log"
    assert cli.main(["simulate", "--minutes", "0.2", "--out", str(log)]) == 0
    return log.read_bytes()


@pytest.fixture
def log(simulated: bytes, tmp_path: Path) -> Path:
    path = tmp_path / "drive.log"
    path.write_bytes(simulated)
    return path


@pytest.fixture
def run_main(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(compiled, "slow_words", str)  # a machine without a C compiler says so

    def run_main(*arguments: object) -> tuple[int, str]:
        status = cli.main([str(a) for a in arguments])
        return status, capsys.readouterr().err

    return run_main


def replay(log: object, *more: object) -> tuple[object, ...]:
    return ("replay", "--config", START, log, *more)


@pytest.mark.parametrize("option", ["--out", "--json"])
@pytest.mark.parametrize("target", ["nowhere/x", "."])
def test_a_file_that_cannot_be_written_is_reported_before_the_work(
    run_main, log, tmp_path, option, target
):
    status, text = run_main(*replay(log, option, tmp_path / target))
    assert status == 1
    assert text.count("\n") == 1
    assert "cannot be written" in text


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_a_full_disk_is_one_line(run_main, log):
    status, text = run_main(*replay(log, "--json", "/dev/full"))
    assert status == 1
    assert text == "imucald: /dev/full: cannot be written: No space left on device\n"


@pytest.mark.parametrize("option", ["--out", "--json"])
def test_the_log_itself_is_never_overwritten(run_main, log, simulated, tmp_path, option):
    link = tmp_path / "same.log"
    link.hardlink_to(log)
    for name in (log, tmp_path / "." / log.name, link):
        status, text = run_main(*replay(log, option, name))
        assert status == 1
        assert "would overwrite" in text
        assert log.read_bytes() == simulated


def test_nor_one_output_by_the_other(run_main, log, tmp_path):
    same = tmp_path / "same"
    assert run_main(*replay(log, "--out", same, "--json", same))[0] == 1
    assert run_main(*replay(log, "--out", "-", "--json", "-"))[0] == 1
    assert not same.exists()


def test_a_second_log_that_is_missing_is_reported_before_the_first_is_read(run_main, log, tmp_path):
    out = tmp_path / "out.log"
    status, text = run_main(*replay(log, tmp_path / "none.log", "--out", out))
    assert status == 1
    assert "none.log: cannot be opened" in text
    assert not out.exists()


def test_an_output_cut_by_an_error_is_named(run_main, log, tmp_path):
    log.write_bytes(log.read_bytes() + b"no frame\n")
    out = tmp_path / "out.log"
    status, text = run_main(*replay(log, "--strict", "--out", out))
    assert status == 1
    assert f"{out} is not complete" in text


@pytest.mark.parametrize("content", [b"", b"\n\n", b"(1.000000) can0\n"])
def test_a_log_without_any_frame_is_an_error_with_a_result(run_main, tmp_path, content):
    log, result = tmp_path / "none.log", tmp_path / "result.json"
    log.write_bytes(content)
    status, text = run_main(*replay(log, "--json", result))
    assert status == 1
    assert f"{log}: holds no CAN frame" in text
    assert json.loads(result.read_text())["frames"]["read"] == 0


@pytest.mark.parametrize("content", [b"\0\xff binary \n" * 5, b"a,b,c\n1,2,3\n"])
def test_what_is_no_log_is_one_error_with_the_remedy(run_main, tmp_path, content):
    log = tmp_path / "none.log"
    log.write_bytes(content)
    status, text = run_main(*replay(log))
    assert status == 1
    assert f"{log}: the format of this log is not known" in text
    assert text.count("\n") == 1


def test_a_log_of_other_frames_is_reported_as_one(run_main, tmp_path):
    log = tmp_path / "other.log"
    log.write_text("(1600000000.000000) can0 7F0#00\n")
    status, text = run_main(*replay(log))
    assert status == 1
    assert "no usable frame of this configuration" in text


def test_of_several_logs_one_of_other_frames_fails_the_command_too(run_main, log, tmp_path):
    other = tmp_path / "other.log"
    other.write_text("(1600000000.000000) can0 7F0#00\n")
    status, text = run_main(*replay(log), str(other))
    assert status == 1
    assert f"{other}: the log has no usable frame of this configuration" in text


@pytest.mark.parametrize("speed", ["0", "-1", "nan", "inf"])
def test_a_speed_that_is_none_is_refused(run_main, log, speed):
    status, text = run_main(*replay(log, "--speed", speed, "--interface", "virtual"))
    assert status == 1
    assert "--speed must be positive" in text


def test_with_speed_the_frames_go_out_on_the_bus_at_that_pace(run_main, log, tmp_path):
    out = tmp_path / "out.log"
    bus = ("--interface", "virtual", "--channel", "paced")
    with can.Bus(interface="virtual", channel="paced") as listener:
        began = time.monotonic()
        assert run_main(*replay(log, "--speed", "20", *bus, "--out", out, "--quiet")) == (0, "")
        assert time.monotonic() - began > 12.0 / 20.0 * 0.9
        heard = []
        while (message := listener.recv(0.0)) is not None:
            heard.append((message.arbitration_id, bytes(message.data)))
    (written,) = LogReader([out])
    assert len(heard) > 1000
    assert heard == [
        (can_id, row[:length].tobytes())
        for can_id, row, length in zip(
            written.can_id.tolist(), written.data, written.length.tolist(), strict=True
        )
    ]


def test_a_bus_without_speed_is_refused_rather_than_ignored(run_main, log):
    status, text = run_main(*replay(log, "--interface", "virtual", "--channel", "x"))
    assert status == 1
    assert "--speed" in text


@pytest.mark.slow
def test_frames_on_standard_output_are_not_mixed_with_tables(log):
    done = subprocess.run(
        [sys.executable, "-m", "imucald", *map(str, replay(log, "--out", "-"))],
        capture_output=True,
        text=True,
        check=True,
    )
    lines = done.stdout.splitlines()
    assert len(lines) > 100
    assert all(line.startswith("(") for line in lines)


def test_run_reports_an_unwritable_result_before_it_opens_the_bus(run_main, tmp_path):
    bus = ("--interface", "virtual", "--channel", "files", "--seconds", "0.1")
    status, text = run_main(
        "run", "--config", START, *bus, "--json", tmp_path / "nowhere" / "x.json"
    )
    assert status == 1
    assert text.count("\n") == 1


UNSERVED = {
    "page": (("--report", "page"), ".[report]"),
    "table": (("--write", "drive.mf4"), ".[mf4]"),
    "bus": (("--speed", "1", "--interface", "nosuch", "--channel", "x"), "nosuch"),
}


@pytest.mark.parametrize("case", UNSERVED)
def test_an_option_that_cannot_be_served_is_refused_before_a_file_is_opened(
    run_main, log, tmp_path, monkeypatch, case
):
    monkeypatch.setattr("imucald.report.page.LIBRARIES", ("no_such_library",))
    monkeypatch.setitem(sys.modules, "asammdf", None)
    monkeypatch.chdir(tmp_path)
    options, reason = UNSERVED[case]
    kept = tmp_path / "kept.log"
    kept.write_text("of last week")
    for out in ("new.log", "kept.log"):
        status, text = run_main(*replay(log, *options, "--out", out, "--json", "new.json"))
        assert status == 1
        assert reason in text
        assert "not complete" not in text
    assert {path.name for path in tmp_path.iterdir()} == {"drive.log", "kept.log"}
    assert kept.read_text() == "of last week"


def test_the_readme_installs_what_its_replay_asks_for():
    text = (ROOT / "README.md").read_text()
    assert "--report page" in text
    assert text.index("pip install '.[report]'") < text.index("--report page")


def test_simulate_does_not_overwrite_what_it_reads(run_main, tmp_path):
    model = tmp_path / "model.yaml"
    log = tmp_path / "a.log"
    wrote = run_main("simulate", "--minutes", "0.05", "--out", log, "--write-model", model)
    assert wrote == (0, "")
    before = model.read_bytes()
    for wrong in (("--out", model), ("--out", log, "--write-model", model)):
        assert run_main("simulate", "--minutes", "0.05", "--model", model, *wrong)[0] == 1
        assert model.read_bytes() == before


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_ctrl_c_says_that_the_output_is_cut(log, tmp_path):
    out = tmp_path / "out.log"
    paced = ("--speed", "0.5", "--interface", "virtual", "--channel", "ctrl-c", "--out", out)
    process = subprocess.Popen(
        [sys.executable, "-c", HEARS_CTRL_C, *map(str, replay(log, *paced))],
        stderr=subprocess.PIPE,
        text=True,
    )
    end = time.monotonic() + 30.0
    while not out.exists() and time.monotonic() < end:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    text = process.communicate(timeout=30.0)[1]
    assert process.returncode == 130
    assert text.endswith(f"imucald: {out} is not complete\nimucald: interrupted\n")


def test_zero_seconds_are_none_not_for_ever(run_main):
    bus = ("--interface", "virtual", "--channel", "zero")
    began = time.monotonic()
    assert run_main("run", "--config", START, *bus, "--seconds", "0.01")[0] == 0
    assert time.monotonic() - began < 5.0


@pytest.mark.parametrize("name", ["a.log", "a.asc"])
def test_bytes_that_are_no_text_are_shown_as_bytes_and_named_so(run_main, tmp_path, name):
    path = tmp_path / name
    path.write_bytes(b"\xb6K7\xd4\x9b'" * 500)
    status, text = run_main(*replay(path))
    assert status == 1
    assert "\\\\" not in text
    assert "codec" not in text
    assert ("holds no CAN frame" if name == "a.asc" else r"begins with '\xb6K7\xd4\x9b") in text


@pytest.mark.parametrize("command", ["replay", "check", "init"])
def test_a_folder_in_place_of_a_log_is_reported_as_one(run_main, tmp_path, command):
    """`replay` takes a folder for the logs in it; here there is none."""
    given = ("init", "--database", DATABASE) if command == "init" else (command, "--config", START)
    status, text = run_main(*given, tmp_path)
    assert status == 1
    assert text in (
        f"imucald: {tmp_path}: this is a folder; name one of its logs\n",
        f"imucald: there is no log at {tmp_path}\n",
    )


def test_each_mistake_of_a_configuration_is_a_line_of_imucald(run_main, log, tmp_path):
    wrong = tmp_path / "wrong.yaml"
    axes = "[IMU_Accel.AccelX, IMU_Accel.AccelY]"
    wrong.write_text(f"database: {DATABASE}\nsignals:\n  accelerometer: {axes}\n")
    status, text = run_main("check", "--config", wrong, log)
    assert status == 1
    lines = text.splitlines()
    assert len(lines) == 2
    for line in lines:
        assert line.startswith(f"imucald: {wrong}:3: signals.accelerometer[")
        assert "must be a mapping, got a text; its keys: x, y, z, source_address" in line
        assert "(here: 'IMU_Accel.Accel" in line


def test_a_table_that_cannot_be_written_says_why_in_the_systems_words(run_main, log):
    pytest.importorskip("pyarrow")
    status, text = run_main(*replay(log, "--write", "/proc/x.parquet"))  # not even root can
    assert status == 1
    start = "imucald: /proc/x.parquet: cannot be written: "
    assert text in (f"{start}No such file or directory\n", f"{start}Permission denied\n")
