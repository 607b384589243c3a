from __future__ import annotations

import gzip
import io
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from full_disk import full_after
from imucald.can.columns import concatenate
from imucald.can.logs.frame_batches import columns_of_frames
from imucald.can.logs.log_reader import CAN_EFF_FLAG, CandumpWriter, FrameColumns, LogReader
from imucald.can.python_can import can
from imucald.core.errors import LogError
from log_text import Frame, frames_of, text_of, without_damaged_stamps

LENIENT = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
CHANNELS = ("can0", "can1", "vcan10")


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    fd = draw(st.booleans())
    extended = draw(st.booleans())
    return Frame(
        draw(st.integers(0, 2**32 * 10**6 - 1)) / 1e6,
        draw(st.integers(0, 0x1FFF_FFFF)) + CAN_EFF_FLAG
        if extended
        else draw(st.integers(0, 0x7FF)),
        draw(st.binary(max_size=64 if fd else 8)),
        draw(st.sampled_from(CHANNELS)),
        fd,
    )


def columns(written: list[Frame]) -> FrameColumns:
    data = np.zeros((len(written), 64), np.uint8)
    for k, frame in enumerate(written):
        data[k, : len(frame.data)] = list(frame.data)
    return FrameColumns(
        np.array([f.t for f in written]),
        np.array([f.can_id for f in written], np.uint32),
        np.array([len(f.data) for f in written], np.uint8),
        data,
        np.array([CHANNELS.index(f.channel) for f in written], np.uint8),
        CHANNELS,
        np.array([f.fd for f in written], np.bool_),
    )


def stamp(t: float) -> str:
    return f"{t:017.6f}"


@pytest.mark.slow
@LENIENT
@given(st.lists(frames(), max_size=20))
def test_frames_are_read_back_as_they_were_written(
    tmp_path_factory: pytest.TempPathFactory, written: list[Frame]
) -> None:
    assume(without_damaged_stamps(written) == written)
    path = tmp_path_factory.getbasetemp() / "back.log"
    with CandumpWriter(path) as writer:
        writer.write_columns(columns(written))
    assert frames_of(*LogReader([path], strict=True)) == written
    assert writer.frames_written == len(written)
    expected = [text_of(stamp(f.t), f, flags=1) for f in written]
    assert path.read_text().splitlines() == expected


def one(t: float, can_id: int = 1, data: bytes = b"", channel: str = "can0") -> FrameColumns:
    """One frame, whose length alone says whether it is CAN FD."""
    whole = columns_of_frames([(t, can_id, data, 0, False)], (channel,))
    return replace(whole, fd=None)


@LENIENT
@given(st.lists(st.floats(0, 2**32 - 1), min_size=1, max_size=20))
def test_any_time_is_written_to_the_nearest_microsecond(
    tmp_path_factory: pytest.TempPathFactory, times: list[float]
) -> None:
    path = tmp_path_factory.getbasetemp() / "time.log"
    with CandumpWriter(path) as writer:
        writer.write_columns(columns([Frame(t, 1, b"", "can0", False) for t in times]))
    for line, t in zip(path.read_text().splitlines(), times, strict=True):
        # Half a microsecond, and what t and t * 1e6 are rounded by.
        assert abs(float(line[1:18]) - t) <= 0.5e-6 + 2 * np.spacing(t)


def test_recorded_stamps_survive_many_frames(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    count = 100_000
    micros = 1_600_000_000_000_000 + np.cumsum(rng.integers(0, 5000, count))
    written = FrameColumns(
        micros / 1e6,
        rng.choice(np.array([0x3E8, 0x3E9, CAN_EFF_FLAG | 0x18FF0001], np.uint32), count),
        np.full(count, 8, np.uint8),
        rng.integers(0, 256, (count, 8), dtype=np.uint8),
        rng.integers(0, 2, count).astype(np.uint8),
        ("can0", "can1"),
    )
    with CandumpWriter(tmp_path / "a.log.gz") as writer:
        writer.write_columns(written)
    with gzip.open(tmp_path / "a.log.gz", "rt") as file:
        assert file.readline().startswith(
            f"({1600000000 + (micros[0] - 1600000000000000) / 1e6:.6f})"
        )
    back = concatenate(list(LogReader([tmp_path / "a.log.gz"], strict=True)))
    assert back.fd is None
    assert back.data.shape == (count, 8)
    names = np.array(back.channels)[back.channel]
    assert (names == np.array(written.channels)[written.channel]).all()
    for name in ("t", "can_id", "length", "data"):
        assert np.array_equal(getattr(back, name), getattr(written, name)), name


def test_without_a_format_long_frames_are_can_fd(tmp_path: Path) -> None:
    some = columns([Frame(1.0, 5, bytes(9), "can0", True), Frame(1.0, 5, bytes(8), "can0", True)])
    plain = FrameColumns(some.t, some.can_id, some.length, some.data, some.channel, some.channels)
    with CandumpWriter(tmp_path / "a.log") as writer:
        writer.write_columns(plain)
    marks = [line.count("#") for line in (tmp_path / "a.log").read_text().splitlines()]
    assert marks == [2, 1]


def test_python_can_reads_what_is_written(tmp_path: Path) -> None:
    written = [
        Frame(1600000000.25, 0x3E8, bytes(range(8)), "can0", False),
        Frame(1600000001.5, CAN_EFF_FLAG | 0x18FEF1AA, b"", "can1", False),
        Frame(1600000002.75, 0x7FF, bytes(range(64)), "can1", True),
    ]
    with CandumpWriter(tmp_path / "a.log") as writer:
        writer.write_columns(columns(written))
    messages = list(can.CanutilsLogReader(tmp_path / "a.log"))
    assert [
        Frame(
            m.timestamp,
            m.arbitration_id + (CAN_EFF_FLAG if m.is_extended_id else 0),
            bytes(m.data),
            str(m.channel),
            m.is_fd,
        )
        for m in messages
    ] == written
    assert messages[2].bitrate_switch


def test_can_utils_reads_what_is_written(tmp_path: Path) -> None:
    log2asc = shutil.which("log2asc")
    if log2asc is None:
        pytest.skip("can-utils (log2asc) is not installed")
    with CandumpWriter(tmp_path / "a.log") as writer:
        writer.write_columns(one(12.345678, 0x3E8, bytes.fromhex("1122AA")))
        writer.write_columns(one(12.5, CAN_EFF_FLAG | 0x18FEF1AA, bytes(range(64))))
    out = subprocess.run(
        [log2asc, "-I", tmp_path / "a.log", "can0"], capture_output=True, text=True, check=True
    ).stdout
    assert "3E8" in out
    assert "11 22 AA" in out
    assert "18FEF1AA" in out.upper()
    assert bytes(range(64)).hex(" ").upper() in out.upper()


def test_standard_output_stays_open() -> None:
    program = (
        "from imucald.can.logs.frame_batches import columns_of_frames\n"
        "from imucald.can.logs.log_reader import CandumpWriter\n"
        "with CandumpWriter('-') as writer:\n"
        "    frame = 1.5, 0x123, b'\\x01', 0, False\n"
        "    writer.write_columns(columns_of_frames([frame], ('can0',)))\n"
        "print('after')\n"
    )
    out = subprocess.run([sys.executable, "-c", program], capture_output=True, check=True).stdout
    assert out.split(b"\n")[:2] == [b"(0000000001.500000) can0 123#01", b"after"]


def test_a_log_is_written_where_standard_output_has_no_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "stdout", io.StringIO())  # as in a notebook
    with CandumpWriter(tmp_path / "a.log") as writer:
        writer.write_columns(one(1.0, 0x123))
    assert (tmp_path / "a.log").read_bytes() == b"(0000000001.000000) can0 123#\n"


@pytest.mark.parametrize(
    "frame",
    [
        Frame(-1.0, 1, b"", "can0", False),
        Frame(float("nan"), 1, b"", "can0", False),
        Frame(float("inf"), 1, b"", "can0", False),
        Frame(2.0**32, 1, b"", "can0", False),
        Frame(1.0, 0x800, b"", "can0", False),
        Frame(1.0, CAN_EFF_FLAG | 0x2000_0000, b"", "can0", False),
        Frame(1.0, 1, bytes(9), "can0", False),
    ],
)
def test_what_is_no_frame_is_not_written(tmp_path: Path, frame: Frame) -> None:
    no_frame = pytest.raises(LogError, match=r"a\.log: a CAN frame cannot")
    with CandumpWriter(tmp_path / "a.log") as writer, no_frame:
        writer.write_columns(columns([Frame(1.0, 1, b"", "can0", False), frame]))
    assert (tmp_path / "a.log").read_bytes() == b""


def test_channel_names_of_other_formats_become_one_word(tmp_path: Path) -> None:
    with CandumpWriter(tmp_path / "a.log") as writer:
        writer.write_columns(one(1.0, channel="CAN 1 #ä"))
        writer.write_columns(one(1.0, channel=""))
    channels = [f.channel for f in frames_of(*LogReader([tmp_path / "a.log"], strict=True))]
    assert channels == ["CAN_1___", "can0"]


@pytest.mark.parametrize("name", ["a.log", "a.log.gz"])
@pytest.mark.parametrize("frames", [1, 100_000])
def test_a_log_that_does_not_fit_on_the_disk_is_removed(
    tmp_path: Path, name: str, frames: int
) -> None:
    (tmp_path / "target.log").write_text("old")
    (tmp_path / "link.log").symlink_to(tmp_path / "target.log")
    noise = np.random.default_rng(3).bytes(8 * frames)
    some = [Frame(1.0, 1, noise[8 * k : 8 * k + 8], "can0", False) for k in range(frames)]
    block = columns(some)
    for place in (tmp_path / name, tmp_path / "link.log"):
        with (
            full_after(0 if frames == 1 else 300_000),
            pytest.raises(LogError, match=rf"{place.name}: cannot be written: File too large"),
            CandumpWriter(place) as writer,
        ):
            writer.write_columns(block)
    # of a link, nothing is removed that somebody else made
    assert {p.name for p in tmp_path.iterdir()} == {"link.log", "target.log"}


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"nowhere.*cannot be written: No such file"):
        CandumpWriter(tmp_path / "nowhere" / "a.log")
    if Path("/dev/full").exists():
        with (
            pytest.raises(LogError, match="/dev/full: cannot be written: No space"),
            CandumpWriter("/dev/full") as writer,
        ):
            writer.write_columns(one(1.0))
