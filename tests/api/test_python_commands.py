"""`check`, `walk`, `diagnose` and the pictures from Python; the commands that are made of them."""

from __future__ import annotations

import gzip
import importlib
import io
import json
import pickle
import struct
from pathlib import Path

import numpy as np
import pytest
from replayed_drive import config, drive, log

import imucald
from gait import CARRYINGS
from gait import walk as walked
from imucald import cli
from imucald.api import diagnosing
from paths import ROOT
from simulated_bus import CONFIG

WALK_DBC = """VERSION ""
NS_ :
BS_:
BU_: X
BO_ 512 A: 8 X
 SG_ X : 0|16@1- (0.001,0) [-32|32] "m/s^2" X
 SG_ Y : 16|16@1- (0.001,0) [-32|32] "m/s^2" X
 SG_ Z : 32|16@1- (0.001,0) [-32|32] "m/s^2" X
BO_ 513 G: 8 X
 SG_ X : 0|16@1- (0.001,0) [-32|32] "rad/s" X
 SG_ Y : 16|16@1- (0.001,0) [-32|32] "rad/s" X
 SG_ Z : 32|16@1- (0.001,0) [-32|32] "rad/s" X
BO_ 514 M: 8 X
 SG_ X : 0|16@1- (0.01,0) [-327|327] "uT" X
 SG_ Y : 16|16@1- (0.01,0) [-327|327] "uT" X
 SG_ Z : 32|16@1- (0.01,0) [-327|327] "uT" X
"""
WALK_CONFIG = """
database: walk.dbc
signals:
  accelerometer: {x: A.X, y: A.Y, z: A.Z}
  gyroscope: {x: G.X, y: G.Y, z: G.Z}
  magnetometer: {x: M.X, y: M.Y, z: M.Z}
"""


def printed(capsys, *arguments: object) -> str:
    capsys.readouterr()
    assert cli.main([str(a) for a in arguments]) in (0, 1)
    return capsys.readouterr().out


# check -------------------------------------------------------------------------------------


def test_a_check_is_that_of_the_command_line(capsys):
    found = imucald.check(config(), log())
    assert (
        json.loads(printed(capsys, "check", "--json", "--config", CONFIG, log())) == found.to_dict()
    )
    assert found.usable
    assert pickle.loads(pickle.dumps(found)).to_dict() == found.to_dict()
    assert len(repr(found).splitlines()) <= 5
    assert {finding["level"] for finding in found.findings} <= {"error", "warning", "note", "ok"}


def test_a_check_of_another_bus_finds_errors(tmp_path):
    other = tmp_path / "other.log"
    other.write_text("".join(f"({1.6e9 + i / 10:.6f}) can0 7F0#00\n" for i in range(50)))
    found = imucald.check(config(), other)
    assert not found.usable
    assert found.findings[0]["level"] == "error"
    assert "Is this the right bus" in found.findings[0]["text"]
    assert "<td>error</td>" in found._repr_html_()


# walk --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def a_walk(tmp_path_factory):
    """A simulated walk as a log: configuration, log, truth."""
    folder = tmp_path_factory.mktemp("walk")
    truth = walked(CARRYINGS[0], 1.3, False, seconds=60.0, seed=3)
    (folder / "walk.dbc").write_text(WALK_DBC)
    (folder / "walk.yaml").write_text(WALK_CONFIG)
    lines = []
    for i, t in enumerate(truth.t.tolist()):
        for k, (values, unit) in enumerate(
            ((truth.accel[i], 1e-3), (truth.gyro[i], 1e-3), (truth.mag[i], 1e-8))
        ):
            data = struct.pack("<3hxx", *np.rint(np.asarray(values) / unit).astype(int))
            lines.append(f"({1.6e9 + t + k * 1e-4:.6f}) can0 20{k}#{data.hex().upper()}\n")
    (folder / "walk.log").write_text("".join(lines))
    return folder / "walk.yaml", folder / "walk.log", truth


def test_a_walk_is_that_of_the_command_line_and_finds_the_way(a_walk, tmp_path):
    path, recording, truth = a_walk
    found = imucald.walk(imucald.Config.load(path), recording)
    out = tmp_path / "walk.json"
    assert (
        cli.main(["walk", "--config", str(path), str(recording), "--json", str(out), "--quiet"])
        == 0
    )
    assert json.loads(out.read_text()) == found.to_dict()
    frame = found.to_pandas("steps")
    assert len(frame) == found.steps == len(found.track) > 60
    late = frame[frame["t_s"] > 15.0]
    course = np.interp(late["t_s"], truth.t, np.degrees(truth.course))
    error = (late["heading_deg"] - course + 180.0) % 360.0 - 180.0
    assert np.abs(error).median() < 15.0
    assert pickle.loads(pickle.dumps(found)).to_dict() == found.to_dict()
    assert found.arrow("steps").schema.field("heading_deg").metadata == {b"unit": b"deg"}
    assert len(repr(found).splitlines()) <= 5


def test_a_walk_of_no_frame_is_an_error(a_walk, tmp_path):
    path, _, _ = a_walk
    empty = tmp_path / "empty.log"
    empty.write_text("")
    with pytest.raises(imucald.LogError, match=r"empty\.log: holds no CAN frame"):
        imucald.walk(path, empty)


def test_a_walk_needs_a_compass():
    with pytest.raises(imucald.ConfigError, match="needs a magnetometer or a heading"):
        imucald.walk(config(), log())


# diagnose ----------------------------------------------------------------------------------


def test_a_diagnosis_is_that_of_the_command_line(monkeypatch, tmp_path):
    """The diagnosis itself is made by hand; what is made of it is held against the command."""
    monkeypatch.syspath_prepend(str(ROOT / "tests" / "diagnosis"))
    made = importlib.import_module("made_diagnosis")
    monkeypatch.setattr(diagnosing, "diagnosed", lambda *_: made.found())
    monkeypatch.setattr(diagnosing, "baseline_model", lambda *_: made.BEFORE)
    found = imucald.diagnose(config(), log())
    out = tmp_path / "found.json"
    assert (
        cli.main(["diagnose", "--config", str(CONFIG), str(log()), "--json", str(out), "--quiet"])
        == 0
    )
    assert json.loads(out.read_text()) == json.loads(json.dumps(found.to_dict()))
    assert found.verdict == "found"
    assert pickle.loads(pickle.dumps(found)).model_text() == found.model_text()
    assert len(found.causes) == 2
    assert found.model_text().startswith("# VehicleModel file written by imucald diagnose")
    assert found.write_model(tmp_path / "model.yaml").read_text() == found.model_text()
    assert len(repr(found).splitlines()) <= 5
    with pytest.raises(imucald.ConfigError, match="given twice"):
        imucald.diagnose(config(), [log(), log()])


# replay ------------------------------------------------------------------------------------


@pytest.mark.slow
def test_replay_writes_what_python_writes(tmp_path, capsys):
    out = tmp_path / "out.parquet"
    text = printed(capsys, "replay", "--config", CONFIG, log(), "--write", out)
    assert f"written: {tmp_path / 'out.accel.parquet'}" in text
    drive().write(tmp_path / "mine.parquet")
    for name in ("accel", "gyro", "history", "events"):
        mine, theirs = (
            imucald.open_result(tmp_path / f"{stem}.parquet") for stem in ("mine", "out")
        )
        assert mine.arrow(name).equals(theirs.arrow(name))


def test_only_the_quantities_that_are_named_are_written(tmp_path):
    arguments = ["replay", "--config", str(CONFIG), str(log()), "--quiet"]
    out = tmp_path / "out.csv"
    assert cli.main([*arguments, "--write", str(out), "--quantities", "gyro,raw/speed"]) == 0
    assert set(imucald.open_result(out).tables) == {"gyro", "raw/speed"}
    assert cli.main([*arguments, "--quantities", "gyro"]) == 1
    assert cli.main([*arguments, "--write", str(tmp_path / "a.xls")]) == 1
    assert cli.main([*arguments, "--write", str(tmp_path / "a.csv"), "--quantities", "x"]) == 1
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.slow
def test_several_logs_are_a_row_each_and_a_bad_one_stops_no_other(tmp_path, capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)  # of whoever runs the tests: notes would be folded
    folder = tmp_path / "logs"
    folder.mkdir()
    for name in ("a.log", "b.log"):
        (folder / name).write_bytes(log().read_bytes())
    (folder / "c.log").write_bytes(b"")
    out, result = tmp_path / "out.parquet", tmp_path / "out.json"
    status = cli.main(
        ["replay", "--config", str(CONFIG), str(folder), "--json", str(result), "--write", str(out)]
    )
    output = capsys.readouterr()
    assert status == 1
    assert "c.log: holds no CAN frame" in output.err
    assert "b.log is the same recording as" in output.out
    found = json.loads(result.read_text())
    assert [Path(one["log"]).name for one in found["drives"]] == ["a.log", "b.log"]
    for one in found["drives"]:
        del one["log"]
        assert one == drive().to_dict()
    written = {path.name for path in tmp_path.glob("*.parquet")}
    assert {"out.a.accel.parquet", "out.b.history.parquet"} <= written
    assert not any(".c." in name for name in written)


def test_pieces_of_one_recording_are_joined_on_request(tmp_path, capsys):
    lines = log().read_bytes().splitlines(keepends=True)
    half = len(lines) // 2
    first, second = tmp_path / "1.log", tmp_path / "2.log"
    first.write_bytes(b"".join(lines[:half]))
    second.write_bytes(b"".join(lines[half:]))
    out = tmp_path / "out.json"
    command = ["replay", "--config", str(CONFIG), str(tmp_path / "[12].log"), "--json", str(out)]
    assert cli.main([*command, "--joined", "--quiet"]) == 0
    assert json.loads(out.read_text())["frames"] == drive().frames
    assert cli.main([*command, "--quiet"]) == 0
    assert len(json.loads(out.read_text())["drives"]) == 2
    assert cli.main([*command, "--out", str(tmp_path / "frames.log")]) == 1
    assert "--joined" in capsys.readouterr().err


@pytest.mark.parametrize(("pieces", "said"), [
    ((0, 6000, 4000, 9000), "2.log begins {shared:.1f} s before {folder}/1.log ends"),
    ((4000, 9000, 0, 6000), "1.log begins {shared:.1f} s before {folder}/2.log ends"),
    ((6000, 9000, 0, 6000), "2.log is earlier than {folder}/1.log, which is read before it"),
    ((0, 6000, 6000, 9000), ""),
])  # fmt: skip
def test_pieces_that_hold_the_same_seconds_or_are_exchanged_are_named(
    tmp_path, capsys, pieces, said
):
    """An overlap is a warning, and no error: both pieces are replayed."""
    lines = log().read_bytes().splitlines(keepends=True)[:9000]
    names = [tmp_path / "1.log", tmp_path / "2.log"]
    for name, start, stop in zip(names, pieces[::2], pieces[1::2], strict=True):
        name.write_bytes(b"".join(lines[start:stop]))
    stamps = [float(lines[row].split()[0].strip(b"()")) for row in (4000, 5999, 0, -1)]
    out = tmp_path / "out.json"
    command = ["replay", "--config", str(CONFIG), *map(str, names), "--joined"]
    assert cli.main([*command, "--json", str(out)]) == 0
    lasts = json.loads(out.read_text())["duration_s"]
    assert lasts == pytest.approx(stamps[3] - stamps[2], abs=0.1), "in whatever order"
    noted = [line for line in capsys.readouterr().err.splitlines() if ".log" in line]
    said = said.format(shared=stamps[1] - stamps[0], folder=tmp_path)
    assert len(noted) == bool(said)
    assert all(f"{tmp_path}/{said}" in line for line in noted)


def test_the_same_recording_twice_is_refused_as_pieces_of_one(tmp_path, capsys):
    start = b"".join(log().read_bytes().splitlines(keepends=True)[:5000])
    first, again, packed = (tmp_path / name for name in ("1.log", "again.log", "2.log.gz"))
    first.write_bytes(start)
    again.symlink_to(first)
    packed.write_bytes(gzip.compress(start))
    for other in (first, again, packed):
        command = ["replay", "--config", str(CONFIG), str(first), str(other), "--joined"]
        assert cli.main([*command, "--quiet"]) == 1
        assert f"{other}: is the same recording as {first}" in capsys.readouterr().err
    with pytest.raises(imucald.LogError, match="the same recording"):
        imucald.check(config(), [first, packed])


# for people --------------------------------------------------------------------------------


def test_pictures_show_the_tables(monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("agg")
    ax = drive().plot.mount()
    roll = next(line for line in ax.lines if line.get_label() == "roll")
    assert np.array_equal(roll.get_ydata(), drive().tables["history"]["roll_deg"], equal_nan=True)
    low, high = ax.get_ylim()
    assert low < drive().mount.yaw_deg < high
    again = drive().plot.signals("gyro", ax=ax)
    assert again is ax
    assert drive().plot.evidence().patches
    with pytest.raises(imucald.ImucaldError, match="no table 'nothing'"):
        drive().plot.signals("nothing")


def test_a_notebook_shows_texts_as_texts():
    hostile = imucald.replay(config(), _named("<script>.log"), signals=False)
    assert "<script>" not in hostile._repr_html_()
    assert "&lt;script&gt;.log" in hostile._repr_html_()
    assert "<table>" in drive()._repr_html_()


def _named(name: str):
    file = io.BytesIO(log().read_bytes())
    file.name = name  # type: ignore[attr-defined]
    return file
