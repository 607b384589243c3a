"""What names from outside do to a screen, and limits of the process: nothing, and one line."""

from __future__ import annotations

import io
import json
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from imucald import cli
from imucald.commands.check_view import print_report
from imucald.commands.terminal import screen_console
from imucald.core.text import SafeStream, made_safe
from imucald.service.journal import Journal
from paths import ROOT

EVIL = "a\x1b]0;owned\x07\x1b[2J\x9b31m\u202egol.exe\x7f"
EXAMPLE = ROOT / "config" / "examples" / "passenger_car.yaml"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def is_safe(text: str) -> bool:
    return all(c.isprintable() or c in "\n\t" for c in text)


def test_a_file_with_escapes_in_its_name_shows_them_as_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = tmp_path / f"{EVIL}.log"
    bad.write_text("no log\n")
    out, err = Terminal(), io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setattr(sys, "stderr", err)
    assert cli.main(["check", "--config", str(EXAMPLE), str(bad)]) == 1
    assert "\\u001b]0;owned\\u0007" in err.getvalue()
    assert is_safe(out.getvalue() + err.getvalue())
    assert (sys.stdout, sys.stderr) == (out, err), "the streams are put back"


def test_an_unknown_key_with_escapes_shows_them_as_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "car.yaml"
    path.write_text('"\\e[2Jkey": 1\n')
    err = io.StringIO()
    monkeypatch.setattr(sys, "stderr", err)
    log = tmp_path / "a.log"
    log.write_text("(1600000000.000000) can0 123#0011\n")
    assert cli.main(["check", "--config", str(path), str(log)]) == 1
    assert "u001b[2Jkey" in err.getvalue()
    assert is_safe(err.getvalue())


def test_a_table_keeps_our_colours_and_shows_escapes_of_names(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from rich.table import Table
    from rich.text import Text

    out = Terminal()
    monkeypatch.setattr(sys, "stdout", SafeStream(out))
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    table = Table("name", "value")
    table.add_row(EVIL, Text("1", style="bold red"))
    screen_console(markup=False, highlight=False, width=120).print(table)
    shown = out.getvalue()
    assert "\x1b[1;31m1" in shown
    assert "\x1b[2J" not in shown
    assert "\x1b]0" not in shown
    assert not set("\x07\x9b\u202e\x7f") & set(shown)
    lines = [line for line in Text.from_ansi(shown).plain.splitlines() if line.strip()]
    assert len({len(line) for line in lines}) == 1, "the columns stand below each other"


DAMAGED = "IMU\nAc\tcel\x85\u202e.A\rx"


def test_check_prints_a_broken_name_from_a_database_on_its_own_line(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    report = {
        "frames": {"read": 1, "used": 1, "other_frames": 0, "other_ids": 0},
        "duration_s": 1.0,
        "messages": [{
            "name": DAMAGED, "id": "0x200", "channel": None, "frames": 1, "cycle_s": None,
            "stated_cycle_s": None, "lost_share": None, "rejected": {},
        }],
        "quantities": [{
            "quantity": "accelerometer.x", "preference": 0, "source": DAMAGED, "unit": "m/s\n^2",
            "si_unit": "m/s^2", "factor": 9.8, "samples": 1, "rejected": {},
            "in_unit": {"min": 1.0, "mean": 1.0, "max": 1.0},
            "in_si": {"min": 9.8, "mean": 9.8, "max": 9.8},
        }],
        "findings": [{"level": "note", "quantity": DAMAGED, "text": "no frame came"}],
        "output": [], "usable": True, "warnings": 0, "used_for_mount_s": 1.0,
    }  # fmt: skip
    out = io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    monkeypatch.setenv("COLUMNS", "200")  # a narrow screen breaks names anywhere
    print_report(report)
    shown = r"IMU\u000aAc\u0009cel\u0085\u202e.A\u000dx"
    assert [line.count(shown) for line in out.getvalue().splitlines() if "IMU" in line] == [1] * 3
    assert r"m/s\u000a^2 = m/s^2" in out.getvalue()
    assert is_safe(out.getvalue())


def test_json_to_a_pipe_keeps_its_bytes_and_its_meaning() -> None:
    behind = io.StringIO()
    stream = SafeStream(behind)
    content = {"name": EVIL, "unit": "m/s²", "line": "a\r\nb\tc"}
    text = json.dumps(content, ensure_ascii=False)
    stream.write(text)
    stream.write("1,2\r\n")
    assert behind.getvalue() == text + "1,2\r\n"
    on_screen = made_safe(text)
    assert json.loads(on_screen) == content
    assert is_safe(on_screen)


def test_a_name_that_is_not_utf8_can_be_written_to_any_stream() -> None:
    behind = io.TextIOWrapper(io.BytesIO(), encoding="utf-8")
    stream = SafeStream(behind)
    print("a\udcff.log", file=stream, flush=True)
    assert behind.buffer.getvalue() == b"a\\udcff.log\n"  # type: ignore[attr-defined]


def test_a_line_of_the_journal_holds_no_control_characters() -> None:
    out = io.StringIO()
    Journal(out, {}).say(f"the configuration {EVIL} is in force")
    assert is_safe(out.getvalue())
    assert "\\u001b[2J" in out.getvalue()


def test_a_limit_of_memory_is_one_line(tmp_path: Path) -> None:
    log = tmp_path / "a.log"
    log.write_text("(1600000000.000000) can0 123#0011\n")
    done = subprocess.run(
        [sys.executable, "-m", "imucald", "check", "--config", str(EXAMPLE), str(log)],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (100 << 20, 100 << 20)),
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert "memory" in done.stderr.lower()
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(12, "Cannot allocate memory"),
        OSError(24, "Too many open files", "x.py"),
        ImportError("libx.so: failed to map segment from shared object"),
        SystemError("error return without exception set"),
    ],
)
def test_a_limit_that_is_reached_anywhere_is_one_line(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: object) -> int:
        raise error

    monkeypatch.setattr(cli, "_done", fail)
    assert cli.main(["schema"]) == 1
    text = capsys.readouterr().err
    assert text.count("\n") == 1
    assert "raise" in text


def test_ctrl_c_while_the_command_is_loaded_is_one_line() -> None:
    made = (
        "import sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'imucald.cli': raise KeyboardInterrupt\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from imucald.__main__ import main\n"
        "sys.exit(main())\n"
    )
    done = subprocess.run([sys.executable, "-c", made], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "imucald: interrupted\n")
