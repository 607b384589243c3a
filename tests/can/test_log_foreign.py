from __future__ import annotations

import contextlib
import gzip
from pathlib import Path

import pytest

from imucald.can import logs
from imucald.can.logs import frame_batches, python_can_logs
from imucald.can.logs.log_reader import CAN_EFF_FLAG, IdMatch, LogReader
from imucald.can.python_can import can
from imucald.core.errors import LogError
from log_text import Frame, frames_of

START = 1_600_000_000.0
FRAMES = [
    Frame(
        START + k / 64, [0x200, 0x3E8, CAN_EFF_FLAG | 0x18FEF1AA][k % 3], bytes(data), "can1", False
    )
    for k, data in enumerate([range(8), range(3), [], [255] * 8, [1]] * 4)
]


def message(frame: Frame) -> can.Message:
    return can.Message(
        timestamp=frame.t,
        arbitration_id=frame.can_id % CAN_EFF_FLAG,
        is_extended_id=frame.can_id >= CAN_EFF_FLAG,
        data=frame.data,
        is_fd=frame.fd,
        channel=int(frame.channel[3:]),
    )


def write(path: Path, messages: list[can.Message]) -> None:
    with can.Logger(path) as writer:
        for one in messages:
            writer.on_message_received(one)


def with_others(frames: list[Frame]) -> list[can.Message]:
    remote = can.Message(timestamp=START + 1, arbitration_id=0x200, is_remote_frame=True, channel=1)
    error = can.Message(timestamp=START + 1, is_error_frame=True, channel=1)
    return [message(f) for f in frames[:10]] + [remote, error] + [message(f) for f in frames[10:]]


# What a format cannot hold: CSV no channel and no FD, SQLite no channel, ASC and TRC times of
# their own start and resolution, TRC counts channels from 1.
@pytest.mark.parametrize("name", ["a.asc", "a.blf", "a.trc", "a.csv", "a.db", "a.ASC", "a.asc.gz"])
def test_other_formats_give_the_same_columns(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    messages = [message(f) for f in FRAMES]
    write(path if name != "a.ASC" else tmp_path / "b.asc", messages)
    if name == "a.ASC":
        (tmp_path / "b.asc").rename(path)
    reader = LogReader([path], strict=True)
    frames = frames_of(*reader)
    assert [f._replace(t=0, channel="") for f in frames] == [
        f._replace(t=0, channel="") for f in FRAMES
    ]
    assert [f.t - frames[0].t for f in frames] == pytest.approx(
        [f.t - START for f in FRAMES], abs=1.1e-3 if name == "a.trc" else 1e-6
    )
    if name.lower() in ("a.asc", "a.blf"):
        assert {f.channel for f in frames} == {"can1"}
    assert reader.frames_read == len(FRAMES)
    assert reader.rejected == {}


@pytest.mark.parametrize("name", ["a.asc", "a.blf", "a.csv"])
def test_the_first_frame_counts_for_the_start_though_it_is_not_wanted(
    tmp_path: Path, name: str
) -> None:
    with can.Logger(tmp_path / name) as writer:
        for k, can_id in enumerate((0x700, 0x123)):
            writer(can.Message(START + k, can_id, False, data=b"1"))
    reader = LogReader([tmp_path / name], [IdMatch(0x123, 0x7FF)])
    (frames,) = reader
    assert reader.first_stamp is not None
    assert frames.t[0] - reader.first_stamp == pytest.approx(1.0, abs=1e-3)


def test_mf4_is_read_with_asammdf(tmp_path: Path) -> None:
    from imucald.can.python_can import with_mf4

    with_mf4()
    from can.io.mf4 import MF4Writer

    with MF4Writer(tmp_path / "a.mf4") as writer:
        for frame in FRAMES:
            writer.on_message_received(message(frame))
    frames = frames_of(*LogReader([tmp_path / "a.mf4"], strict=True))
    assert [f._replace(t=0, channel="") for f in frames] == [
        f._replace(t=0, channel="") for f in FRAMES
    ]


@pytest.mark.parametrize("name", ["a.asc", "a.blf"])
def test_can_fd_frames_are_read_from_other_formats(tmp_path: Path, name: str) -> None:
    frames = [*FRAMES[:2], Frame(START + 1, 0x321, bytes(range(64)), "can0", True), FRAMES[3]]
    write(tmp_path / name, [message(f) for f in frames])
    got = frames_of(*LogReader([tmp_path / name], strict=True))
    assert [f._replace(t=0) for f in got] == [f._replace(t=0) for f in frames]


@pytest.mark.parametrize("name", ["a.asc", "a.blf"])
def test_remote_and_error_frames_are_counted_but_not_passed_on(tmp_path: Path, name: str) -> None:
    write(tmp_path / name, with_others(FRAMES))
    reader = LogReader([tmp_path / name], strict=True)
    assert [f.data for f in frames_of(*reader)] == [f.data for f in FRAMES]
    assert reader.ignored == {"remote_frame": 1, "error_frame": 1}
    assert reader.frames_read == len(FRAMES) + 2


def test_filters_and_batches_are_those_of_candump(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frame_batches, "BATCH_FRAMES", 3)
    write(tmp_path / "a.blf", [message(f) for f in FRAMES])
    done: list[int] = []
    keep = [IdMatch(0x3E8, 0x7FF, "can1"), IdMatch(0x200, 0x7FF, "can0")]
    reader = LogReader([tmp_path / "a.blf"], keep, progress=lambda *now: done.append(now[0]))
    chunks = list(reader)
    wanted = [f for f in FRAMES if f.can_id == 0x3E8]
    assert frames_of(*chunks) == wanted
    assert [len(chunk) for chunk in chunks] == [3, 3, 1]
    assert done == sorted(done)
    assert done[-1] == (tmp_path / "a.blf").stat().st_size


def test_logs_of_several_formats_are_one_recording(tmp_path: Path) -> None:
    write(tmp_path / "a.blf", [message(f) for f in FRAMES])
    (tmp_path / "b.log.gz").write_bytes(gzip.compress(b"(1.000000) can0 123#01\n"))
    chunks = list(LogReader([tmp_path / "b.log.gz", tmp_path / "a.blf"]))
    assert frames_of(*chunks) == [Frame(1.0, 0x123, b"\x01", "can0", False), *FRAMES]
    assert chunks[-1].channels == ("can0", "can1")


@pytest.mark.parametrize("name", ["a.asc", "a.blf", "a.trc", "a.csv", "a.db", "a.mf4"])
@pytest.mark.parametrize("content", [b"", b"\0" * 300, b"LOGG" + b"\xff" * 200, b"x,y\n1,2\n"])
def test_what_is_no_log_is_an_error_or_empty(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    reader = LogReader([path])
    frames: list[Frame] = []
    with contextlib.suppress(LogError):
        frames = frames_of(*reader)
    assert frames == []


@pytest.mark.parametrize("name", ["a.asc", "a.blf", "a.trc", "a.csv", "a.db", "a.mf4"])
def test_a_file_that_is_not_there_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(LogError, match=rf"{name}: cannot be opened: No such file"):
        list(LogReader([tmp_path / name]))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["a.asc", "a.trc", "a.csv"])
def test_no_cut_text_log_gives_a_frame_it_did_not_hold(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    written = [f for f in FRAMES if len(f.data) == 8]
    write(path, [message(f) for f in written])
    text = path.read_bytes()
    for end in range(len(text) * 2 // 3, len(text)):
        path.write_bytes(text[:end])
        reader = LogReader([path])
        data = [f.data for f in frames_of(*reader)]
        assert reader.frames_read == len(data)
        assert data == [f.data for f in written[: len(data)]]


def test_what_was_read_before_damage_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write(path, [message(f) for f in FRAMES])
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2] + b"?\n1,2\n")
    reader = LogReader([path])
    frames = frames_of(*reader)
    assert 5 < len(frames) < 15
    assert reader.rejected == {"unreadable": 1}
    assert reader.problems[0].startswith(f"{path}: cannot be read: ")
    with pytest.raises(LogError, match=r"a\.csv: cannot be read"):
        list(LogReader([path], strict=True))


def test_messages_that_cannot_have_been_frames_are_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = message(FRAMES[0])
    wrong = [
        can.Message(timestamp=float("nan"), arbitration_id=1, is_extended_id=False),
        can.Message(timestamp=1.0, arbitration_id=0x800, is_extended_id=False),
        can.Message(timestamp=1.0, arbitration_id=1, is_extended_id=False, data=bytes(9)),
        can.Message(timestamp=1.0, arbitration_id=1, is_extended_id=False, data=bytes(3), dlc=4),
    ]

    class Reader(list[can.Message]):
        def __enter__(self) -> Reader:
            return self

        def __exit__(self, *details: object) -> None:
            pass

    monkeypatch.setattr(python_can_logs, "_open", lambda *_: Reader([good, *wrong, good]))
    (tmp_path / "a.trc").touch()
    reader = LogReader([tmp_path / "a.trc"])
    assert len(frames_of(*reader)) == 2
    assert reader.rejected == {"bad_timestamp": 1, "bad_id": 1, "too_long": 1, "bad_length": 1}
    assert reader.problems[0] == f"{tmp_path / 'a.trc'}: message 2: bad timestamp"


ONE_FRAME_LOGS = """
import numpy as np
from imucald.can.columns import FrameColumns

class FORMAT:
    endings = (".one",)

    @staticmethod
    def begins(head):
        return head.startswith(b"ONE")

    def __init__(self, filters, channels, statistics):
        self.filters, self.channels, self.statistics = filters, channels, statistics

    def read(self, path, report):
        index = self.channels.index("can7")
        if not self.filters.filter_of("can7").wanted(0x123):
            return
        self.statistics.frames_read += 1
        data = np.frombuffer(path.read_bytes(), np.uint8)[None]
        t, ids = np.array([1.5]), np.array([0x123], np.uint32)
        length, channel = np.array([8], np.uint8), np.array([index], np.uint8)
        yield FrameColumns(t, ids, length, data, channel, self.channels.names)
"""


def test_a_new_format_is_one_file_in_the_folder_of_logs(tmp_path, monkeypatch):
    (tmp_path / "one_frame_logs.py").write_text(ONE_FRAME_LOGS)
    monkeypatch.setattr(logs, "__path__", [*logs.__path__, str(tmp_path)])
    path = tmp_path / "a.one"
    path.write_bytes(bytes(range(8)))
    reader = LogReader([path], [IdMatch(0x123, 0x7FF)])
    (columns,) = reader
    assert (columns.t.tolist(), columns.data.tolist()) == ([1.5], [list(range(8))])
    assert reader.frames_read == 1
    assert list(LogReader([path], [IdMatch(0x124, 0x7FF)])) == []
    other = tmp_path / "a.log"
    other.write_bytes(b"ONE45678")
    assert [c.data.tobytes() for c in LogReader([other])] == [b"ONE45678"]


def test_what_python_can_leaves_out_is_rejected_and_no_line_on_the_screen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.trc"
    lines = [";$FILEVERSION=1.1", ";$STARTTIME=43008.9", " 1) 1.0 Rx 0300 1 00"]
    path.write_text("\n".join([*lines, " \033[2J) 1.5 Rx 0300", " 3) 2.0 Rx 0300 1 00", ""]))
    reader = LogReader([path])
    assert sum(map(len, reader)) == 2
    assert reader.rejected == {"left_out": 1}
    assert "Failed to parse message" in reader.problems[0]
    assert capsys.readouterr().err == ""
    with pytest.raises(LogError, match="Failed to parse message"):
        list(LogReader([path], strict=True))
