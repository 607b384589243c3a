"""A log becomes the samples of one drive: what is read, what is rejected, and what is told."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from engine_bus import Sender, columns_of, load
from imucald.can.logs.log_reader import CandumpWriter
from imucald.core.errors import LogError
from imucald.diagnosis.recording import read_samples
from imucald.runtime.session import open_config
from simulated_bus import drive, drive_frames, loaded, with_data, with_times

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent.parent
DATA = ROOT.parent / "shared" / "data"

TWO_SENSORS = """\
database: bus.dbc
signals:
  accelerometer:
    - {x: ACC.AX, y: ACC.AY, z: ACC.AZ}
    - {x: ACC_XY.BX, y: ACC_XY.BY}
  speed: [SPD.V, SPD2.V2]
messages:
  ACC_XY: {cycle_time: 0.05}
"""


def written(path: Path, frames) -> Path:
    with CandumpWriter(path) as writer:
        writer.write_columns(frames)
    return path


def say(sender: Sender, path: Path, *frames) -> Path:
    """A log of (time, message, values)."""
    return written(path, columns_of([sender.frame(t, m, **v) for t, m, v in frames]))


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> Path:
    return written(tmp_path_factory.mktemp("log") / "drive.log", drive_frames(3, 4.0))


@pytest.fixture(scope="module")
def recording(log):
    return read_samples(loaded(), [log])


def test_samples_are_those_that_the_drive_had(recording):
    truth = drive(3, 4.0).samples
    assert set(recording.samples) == set(truth)
    for channel, step in (("accel", 0.002), ("gyro", 1.8e-4), ("speed", 0.003), ("steering", 1e-3)):
        series, expected = recording.samples[channel], truth[channel]
        assert len(series.t) == len(expected.t)
        np.testing.assert_allclose(series.values, expected.values, atol=0.51 * step + 1e-9)
        # the bus makes frames wait for one another: a millisecond or two
        late = series.t - expected.t
        assert np.ptp(late) < 0.005
        assert np.all(np.diff(series.t) >= 0.0)


def test_time_is_from_the_first_frame_and_counts_are_reported(recording):
    frames = drive_frames(3, 4.0)
    assert min(s.t[0] for s in recording.samples.values()) == 0.0
    assert recording.duration_s == pytest.approx(frames.t[-1] - frames.t[0])
    assert recording.frames_read == len(frames)
    assert recording.gaps == ()
    assert recording.name == "drive.log"


def test_cycle_times_are_those_of_the_database(recording):
    wanted = {"accel": 0.01, "gyro": 0.01, "speed": 0.02, "yaw_rate": 0.02, "temperature": 1.0}
    assert {c: recording.cycle_s[c] for c in wanted} == wanted


def test_damaged_frames_are_rejected_and_counted(tmp_path):
    frames = drive_frames(3, 4.0).take(slice(0, 6000))
    hit = np.flatnonzero(frames.can_id == 512)[100:110]
    data = frames.data.copy()
    data[hit, 0] ^= 0x5A  # the checksum no longer holds
    log = written(tmp_path / "damaged.log", with_data(frames, data))
    whole = read_samples(loaded(), [written(tmp_path / "whole.log", frames)])
    found = read_samples(loaded(), [log])
    assert found.rejected["checksum"] - whole.rejected.get("checksum", 0) == len(hit)
    assert len(whole.samples["accel"].t) - len(found.samples["accel"].t) >= len(hit)
    assert len(whole.samples["gyro"].t) == len(found.samples["gyro"].t)


def test_pieces_of_one_recording_are_read_as_one_and_a_hole_is_reported(tmp_path, recording):
    frames = drive_frames(3, 4.0)
    half = len(frames) // 2
    later = with_times(frames, frames.t + 1000.0)
    first = written(tmp_path / "a.log", frames.take(slice(0, half)))
    second = written(tmp_path / "b.log", later.take(slice(half, len(frames))))
    found = read_samples(loaded(), [first, second])
    lost = len(recording.samples["accel"].t) - len(found.samples["accel"].t)
    assert 0 <= lost <= 5  # after the hole the alive counter must be seen to count again
    (gap,) = found.gaps
    begin = frames.t[half] - frames.t[0]
    assert begin < gap < begin + 10.2  # a hole lasts ten seconds of stream time at most
    assert found.duration_s == pytest.approx(recording.duration_s + gap - begin, abs=0.01)


def test_progress_reaches_the_end(log):
    seen = []
    read_samples(loaded(), [log], lambda done, total: seen.append((done, total)))
    size = log.stat().st_size
    assert seen[-1] == (size, size)
    assert [done for done, _ in seen] == sorted(done for done, _ in seen)


def test_only_the_first_of_several_sensors_is_read(tmp_path):
    sensors = load(TWO_SENSORS, tmp_path)
    sender = Sender(sensors)
    log = say(
        sender,
        tmp_path / "two.log",
        (0.0, "ACC_XY", {"BX": 5.0, "BY": 5.0}),
        (0.1, "ACC", {"AX": 1.0, "AY": 2.0, "AZ": 9.0}),
        *((t, "ACC_XY", {"BX": 5.0, "BY": 5.0}) for t in np.arange(3.0, 9.0, 0.5)),
        (9.1, "SPD2", {"V2": 100.0}),
    )
    found = read_samples(sensors, [log])
    assert found.samples["accel"].values.tolist() == [pytest.approx([1.0, 2.0, 9.0], abs=0.01)]
    assert found.samples["speed"].values == pytest.approx([44.704])  # second choices of a scalar do


def test_a_sensor_without_z_is_read(tmp_path):
    flat = load("database: bus.dbc\nsignals:\n  accelerometer: {x: ACC_XY.BX, y: ACC_XY.BY}\n",
                tmp_path)  # fmt: skip
    log = say(Sender(flat), tmp_path / "flat.log", (0.0, "ACC_XY", {"BX": 1.0, "BY": 0.0}))
    found = read_samples(flat, [log])
    assert found.samples["accel"].values.shape == (1, 3)


def test_a_log_of_another_vehicle_is_an_error_that_says_what_to_do(tmp_path):
    log = tmp_path / "other.log"
    log.write_text("(1600000000.000000) can0 7FF#0011\n" * 5)
    with pytest.raises(LogError, match=r"other\.log: the log has no usable frame.*imucald check"):
        read_samples(loaded(), [log])


def test_a_log_without_frames_is_an_error(tmp_path):
    log = tmp_path / "empty.log"
    log.write_text("nothing that is a frame\n")
    with pytest.raises(LogError, match="the format of this log is not known"):
        read_samples(loaded(), [log])
    with pytest.raises(LogError, match=r"empty\.log: the format of this log is not known"):
        read_samples(loaded(), [log], strict=True)


def test_bad_lines_are_kept_as_texts(tmp_path):
    log = written(tmp_path / "drive.log", drive_frames(3, 4.0).take(slice(0, 2000)))
    log.write_bytes(log.read_bytes() + b"(16 no frame\n")
    found = read_samples(loaded(), [log])
    assert sum(found.rejected.values()) >= 1
    assert "drive.log:2001" in found.problems[0]


@pytest.mark.parametrize(("name", "seconds", "channels"), [
    ("kingston_2008", 3530, {"accel", "gyro", "speed"}),
    ("wrx_sti", 90, {"accel", "speed", "steering", "yaw_rate"}),
])  # fmt: skip
def test_measured_drives_are_read(name, seconds, channels):
    log = DATA / name / "drive.log.gz"
    if not log.exists():
        pytest.skip(f"the measured drive {name} is not here ({log})")
    config = ROOT / "benchmarks" / "measured_drives" / f"{name}.yaml"
    found = read_samples(open_config(config), [log])
    assert channels <= set(found.samples)
    assert found.duration_s == pytest.approx(seconds, rel=0.02)
    with gzip.open(log) as lines:
        assert found.frames_read == sum(1 for _ in lines)
