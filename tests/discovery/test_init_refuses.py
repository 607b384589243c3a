"""`imucald init` writes nothing where it would destroy work, or where nothing was looked at."""

from __future__ import annotations

from pathlib import Path

import pytest

from imucald import cli
from paths import ROOT

EXAMPLE = str(ROOT / "dbc" / "imucald_example.dbc")
FOREIGN = "".join(f"({1000 + i / 100:.6f}) can0 7E8#0102030405060708\n" for i in range(300))
"""An identifier that the example database does not have."""
SPEED_ALONE = """VERSION ""
BU_: ESC
BO_ 416 ESC_Speed: 8 ESC
 SG_ VehicleSpeed : 0|16@1+ (0.01,0) [0|655.35] "km/h" ESC
"""


def test_a_file_that_was_edited_is_kept_unless_forced(tmp_path: Path, capsys):
    out = tmp_path / "car.yaml"
    out.write_text("# edited by hand\n")
    assert cli.main(["init", "--database", EXAMPLE, "--out", str(out)]) == 1
    text = capsys.readouterr().err
    assert f"{out}: exists" in text
    assert "--force" in text
    assert out.read_text() == "# edited by hand\n"
    assert cli.main(["init", "--database", EXAMPLE, "--out", str(out), "--force"]) == 0
    assert "edited by hand" not in out.read_text()
    assert "signals:" in out.read_text()


@pytest.mark.parametrize(
    ("log", "reason", "remedy"),
    [
        ("", "holds no CAN frame", "give a log of this bus"),
        (FOREIGN, "the 300 frames contain no message of this database", "leave --database out"),
    ],
)
def test_what_shows_nothing_is_an_error_and_no_file(log, reason, remedy, tmp_path, capsys):
    path, out = tmp_path / "drive.log", tmp_path / "car.yaml"
    path.write_text(log)
    assert cli.main(["init", "--database", EXAMPLE, str(path), "--out", str(out)]) == 1
    text = capsys.readouterr().err
    assert reason in text
    assert remedy in text
    assert not out.exists()


def test_a_bus_without_a_frame_is_an_error(capsys):
    silent = ["--interface", "virtual", "--channel", "silent", "--seconds", "0.1"]
    assert cli.main(["init", "--database", EXAMPLE, *silent]) == 1
    assert "silent: no frame came in 0.1 s" in capsys.readouterr().err


def test_a_proposal_without_an_accelerometer_asks_for_it(tmp_path, capsys):
    path, out = tmp_path / "car.dbc", tmp_path / "car.yaml"
    path.write_text(SPEED_ALONE)
    assert cli.main(["init", "--database", str(path), "--out", str(out)]) == 0
    assert "no accelerometer was found" in capsys.readouterr().err


def test_where_no_signal_is_recognised_nothing_is_written(tmp_path, capsys):
    """A configuration without one signal is one that no command takes."""
    log, out = tmp_path / "counting.log", tmp_path / "car.yaml"
    lines = (f"({0.1 * k:.6f}) can0 123#{k % 256:02X}" for k in range(600))
    log.write_text("\n".join(lines) + "\n")
    assert cli.main(["init", str(log), "--out", str(out)]) == 1
    printed = capsys.readouterr().err
    assert "no signal could be recognised" in printed
    assert "--database" in printed
    assert not out.exists()
