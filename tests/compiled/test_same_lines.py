"""Candump text of any kind: the compiled part reads what the strict reader of lines reads."""

from __future__ import annotations

import random
import time
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recorded_calls import needs_kernels

from both_ways import assert_same
from imucald.can.columns import CAN_EFF_FLAG, IdMatch
from imucald.can.logs import text_blocks
from imucald.can.logs.log_reader import LogReader
from imucald.core import compiled
from imucald.core.errors import LogError
from log_text import frames_of

pytestmark = [needs_kernels, pytest.mark.slow]

MANY = settings(max_examples=250, deadline=None, suppress_health_check=list(HealthCheck))
KEEP = [
    None,
    [IdMatch(0x123, 0x7FF), IdMatch(0x1ABCDE + CAN_EFF_FLAG, 0x1FFFFFFF)],
    [IdMatch(0x100, 0x700, "can0"), IdMatch(0x7F0, 0x7F0, "vcan1")],
]
ODD = [
    "",
    "(",
    "()",
    "#",
    "(1.0) can0 123#",
    "(16.5) can0 12#00",
    "(1.0) can0 123#0",
    "hello",
    "(1600000000.000001) can0 123#R",
    "(1600000000.000001) can0 123##",
    "\x00" * 30,
    "\r",
]


def line(draw: random.Random, stamp: int) -> str:
    """A line of a log, sound or not."""
    if draw.random() < 0.05:
        return draw.choice(ODD)
    digits = draw.choice([6, 6, 6, 6, 6, 9, 3, 1])
    text = f"({stamp // 10**6}.{str(stamp % 10**6).rjust(6, '0').ljust(digits, '0')[:digits]})"
    text += " " * draw.choice([1, 1, 1, 1, 2, 40])
    text += draw.choice(["can0"] * 6 + ["vcan1", "c", "a_long_name_of_a_channel", "can0"]) + " "
    can_id = draw.choice([0x123, 0x7F1, 0x001, draw.randrange(0x800)])
    text += f"{draw.randrange(2**29):08X}" if draw.random() < 0.15 else f"{can_id:03X}"
    is_fd = draw.random() < 0.05
    text += f"##{draw.randrange(16):X}" if is_fd else "#"
    text += draw.randbytes(draw.choice([8, 8, 8, 8, 2, 0, 5, 48 if is_fd else 8])).hex().upper()
    text += draw.choice([""] * 12 + [" R", " T", "\r", "0", "zz", " "])
    if draw.random() < 0.05:  # a byte of it is another one
        at = draw.randrange(len(text))
        text = text[:at] + chr(draw.randrange(256)) + text[at + 1 :]
    return text


def read(path: Path, keep: list[IdMatch] | None) -> object:
    reader = LogReader([path], keep)
    try:
        frames = frames_of(*reader)
    except LogError as error:
        return str(error)
    return frames, reader.frames_read, reader.rejected, reader.problems, reader.ignored


@MANY
@given(st.integers(0, 2**32), st.integers(0, 120))
def test_lines_sound_and_odd(
    tmp_path_factory: pytest.TempPathFactory, seed: int, count: int
) -> None:
    draw = random.Random(seed)
    stamp, lines = draw.choice([1_600_000_000_000_000, 5_000_000, 99_999_990]), []
    for _ in range(count):
        stamp += draw.choice([0, 1, 240, 990_000, 3_000_000, -1])
        lines.append(line(draw, stamp))
    text = draw.choice(["\n", "\n", "\r\n"]).join(lines) + draw.choice(["", "\n"])
    path = tmp_path_factory.getbasetemp() / "lines.log"
    path.write_bytes(text.encode("latin-1"))
    for keep in KEEP:
        with pytest.MonkeyPatch.context() as patched:
            patched.setattr(text_blocks, "BLOCK_BYTES", draw.choice([1 << 20, 5000, 9000]))
            found = read(path, keep)
            with compiled.left_out():
                assert_same(found, read(path, keep), "log")


@MANY
@given(st.binary(max_size=600))
def test_any_bytes_behind_a_line(tmp_path_factory: pytest.TempPathFactory, rest: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "bytes.log"
    path.write_bytes(b"(1600000000.000001) can0 123#0102030405060708\n" * 2 + rest)
    found = read(path, None)
    with compiled.left_out():
        assert_same(found, read(path, None), "log")


def strange(path: Path, count: int) -> Path:
    """A log of lines that are none, each of a channel that is not known."""
    sound = b"(1600000000.000001) can0 123#0102030405060708\n"
    path.write_bytes(sound + b"(1.0) zz xxx\n" * count)
    return path


def test_lines_of_unknown_channels_take_little_memory(tmp_path: Path) -> None:
    path = strange(tmp_path / "strange.log", 4000)
    tracemalloc.start()
    try:
        read(path, None)
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_lines_of_unknown_channels_take_time_by_their_number(tmp_path: Path) -> None:
    path = strange(tmp_path / "strange.log", 70_000)
    began = time.process_time()
    read(path, None)
    assert time.process_time() - began < 5.0  # the square of their number took 15
