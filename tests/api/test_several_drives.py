"""Several logs are several drives; overlaps and mounts that were moved between them are told."""

from __future__ import annotations

import json
import pickle
import re

import pytest
from replayed_drive import config

import imucald
import shuttle
from imucald import cli
from imucald.api.drives import between_drives, names_apart


def test_several_logs_are_several_drives(tmp_path):
    first = shuttle.write(tmp_path, yaw_deg=25.0)
    (tmp_path / "shuttle.log").rename(tmp_path / "a.log")
    shuttle.write(tmp_path, yaw_deg=25.0, t0=1.6e9 + 1000)
    (tmp_path / "shuttle.log").rename(tmp_path / "b.log")
    shuttle.write(tmp_path, yaw_deg=35.0, t0=1.6e9 + 2000)
    (tmp_path / "shuttle.log").rename(tmp_path / "c.log")
    (tmp_path / "d.log").write_bytes((tmp_path / "c.log").read_bytes())
    shuttle.write(tmp_path, yaw_deg=35.0, t0=1.6e9 + 2010)
    (tmp_path / "shuttle.log").rename(tmp_path / "e.log")
    loaded = imucald.Config.load(first)
    names = imucald.find_logs(tmp_path)
    (tmp_path / "f.log").write_bytes((tmp_path / "d.log").read_bytes())
    assert [name.name for name in names] == ["a.log", "b.log", "c.log", "d.log", "e.log"]
    found = imucald.replay(loaded, names, signals=False)
    assert [round(drive.mount.yaw_deg) for drive in found] == [25, 25, 35, 35, 35]
    alone = imucald.replay(loaded, tmp_path / "b.log", signals=False)
    assert found[1].to_dict() == alone.to_dict()
    notes = "\n".join(found.notes)
    assert "d.log is the same recording as" in notes
    assert "e.log begins" in notes
    again = imucald.replay(loaded, [names[2], names[4], tmp_path / "f.log"], signals=False)
    assert any("f.log is the same recording as" in note for note in again.notes), "e is between"
    moved = [note for note in found.notes if "the mount was moved" in note]
    assert len(moved) == 1
    assert "b.log and" in moved[0]
    assert "c.log" in moved[0]
    assert "of several vehicles use 'imucald fleet'" in moved[0]
    assert any(
        re.fullmatch(
            r"the mounts of .*a.log and .*b.log differ by no more than chance: "
            r"(?:[xyz] [+-]\d\.\d\d ± \d\.\d\d(?:, )?){3} deg about the vehicle's axes",
            text,
        )
        for text in found.agreements
    ), found.agreements
    frame = found.to_pandas()
    assert len(frame) == 5
    assert list(frame["log"]) == [str(name) for name in names]
    assert "was moved" in found._repr_html_()
    assert len(repr(found).splitlines()) <= 5
    assert pickle.loads(pickle.dumps(found)).to_dict() == found.to_dict()
    joined = imucald.replay(loaded, names[:2], joined=True, signals=False)
    assert joined.to_dict()["frames"]["read"] == sum(d.frames["read"] for d in found.drives[:2])


def test_a_log_that_cannot_be_read_does_not_lose_the_others(tmp_path, capsys):
    file = shuttle.write(tmp_path)
    good, broken = tmp_path / "shuttle.log", tmp_path / "broken.log"
    broken.write_text("no frame\n")
    loaded = imucald.Config.load(file)
    found = imucald.replay(loaded, [broken, good], signals=False)
    assert [drive.state for drive in found] == [imucald.replay(loaded, good).state]
    ((name, reason),) = found.failed
    assert name == str(broken)
    assert "broken.log" in reason
    assert found.to_dict()["failed"] == [{"log": name, "reason": reason}]
    assert "broken.log" in repr(found)
    with pytest.raises(imucald.LogError):
        imucald.replay(loaded, [broken, good], strict=True)
    with pytest.raises(imucald.LogError, match="broken"):
        imucald.replay(loaded, [broken])
    out = tmp_path / "all.json"
    arguments = ["replay", "--config", str(file), str(broken), str(good), "--json", str(out)]
    assert cli.main([*arguments, "--quiet"]) == 1
    assert json.loads(out.read_text())["failed"] == [{"log": name, "reason": reason}]


def test_drives_that_overlap_have_no_order_and_so_no_move_between_them(tmp_path):
    names = []
    for name, t0, yaw_deg in (("a", 1.6e9, 25.0), ("b", 1.6e9 + 10, 35.0), ("c", 1.6e9 + 20, 25.0)):
        first = shuttle.write(tmp_path, yaw_deg=yaw_deg, t0=t0)
        names.append((tmp_path / "shuttle.log").rename(tmp_path / f"{name}.log"))
    found = imucald.replay(imucald.Config.load(first), names, signals=False)
    assert sum("begins" in note for note in found.notes) == 2
    assert not any("moved" in note for note in found.notes)
    said = "were not compared, because drives that overlap have no order"
    assert [note.endswith(said) for note in found.notes] == [False, False, True, True]
    assert f"the mounts of {names[0]} and {names[1]} {said}" in found.notes


def test_a_move_within_a_drive_is_none_between_it_and_the_one_before(tmp_path, monkeypatch):
    drives = []
    for t0, yaw_deg in ((1.6e9, 25.0), (1.6e9 + 1000, 35.0)):
        first = shuttle.write(tmp_path, yaw_deg=yaw_deg, t0=t0)
        drives.append(imucald.replay(imucald.Config.load(first), tmp_path / "shuttle.log"))
    (between,) = between_drives(drives).notes
    assert "was moved between" in between
    shift = {"t": 396.0, "within_deg": None}
    result = drives[1].to_dict()
    result["details"]["shifts"] = [shift]
    monkeypatch.setattr(type(drives[1]), "to_dict", lambda _: result)
    notes = list(between_drives(drives).notes)
    within = notes[-1]
    assert not any("was moved between" in note for note in notes)
    assert "was moved within" in within
    assert within.endswith("found at 6:36")


@pytest.mark.parametrize(("logs", "names"), [
    (["a/1.log", "a/2.log.gz", "2026.11.22.blf"], ["1", "2", "2026.11.22"]),
    (["mon/can.log.gz", "tue/can.log.gz", "x.log"], ["mon-can", "tue-can", "x"]),
    (["can.log", "can.log", "-"], ["can", "can-2", "-"]),
])  # fmt: skip
def test_files_of_several_drives_are_called_after_their_logs(logs, names):
    assert names_apart(logs) == names


def test_a_folder_gives_the_logs_of_every_format_and_no_tables(tmp_path):
    logs = ["a.log", "b.log.gz", "c.ASC", "d.blf.xz", "e.mf4", "f.pcapng", "g.trc"]
    for name in [*logs, "car.yaml", "car.dbc", "result.json", "signals.csv", "points.db"]:
        (tmp_path / name).touch()
    assert [name.name for name in imucald.find_logs(tmp_path)] == logs


def test_a_folder_is_no_log_and_an_empty_one_holds_none(tmp_path):
    with pytest.raises(imucald.LogError, match="is a folder"):
        imucald.replay(config(), tmp_path)
    with pytest.raises(imucald.LogError, match="there is no log at"):
        imucald.find_logs(tmp_path)
    with pytest.raises(imucald.LogError, match="no log to replay"):
        imucald.replay(config(), [])
