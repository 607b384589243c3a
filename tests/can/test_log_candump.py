from __future__ import annotations

import gzip
import io
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from imucald.can.logs import candump_line, candump_logs, text_blocks
from imucald.can.logs.log_reader import CAN_EFF_FLAG, IdMatch, LogReader
from imucald.can.python_can import can
from imucald.core import compiled
from imucald.core.errors import LogError
from log_text import Frame, frames_of, text_of, without_damaged_stamps

LENIENT = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

CHANNELS = ["can0", "can1", "vcan10", "c", "slcan_with_long_name", "ca", "ABCDEF12", "can0.5"]


def digits(least: int, most: int) -> st.SearchStrategy[str]:
    return st.integers(0, 10**most - 1).map(lambda n: str(n).rjust(least, "0"))


@st.composite
def written_frames(draw: st.DrawFn) -> tuple[str, Frame]:
    sizes = draw(st.sampled_from([(10, 6), (10, 6), (10, 9), (1, 6), (4, 6), (12, 1), (9, 9)]))
    stamp = ".".join(draw(digits(size, size)) for size in sizes)
    fd = draw(st.booleans())
    extended = draw(st.booleans())
    can_id = draw(st.integers(0, 0x1FFF_FFFF if extended else 0x7FF))
    frame = Frame(
        float(stamp),
        can_id + (CAN_EFF_FLAG if extended else 0),
        draw(st.binary(max_size=64 if fd else 8)),
        draw(st.sampled_from(CHANNELS)),
        fd,
    )
    gap = draw(st.sampled_from([1, 1, 1, 2, 5]))
    tail = draw(st.sampled_from(["", "", "", " R", " T", "\r", " R\r"]))
    line = text_of(stamp, frame, gap, tail, flags=draw(st.integers(0, 15)))
    return draw(st.sampled_from([line, line, line.replace("A", "a").replace("F", "f")])), frame


def read(path: Path, text: bytes | str, keep: list[IdMatch] | None = None) -> list[Frame]:
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    reader = LogReader([path], keep, strict=True)
    return frames_of(*reader)


@pytest.mark.slow
@LENIENT
@given(st.lists(written_frames(), max_size=25))
def test_any_mixture_of_frames_is_read_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, written: list[tuple[str, Frame]]
) -> None:
    path = tmp_path_factory.getbasetemp() / "mixture.log"
    # A channel in another case is another channel.
    frames = [f._replace(channel=line.split()[1]) for line, f in written]
    assume(without_damaged_stamps(frames) == frames)
    assert read(path, "".join(line + "\n" for line, _ in written)) == frames
    assert read(path, "\n".join(line for line, _ in written)) == frames


@pytest.mark.slow
@LENIENT
@given(
    st.lists(written_frames(), max_size=30),
    st.lists(
        st.builds(
            lambda can_id, extended, mask, channel: IdMatch(
                can_id + CAN_EFF_FLAG if extended else can_id & 0x7FF, mask, channel
            ),
            st.integers(0, 0x1FFF_FFFF),
            st.booleans(),
            st.sampled_from([0, 0x7FF, 0x1FFF_FFFF, 0x3FF_FF00, 0x700, 0xFFFF_FFFF]),
            st.sampled_from([None, *CHANNELS]),
        ),
        max_size=4,
    ),
)
def test_filters_keep_what_a_kernel_filter_keeps(
    tmp_path_factory: pytest.TempPathFactory,
    written: list[tuple[str, Frame]],
    keep: list[IdMatch],
) -> None:
    frames = [f._replace(channel=line.split()[1]) for line, f in written]
    keep += [IdMatch(f.can_id, 0x1FFF_FFFF, None) for f in frames[::7]]

    def wanted(frame: Frame) -> bool:
        return any(
            (frame.can_id >= CAN_EFF_FLAG) == (m.can_id >= CAN_EFF_FLAG)
            and frame.can_id % CAN_EFF_FLAG & m.mask == m.can_id % CAN_EFF_FLAG & m.mask
            and m.channel in (None, frame.channel)
            for m in keep
        )

    path = tmp_path_factory.getbasetemp() / "filtered.log"
    path.write_text("".join(line + "\n" for line, _ in written), newline="")
    reader = LogReader([path], keep)
    asked = [f for f in frames if wanted(f)]
    assume(without_damaged_stamps(asked) == asked)
    assert frames_of(*reader) == asked
    assert reader.frames_read == len(frames)
    assert reader.rejected == {}


@LENIENT
@given(
    st.lists(
        st.tuples(digits(1, 19), digits(1, 19)).map(".".join)
        | st.integers(0, 2**53).map(lambda n: f"{n // 10**6}.{n % 10**6:06d}")
        | st.integers(2**52, 2**63).map(lambda n: f"{n // 10**9}.{n % 10**9:09d}"),
        min_size=1,
        max_size=50,
    )
)
def test_times_are_the_doubles_nearest_to_their_text(
    tmp_path_factory: pytest.TempPathFactory, stamps: list[str]
) -> None:
    path = tmp_path_factory.getbasetemp() / "times.log"
    twice = [stamp for stamp in stamps for _ in range(2)]  # a single jump would be a damaged stamp
    path.write_text("".join(f"({stamp}) can0 123#00\n" for stamp in twice))
    (chunk,) = LogReader([path])
    assert chunk.t.tolist() == [float(stamp) for stamp in twice]


def test_a_long_recording_keeps_every_time_to_the_last_bit(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    micros = 1_600_000_000_000_000 + np.cumsum(rng.integers(1, 900, 50_000))
    stamps = [f"{m // 10**6}.{m % 10**6:06d}" for m in micros.tolist()]
    frames = read(tmp_path / "a.log", "".join(f"({stamp}) can0 123#00\n" for stamp in stamps))
    assert [f.t for f in frames] == [float(stamp) for stamp in stamps]


@pytest.fixture(scope="module")
def mixed_log(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[Frame]]:
    """A log of all sorts, about 13 kB, with its frames by python-can's own reader."""
    rng = np.random.default_rng(3)
    lines = []
    for k in range(220):
        fd, extended = bool(rng.random() < 0.2), bool(rng.random() < 0.3)
        size = int(rng.choice([0, 1, 8, 12, 64] if fd else [0, 3, 8, 8, 8]))
        can_id = (
            int(rng.integers(0x1FFF_FFFF)) + CAN_EFF_FLAG if extended else int(rng.integers(2048))
        )
        frame = Frame(0.0, can_id, rng.bytes(size), f"can{rng.integers(3)}", fd)
        lines.append(text_of(f"{k * 3}.{k * 37:06d}", frame, tail=" R" if k % 5 == 0 else ""))
    text = ("\n".join(lines) + "\n").encode()
    path = tmp_path_factory.mktemp("mixed") / "mixed.log"
    path.write_bytes(text)
    frames = [
        Frame(
            m.timestamp,
            m.arbitration_id + (CAN_EFF_FLAG if m.is_extended_id else 0),
            bytes(m.data),
            str(m.channel),
            m.is_fd,
        )
        for m in can.CanutilsLogReader(path)
    ]
    assert len(frames) == 220
    return text, frames


def test_reads_what_python_can_reads(tmp_path: Path, mixed_log: tuple[bytes, list[Frame]]) -> None:
    text, frames = mixed_log
    assert read(tmp_path / "a.log", text) == frames


@pytest.mark.slow
def test_a_block_may_end_at_any_place_in_a_line(
    tmp_path: Path, mixed_log: tuple[bytes, list[Frame]], monkeypatch: pytest.MonkeyPatch
) -> None:
    text, frames = mixed_log
    for extra in range(200):
        monkeypatch.setattr(text_blocks, "BLOCK_BYTES", 5000 + extra)
        assert read(tmp_path / "a.log", text) == frames


@pytest.mark.slow
def test_a_file_may_end_at_any_place_in_a_block(
    tmp_path: Path, mixed_log: tuple[bytes, list[Frame]], monkeypatch: pytest.MonkeyPatch
) -> None:
    text, frames = mixed_log
    monkeypatch.setattr(text_blocks, "BLOCK_BYTES", 5000)
    for end in [*range(4900, 5100), 10_000]:
        (tmp_path / "a.log").write_bytes(text[:end])
        got = frames_of(*LogReader([tmp_path / "a.log"]))
        whole = text[:end].count(b"\n")
        assert got[:whole] == frames[:whole]
        # The last line may be complete but for its newline, or look so after losing whole bytes.
        assert len(got) - whole in (0, 1)


def test_gzip_is_known_by_its_first_bytes_and_may_have_members(
    tmp_path: Path, mixed_log: tuple[bytes, list[Frame]]
) -> None:
    text, frames = mixed_log
    members = gzip.compress(text[:3333]) + gzip.compress(b"") + gzip.compress(text[3333:])
    assert read(tmp_path / "a.log.gz", members + bytes(512)) == frames
    assert read(tmp_path / "no_ending", members) == frames


def test_standard_input_is_read_plain_and_gzip(
    mixed_log: tuple[bytes, list[Frame]], monkeypatch: pytest.MonkeyPatch
) -> None:
    text, frames = mixed_log
    for stored in (text, gzip.compress(text)):
        monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=io.BytesIO(stored)))
        reader = LogReader(["-"])
        assert frames_of(*reader) == frames
        assert reader.rejected == {}


def test_a_pipe_that_delivers_piece_by_piece_is_read_whole() -> None:
    program = (
        "from imucald.can.logs.log_reader import LogReader\n"
        "reader = LogReader(['-'], strict=True)\n"
        "print(sum(len(chunk) for chunk in reader), reader.frames_read)\n"
    )
    lines = "".join(f"({k}.000000) can0 123#{k % 256:02X}\n" for k in range(9000)).encode()
    child = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert child.stdin is not None
    for start in range(0, len(lines), 50_001):
        child.stdin.write(lines[start : start + 50_001])
        child.stdin.flush()
    out, _ = child.communicate()
    assert out.split() == [b"9000", b"9000"]


def test_several_logs_are_one_recording_in_the_given_order(tmp_path: Path) -> None:
    for name in ("a.log", "c.log"):
        (tmp_path / name).write_text("(100.000000) can1 123#01\n(101.000000) can0 123#02\n")
    (tmp_path / "b.log.gz").write_bytes(gzip.compress(b"(5.000000) can2 123#03\nbad\n"))
    done: list[tuple[int, int | None]] = []
    reader = LogReader(
        [tmp_path / "a.log", tmp_path / "b.log.gz", tmp_path / "c.log"],
        progress=lambda *numbers: done.append(numbers),
    )
    chunks = list(reader)
    assert [f.t for f in frames_of(*chunks)] == [100.0, 101.0, 5.0, 100.0, 101.0]
    assert [f.channel for f in frames_of(*chunks)] == ["can1", "can0", "can2", "can1", "can0"]
    assert [chunk.channels[:2] for chunk in chunks] == [("can1", "can0")] * 3
    assert reader.problems == [f"{tmp_path / 'b.log.gz'}:2: {reader.problems[0].split(': ', 1)[1]}"]
    total = 2 * (tmp_path / "a.log").stat().st_size + (tmp_path / "b.log.gz").stat().st_size
    assert done[-1] == (total, total)
    assert [numbers[0] for numbers in done] == sorted(numbers[0] for numbers in done)
    assert len(list(reader)) == 3
    assert reader.frames_read == 5


def test_frames_without_data_are_counted_but_not_passed_on(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text(
        "(1.000000) can0 123#R\n(1.100000) can0 123#R4\n(1.200000) can0 00000123#r8_F R\n"
        "(1.300000)  can0 20000080#0000000000000000\n(1.4) can0 3FFFFFFF#\n"
        "(1.500000) can0 00123#81:00:12345678#1122\n\n   \n(1.600000) can0 123#1122334455667788_9\n"
    )
    reader = LogReader([path], strict=True)
    (frame,) = frames_of(*reader)
    assert frame == Frame(1.6, 0x123, bytes.fromhex("1122334455667788"), "can0", False)
    assert reader.frames_read == 7
    assert reader.ignored == {"remote_frame": 3, "error_frame": 2, "xl_frame": 1}


def test_columns_are_as_narrow_as_the_data_and_typed(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("(1.000000) can0 123##1AABB\n(2.000000) can0 123#\n")
    (chunk,) = LogReader([path])
    assert chunk.data.shape == (2, 8)
    assert [a.dtype for a in (chunk.t, chunk.can_id, chunk.length, chunk.data, chunk.channel)] == [
        np.dtype(name) for name in ("f8", "u4", "u1", "u1", "u1")
    ]
    assert chunk.fd is not None
    assert chunk.fd.tolist() == [True, False]
    path.write_text("(1.000000) can0 123#AABB\n(2.000000) can0 123##0" + "77" * 9 + "\n")
    (chunk,) = LogReader([path])
    assert chunk.data.shape == (2, 64)
    assert list(LogReader([path], [IdMatch(0x124, 0x7FF)])) == []


def test_many_frames_come_in_chunks_of_bounded_size(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("".join(f"({k}.000000) can0 123#\n" for k in range(200_000)))
    sizes = [len(chunk) for chunk in LogReader([path])]
    assert sum(sizes) == 200_000
    assert max(sizes) < 80_000
    assert min(sizes[:-1]) > 10_000


def test_many_channels_and_forms_are_read(tmp_path: Path) -> None:
    names = [f"can{k}" for k in range(60)]
    lines = [
        f"({10**s}.{'1' * (k % 9 + 1)}) {names[k]} {k:03X}#{k:02X}"
        for s in range(10)
        for k in range(60)
    ]
    frames = read(tmp_path / "a.log", "\n".join(lines * 3) + "\n")
    assert len(frames) == 1800
    assert [f.channel for f in frames[:60]] == names
    assert all(f.channel == f"can{f.can_id}" for f in frames)
    assert [f.t for f in frames[:600]] == [float(line[1:].split(")")[0]) for line in lines]


@pytest.mark.skipif(compiled.kernels is None, reason=f"kernels: {compiled.state}")
@pytest.mark.parametrize("tail", ["", " R", "\r"])
def test_lines_of_common_forms_are_not_read_one_by_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, tail: str
) -> None:
    # The reader of single lines is a hundred times slower; it is for what is odd.
    singly: list[bytes] = []

    def counted(text: bytes) -> candump_line.Line | str | None:
        singly.append(text)
        return candump_line.parse_line(text)

    monkeypatch.setattr(candump_logs, "parse_line", counted)
    rng = np.random.default_rng(4)
    forms = [(3, "#", 8), (3, "#", 0), (8, "#", 5), (3, "##1", 64), (8, "##0", 12)]
    lines = []
    for k in range(3000):
        width, mark, size = forms[k % 5]
        number = f"{rng.integers(0x7FF):0{width}X}"
        channel = ("can0", "vcan10")[k % 2]
        data = rng.bytes(size).hex().upper()
        lines.append(f"(16000{k:05d}.000100) {channel} {number}{mark}{data}{tail}\n")
    assert len(read(tmp_path / "a.log", "".join(lines))) == 3000
    assert len(singly) == 3  # one for each head, and one for when the log begins


@pytest.mark.parametrize("name", ["absent.log", "."])
def test_a_file_that_cannot_be_opened_is_named(tmp_path: Path, name: str) -> None:
    with pytest.raises(LogError, match=r"absent\.log|is a folder"):
        list(LogReader([tmp_path / name]))


def test_an_empty_file_has_no_frames(tmp_path: Path) -> None:
    assert read(tmp_path / "a.log", b"") == []
    assert read(tmp_path / "a.log.gz", gzip.compress(b"")) == []
