"""Replay: logs through the engine, by whatever chunks the reader gives."""

from __future__ import annotations

import gzip
import json
import time

import numpy as np
import pytest

from imucald.can.logs.log_reader import CandumpWriter, LogReader
from imucald.core.errors import LogError
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine
from imucald.runtime.summary import as_json
from simulated_bus import drive_frames, loaded

FRAMES = 12_000


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "drive.log"
    with CandumpWriter(path) as writer:
        writer.write_columns(drive_frames().take(slice(0, FRAMES)))
    return path


def replayed(paths, **options):
    engine = make_engine(loaded("published"))
    reader = LogReader(paths, engine.router.matches)
    sent = []
    result = Replay(engine, reader, sent.append, **options).run()
    return result, [(c.can_id.tolist(), c.data.tobytes(), c.t.tolist()) for c in sent], engine


def joined(sent):
    return ([i for ids, _, _ in sent for i in ids], b"".join(d for _, d, _ in sent))


def test_the_summary_has_the_documented_keys_and_counts(log):
    result, sent, engine = replayed([log])
    assert set(result) >= {
        "mount", "state", "waiting_for", "first_usable_s", "first_fine_s", "frames", "duration_s",
        "signals", "correction",
    }  # fmt: skip
    assert set(result["mount"]) == {
        "roll_deg", "pitch_deg", "yaw_deg", "quaternion_wxyz", "std_deg", "angle_std_deg",
        "covariance_deg2", "sits", "steep", "mirrored", "judged_std_deg", "target_std_deg",
    }  # fmt: skip
    frames = drive_frames()
    assert result["frames"]["read"] == FRAMES
    assert result["frames"]["used"] + sum(result["frames"]["rejected"].values()) == FRAMES
    assert result["duration_s"] == pytest.approx(frames.t[FRAMES - 1] - frames.t[0], abs=1e-5)
    rate = result["signals"]["accel"]
    assert rate["rate_hz"] == pytest.approx(rate["samples"] / result["duration_s"], abs=0.001)
    assert engine.sent == len(joined(sent)[0])
    assert json.loads(as_json(result))["mount"] == result["mount"]


def test_without_a_sink_the_estimate_is_the_same(log):
    with_sink, _, counted = replayed([log])
    engine = make_engine(loaded("published"))
    without = Replay(engine, LogReader([log], engine.router.matches)).run()
    assert without == with_sink
    assert engine.sent == counted.sent


def test_a_log_in_two_files_and_packed_is_the_same_log(log, tmp_path):
    whole, sent, _ = replayed([log])
    lines = log.read_bytes().splitlines(keepends=True)
    first, second = tmp_path / "a.log", tmp_path / "b.log.gz"
    first.write_bytes(b"".join(lines[:5000]))
    second.write_bytes(gzip.compress(b"".join(lines[5000:])))
    parts, sent_parts, _ = replayed([first, second])
    assert parts == whole
    assert joined(sent_parts) == joined(sent)


def test_output_stamps_are_those_of_the_input_frames(log):
    _, sent, _ = replayed([log])
    stamps = np.array([t for _, _, ts in sent for t in ts])
    inputs = drive_frames().t[:FRAMES]
    assert np.isin(stamps, inputs).all()
    assert (np.diff(stamps) >= 0).all()


def test_paced_replay_takes_its_time_and_gives_the_same(log, tmp_path):
    lines = log.read_bytes().splitlines(keepends=True)[:1200]
    path = tmp_path / "short.log"
    path.write_bytes(b"".join(lines))
    fast, sent, _ = replayed([path])
    began = time.perf_counter()
    paced, sent_paced, _ = replayed([path], speed=8.0)
    taken = time.perf_counter() - began
    assert paced == fast
    assert joined(sent_paced) == joined(sent)
    assert taken >= fast["duration_s"] / 8.0 * 0.95


@pytest.mark.parametrize("strange", ["7F0#00", "7F0#R", "7F0##000"])
def test_first_times_count_from_the_first_frame_of_the_log(tmp_path, strange):
    drive = tmp_path / "drive.log"
    with CandumpWriter(drive) as writer:
        writer.write_columns(drive_frames())
    start = float(drive_frames().t[0])
    path = tmp_path / "later.log"
    early = f"no frame\n({start - 50.0:.6f}) can1 {strange}\n"
    path.write_bytes(early.encode() + drive.read_bytes())
    plain, _, engine = replayed([drive])
    later = replayed([path])[0]
    pipeline = engine.pipeline
    assert plain["first_usable_s"] == pytest.approx(pipeline.first_usable, abs=1e-3)
    assert plain["first_fine_s"] == (pipeline.first_fine and pytest.approx(pipeline.first_fine))
    assert later["frames"]["read"] == plain["frames"]["read"] + 1
    assert later["frames"]["used"] == plain["frames"]["used"]
    assert later["first_usable_s"] == pytest.approx(plain["first_usable_s"] + 50.0, abs=1e-3)
    assert later["duration_s"] == plain["duration_s"]


def test_an_empty_log_is_no_error(tmp_path):
    path = tmp_path / "empty.log"
    path.write_bytes(b"")
    result, sent, _ = replayed([path])
    assert result["frames"] == {"read": 0, "used": 0, "rejected": {}}
    assert result["duration_s"] == 0.0
    assert result["state"] == "waiting"
    assert sent == []
    json.loads(as_json(result))


def test_a_log_that_is_not_there_is_reported(tmp_path):
    with pytest.raises(LogError, match=r"none\.log"):
        replayed([tmp_path / "none.log"])
