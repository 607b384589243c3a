"""`imucald.replay` gives what the command line gives, and more of it."""

from __future__ import annotations

import io
import json
import math
import pickle
from pathlib import Path

import numpy as np
import pytest
from replayed_drive import config, drive, log
from scipy.spatial.transform import Rotation

import imucald
import shuttle
from imucald import cli
from imucald.api.mount import MountResult
from imucald.can.columns import concatenate
from imucald.can.logs.log_reader import LogReader
from imucald.runtime.output.output_frames import OutputFrames
from simulated_bus import CONFIG
from simulated_bus import drive as simulated

COMMAND = ("replay", "--config", str(CONFIG), "--quiet")


def test_the_result_is_that_of_the_command_line_bit_for_bit(tmp_path):
    out = tmp_path / "result.json"
    assert cli.main([*COMMAND, str(log()), "--json", str(out)]) == 0
    assert out.read_text() == json.dumps(drive().to_dict(), indent=2, ensure_ascii=False) + "\n"
    without = imucald.replay(config(), log(), signals=False)
    assert without.to_dict() == drive().to_dict()
    assert set(without.tables) == {"history", "events"}


def test_corrected_samples_are_those_of_the_frames_that_are_written(tmp_path):
    out = tmp_path / "out.log"
    assert cli.main([*COMMAND, str(log()), "--out", str(out)]) == 0
    sent = concatenate(list(LogReader([out])))
    output = OutputFrames(config().loaded.config)
    for name in ("accel", "gyro"):
        table = drive().tables[name]
        values = np.stack(table.arrays[2:5], axis=1)
        can_id, data = output.corrected_columns(name, values, table["quality"].astype(np.uint8))
        mine = sent.can_id == can_id
        assert np.count_nonzero(mine) == len(table) > 20_000
        assert np.array_equal(sent.data[mine], data)
        assert np.array_equal(np.rint(sent.t[mine] * 1e6).astype(np.int64), table["time"])
        assert set(np.unique(table["quality"]).tolist()) >= {0, 2}
        assert np.array_equal(np.isnan(table.arrays[2]), table["quality"] == 0)


def test_raw_samples_are_what_the_sensor_sent():
    truth, raw = simulated(), drive().tables["raw/speed"]
    assert raw["raw_speed_mps"].max() == pytest.approx(truth.samples["speed"].values.max(), abs=0.1)
    accel = drive().tables["raw/accel"]
    standing = accel["t_s"] < 3.0
    size = np.linalg.norm(np.stack(accel.arrays[2:5])[:, standing], axis=0)
    assert np.median(size) == pytest.approx(9.81, abs=0.3)


def test_nothing_is_left_out_of_a_drive_that_lost_nothing():
    """The first block begins before the first frame: those ticks are no loss."""
    assert "accel" not in drive().summary["details"].get("frozen_ticks", {})


def test_history_is_the_estimate_at_whole_seconds_and_ends_as_the_mount():
    history, mount = drive().tables["history"], drive().mount
    assert mount is not None
    assert np.allclose(np.diff(history["t_s"]), 1.0)
    seconds = (history["time"] - drive().start_us) / 1e6
    assert np.allclose(seconds, np.arange(1, len(history) + 1), atol=1e-5)
    assert history["roll_deg"][-1] == pytest.approx(mount.roll_deg, abs=0.1)
    assert history["yaw_deg"][-1] == pytest.approx(mount.yaw_deg, abs=0.1)
    assert history["cov_zz_deg2"][-1] == pytest.approx(mount.covariance_deg2[2, 2], rel=0.2)
    assert history["roll_std_deg"][-1] == pytest.approx(mount.angle_std_deg[0], rel=0.2)
    usable = history["usable"]
    assert np.isfinite(history["yaw_std_deg"][usable]).all()
    early = history["cov_zz_deg2"] > 3600.0
    assert early.any(), "yaw is not known at first"
    assert np.isnan(history["yaw_deg"][early]).all()
    assert np.isnan(history["yaw_std_deg"][early]).all()
    first = history["t_s"][np.flatnonzero(history["usable"])[0]]
    assert drive().first_usable_s <= first < drive().first_usable_s + 1.0
    quaternions = np.stack([history[f"q_{part}"] for part in "wxyz"])
    known = ~np.isnan(quaternions[0])
    assert np.count_nonzero(known) > 0
    assert np.allclose(np.linalg.norm(quaternions[:, known], axis=0), 1.0)


def test_events_tell_changes_of_state_in_order():
    events = drive().tables["events"]
    states = events["text"][events["kind"] == "state"].tolist()
    assert states[0] == "levelled"
    assert states[-1] == drive().state
    assert list(events["t_s"]) == sorted(events["t_s"])


def test_a_hole_is_an_event_and_times_of_day_follow_the_log(tmp_path):
    path = shuttle.write(tmp_path)
    lines = (tmp_path / "shuttle.log").read_text().splitlines()
    half = len(lines) // 2
    moved = [_later(line, 500.0) for line in lines[half:]]
    (tmp_path / "hole.log").write_text("\n".join([*lines[:half], *moved]) + "\n")
    found = imucald.replay(imucald.Config.load(path), tmp_path / "hole.log")
    events, accel = found.tables["events"], found.tables["accel"]
    row = list(events["kind"]).index("segment")
    assert events["text"][row] == "hole of 500.0 s"
    at = np.searchsorted(accel["time"], events["time"][row] - 1)
    assert accel["time"][at] == pytest.approx(events["time"][row], abs=20_000)
    assert np.diff(accel["time"]).max() == pytest.approx(500e6, abs=20_000)
    assert 0.0 < np.diff(accel["t_s"]).max() < 11.0
    history = found.tables["history"]
    assert (
        np.abs(np.interp(history["time"], accel["time"], accel["t_s"]) - history["t_s"])[
            history["t_s"] < events["t_s"][row] - 10.5
        ].max()
        < 1e-3
    )


def _later(line, seconds):
    stamp, rest = line[1:].split(")", 1)
    return f"({float(stamp) + seconds:.6f}){rest}"


@pytest.mark.parametrize("kind", [str, Path])
def test_a_configuration_may_be_given_by_its_files_name(kind):
    name = kind(config().path)
    assert imucald.replay(name, log(), signals=False).to_dict() == drive().to_dict()
    assert imucald.check(name, log()).to_dict() == imucald.check(config(), log()).to_dict()
    assert next(iter(imucald.stream(name, log()))).from_s >= 0.0


def test_a_log_in_the_place_of_the_configuration_is_refused_with_its_name():
    with pytest.raises(imucald.ConfigError, match=log().name):
        imucald.replay(log(), config().path)


def test_a_log_of_another_bus_says_so_where_the_drive_is_shown(tmp_path):
    other = tmp_path / "other.log"
    other.write_text("(1.000000) can0 123#00\n")
    shown = imucald.replay(config(), other)
    assert "no usable frame" in repr(shown)
    assert "no usable frame" in shown._repr_html_()


def test_an_open_file_gives_the_same_as_its_name():
    data = log().read_bytes()
    assert imucald.replay(config(), io.BytesIO(data)).to_dict() == drive().to_dict()
    with log().open("rb") as file:
        assert imucald.replay(config(), file, signals=False).to_dict() == drive().to_dict()
    with log().open() as file, pytest.raises(imucald.LogError, match="reading bytes"):
        imucald.replay(config(), file)


def test_progress_is_reported_to_the_end():
    steps = []
    imucald.replay(config(), log(), signals=False, progress=lambda *step: steps.append(step))
    assert steps[-1] == (log().stat().st_size, log().stat().st_size)
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)


def test_bad_lines_are_counted_or_raise(tmp_path):
    bad = tmp_path / "bad.log"
    bad.write_bytes(b"nonsense\n" + log().read_bytes()[:200_000])
    found = imucald.replay(config(), bad)
    assert sum(found.frames["rejected"].values()) >= 1
    assert "bad.log:1" in found.problems[0]
    with pytest.raises(imucald.LogError, match=r"bad\.log:1"):
        imucald.replay(config(), bad, strict=True)


@pytest.mark.parametrize("content", [b"", b"nothing of the kind\n"])
def test_a_log_without_a_frame_is_an_error(tmp_path, content):
    path = tmp_path / "no.log"
    path.write_bytes(content)
    with pytest.raises(imucald.LogError, match=r"no\.log"):
        imucald.replay(config(), path)


def test_a_wrong_configuration_says_where(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text("database: x.dbc\nsignals:\n  accelerometre: {}\n")
    with pytest.raises(imucald.ConfigError, match=r"car\.yaml:3.*accelerometre"):
        imucald.Config.load(path)


def test_results_and_configurations_cross_processes():
    again = pickle.loads(pickle.dumps(drive()))
    assert again.to_dict() == drive().to_dict()
    for name, table in drive().tables.items():
        for mine, theirs in zip(table.arrays, again.tables[name].arrays, strict=True):
            assert np.array_equal(mine, theirs, equal_nan=mine.dtype.kind == "f")
    assert np.array_equal(again.mount.matrix, drive().mount.matrix)
    copied = pickle.loads(pickle.dumps(config()))
    assert imucald.replay(copied, log(), signals=False).to_dict() == drive().to_dict()


def test_a_representation_has_at_most_five_lines():
    for one in (drive(), drive().mount, config()):
        assert len(repr(one).splitlines()) <= 5
        assert max(len(line) for line in repr(one).splitlines()) < 120


# the mount ---------------------------------------------------------------------------------


def a_mount():
    rng = np.random.default_rng(5)
    R = Rotation.from_euler("ZYX", [-170.0, 80.0, 100.0], degrees=True)
    A = rng.normal(size=(3, 3))
    return R, MountResult(R.as_matrix(), A @ A.T)


def test_angles_and_quaternion_are_those_of_scipy():
    R, mount = a_mount()
    yaw, pitch, roll = R.as_euler("ZYX", degrees=True)
    assert (mount.roll_deg, mount.pitch_deg, mount.yaw_deg) == pytest.approx((roll, pitch, yaw))
    assert mount.quaternion_wxyz == pytest.approx(R.as_quat(canonical=True, scalar_first=True))


def test_apply_turns_vectors_of_any_shape_and_inverse_turns_them_back():
    R, mount = a_mount()
    v = np.random.default_rng(1).normal(size=(4, 5, 3))
    assert np.allclose(mount.apply(v).reshape(-1, 3), R.apply(v.reshape(-1, 3)))
    assert np.allclose(mount.inverse().apply(mount.apply(v)), v)
    assert mount.apply([0.0, 0.0, 1.0]).shape == (3,)


def test_the_covariance_of_the_inverse_is_that_of_its_errors():
    """Against 40,000 errors that are drawn and turned round by scipy, not by our formula."""
    R, mount = a_mount()
    rng = np.random.default_rng(2)
    errors = rng.multivariate_normal(np.zeros(3), mount.covariance_deg2 * 0.01, 40_000)
    truth = Rotation.from_rotvec(errors, degrees=True) * R
    of_inverse = (truth.inv() * R).as_rotvec(degrees=True)
    assert np.allclose(
        np.cov(of_inverse.T) * 100.0, mount.inverse().covariance_deg2, rtol=0.05, atol=0.05
    )


def test_no_estimate_is_no_mount(tmp_path):
    path = shuttle.write(tmp_path, cycles=1)
    first = b"".join((tmp_path / "shuttle.log").read_bytes().splitlines(keepends=True)[:50])
    found = imucald.replay(imucald.Config.load(path), io.BytesIO(first))
    assert found.mount is None
    assert found.to_dict()["mount"]["covariance_deg2"] is None
    assert math.isnan(drive().tables["history"]["roll_deg"][0])
