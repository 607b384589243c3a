from __future__ import annotations

import gzip
import random
import tracemalloc
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imucald.can.logs.candump_line import REASONS
from imucald.can.logs.log_reader import CAN_EFF_FLAG, LogReader
from imucald.core.errors import LogError
from log_text import Frame, frames_of, judged, text_of, without_damaged_stamps

LENIENT = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])

GOOD = [
    "(1600000000.000000) can0 200#1300E1FF2B130000",
    "(1600000000.000100) can0 18FEF1AA#1122334455667788",
    "(1600000000.000200) can0 7DF#",
    "(1600000000.000300) can1 123##1" + "A5" * 64,
    "(1600000000.000400) vcan0 18FEF1AA##5001122 R",
    "(1600000000.000500)  can0 5AA#0102 T",
    "(12.000600) can0 3E8#ABCDEF\r",
    "(1600000000.000700) can0 123#R8",
    "(1600000000.000800) can0 20000080#0000000000000000",
    "(1600000000.000900123) can0 123#1122334455667788_9",
]


def check_against_judge(path: Path, lines: list[bytes]) -> LogReader:
    """Hold the reader against the strict regular expression, line by line."""
    path.write_bytes(b"\n".join(lines) + b"\n")
    reader = LogReader([path])
    frames = frames_of(*reader)
    # A damaged line may hold a newline: what counts are the lines of the file.
    verdicts = [judged(line) for line in path.read_bytes().split(b"\n")]
    whole = [v for v in verdicts if isinstance(v, Frame)]
    believed = without_damaged_stamps(whole)
    assert frames == believed
    damaged = len(whole) - len(believed)  # rejected by their stamps
    assert reader.frames_read == sum(v is not None for v in verdicts) - damaged
    assert reader.ignored == Counter(f"{v}_frame" for v in verdicts if isinstance(v, str))
    blank = sum(not line.strip() for line in path.read_bytes().split(b"\n"))
    bad = sum(v is None for v in verdicts) - blank + damaged
    assert sum(reader.rejected.values()) == bad
    assert set(reader.rejected) <= set(REASONS)
    # Lines in a row that have nothing of a frame's are one problem.
    others = sum(n for reason, n in reader.rejected.items() if reason != "not_candump")
    assert min(20, others) <= len(reader.problems) <= min(20, sum(reader.rejected.values()))
    return reader


def mutated(line: bytes, rng: random.Random) -> bytes:
    """Cut, overwrite, insert, delete, swap or repeat something."""
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        at = rng.randrange(len(line) + 1)
        other = rng.randrange(len(line) + 1)
        byte = rng.choice([*b"0123456789ABCDEFabcdefgG#()._ RrT\0\r\t\n-+:xX,", rng.randrange(256)])
        line = rng.choice(
            [
                line[:at],
                line[at:],
                line[:at] + bytes([byte]) + line[at + 1 :],
                line[:at] + bytes([byte]) + line[at:],
                line[:at] + line[at + 1 :],
                line[: min(at, other)] + line[max(at, other) :],
                line[:at] + line[min(at, other) :],
                line[:at] + bytes([byte]) * rng.choice([2, 8, 200]) + line[at:],
            ]
        )
    return line


def test_two_thousand_damaged_lines_are_judged_as_the_grammar_says(tmp_path: Path) -> None:
    rng = random.Random(11)
    lines = [mutated(rng.choice(GOOD).encode(), rng) for _ in range(2000)]
    reader = check_against_judge(tmp_path / "a.log", lines)
    assert sum(reader.rejected.values()) > 1000
    # Each reason that a mutation can give is given.
    assert set(reader.rejected) >= set(REASONS) - {"cut_line", "line_too_long", "too_many_channels"}


@pytest.mark.parametrize("seed", range(12))
def test_a_few_damaged_lines_among_many_good_ones(tmp_path: Path, seed: int) -> None:
    # Few odd lines and many take different ways through the reader.
    rng = random.Random(seed)
    lines = [rng.choice(GOOD).encode() for _ in range(3000)]
    for _ in range([1, 3, 60, 70, 300][seed % 5]):
        lines.insert(rng.randrange(len(lines)), mutated(rng.choice(GOOD).encode(), rng))
    check_against_judge(tmp_path / "a.log", lines)


@pytest.mark.parametrize("line", GOOD)
def test_every_single_byte_of_a_line_is_checked(tmp_path: Path, line: str) -> None:
    text = line.encode()
    wrong = [
        text[:k] + bytes([byte]) + text[k + 1 :]
        for k in range(0, len(text))
        for byte in b"0g5Af#.( )R_\0\x12\xb5\r/:@`G"
    ]
    check_against_judge(tmp_path / "a.log", [text, *wrong, text])


@pytest.mark.slow
@pytest.mark.parametrize("line", GOOD)
def test_a_line_cut_anywhere_is_no_frame_unless_complete(tmp_path: Path, line: str) -> None:
    text = line.encode()
    check_against_judge(tmp_path / "a.log", [text[:k] for k in range(len(text))])
    for k in range(1, len(text)):
        (tmp_path / "b.log").write_bytes(text + b"\n" + text[:k])
        reader = LogReader([tmp_path / "b.log"])
        list(reader)
        if judged(text[:k]) is None:
            assert reader.rejected == {"cut_line": 1}
            assert reader.problems[0].startswith(f"{tmp_path / 'b.log'}:2: the line is cut: (")
            assert reader.frames_read == 1
        else:
            assert reader.rejected == {}
            assert reader.frames_read == 2


@LENIENT
@given(st.lists(st.binary(max_size=60), max_size=30), st.sampled_from(GOOD))
def test_any_bytes_are_taken(
    tmp_path_factory: pytest.TempPathFactory, lines: list[bytes], good: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "bytes.log"
    check_against_judge(path, [good.encode(), *lines, good.encode()])


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("can0  200   [8]  13 00 E1 FF 2B 13 00 00", "not_candump"),
        ("(1600000000) can0 200#13", "bad_timestamp"),
        ("(-1.0) can0 200#13", "negative_timestamp"),
        ("(1.5e3) can0 200#13", "bad_timestamp"),
        ("(nan) can0 200#13", "bad_timestamp"),
        ("(1.0 can0 200#13", "bad_timestamp"),
        ("(1.0)can0 200#13", "bad_timestamp"),
        ("(1.0) 200#13", "no_channel"),
        ("(1.0) 200#13 R", "no_channel"),
        ("(1.0) cän0 200#13", "bad_channel"),
        ("(1.0) " + "c" * 33 + " 200#13", "bad_channel"),
        ("(1.0) can0", "cut_line"),
        ("(1.0) can0 2", "cut_line"),
        ("(1.0) can0 200", "cut_line"),
        ("(1.0) can0 20#13", "bad_id"),
        ("(1.0) can0 0200#13", "bad_id"),
        ("(1.0) can0 800#13", "bad_id"),
        ("(1.0) can0 2G0#13", "bad_id"),
        ("(1.0) can0 40000000#13", "bad_id"),
        ("(1.0) can0 #13", "bad_id"),
        ("(1.0) can0 200#1G", "bad_hex"),
        ("(1.0) can0 200#11.22", "bad_hex"),
        ("(1.0) can0 200#131", "odd_digits"),
        ("(1.0) can0 200##0131", "odd_digits"),
        ("(1.0) can0 200##", "bad_frame"),
        ("(1.0) can0 200#112233445566778899", "too_long"),
        ("(1.0) can0 200##0" + "11" * 65, "too_long"),
        ("(1.0) can0 200#13 X", "trailing_text"),
        ("(1.0) can0 200#13 R R", "trailing_text"),
        ("(1.0) can0 200#13(2.0) can0 200#13", "trailing_text"),
        ("(1.0) can0 200#1\x003", "nul_bytes"),
        ("(1.0) can0 200#" + "11" * 2048, "line_too_long"),
    ],
)
def test_a_rejection_names_place_and_reason(tmp_path: Path, line: str, reason: str) -> None:
    path = tmp_path / "a.log"
    path.write_text(f"{GOOD[0]}\n{line}\n{GOOD[0]}\n")
    reader = LogReader([path])
    assert len(frames_of(*reader)) == 2
    assert reader.rejected == {reason: 1}
    assert reader.problems[0].startswith(f"{path}:2: {REASONS[reason]}: ")
    assert reader.problems[0].isprintable()
    with pytest.raises(LogError, match=r"a\.log:2: ") as caught:
        list(LogReader([path], strict=True))
    assert str(caught.value) == reader.problems[0]


def test_strict_reading_stops_at_the_first_of_all_bad_lines(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    # The second bad line is found in an earlier step of the reader than the first.
    path.write_text(f"{GOOD[0]}\n" * 500 + "(1600000000.000000) can0 200#1G\nbad\n")
    with pytest.raises(LogError, match=r"a\.log:501: the data contains"):
        list(LogReader([path], strict=True))


def test_line_numbers_go_on_over_blocks(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    good = [f"({1.6e9 + 1e-3 * k:.6f}) can0 123#1122\n" for k in range(100_000)]
    path.write_text("".join([*good[:50_000], "bad\n", *good[50_000:], "worse"]))
    reader = LogReader([path])
    assert sum(len(chunk) for chunk in reader) == 100_000
    assert [text.split(": ")[0] for text in reader.problems] == [f"{path}:50001", f"{path}:100002"]
    assert reader.rejected == {"not_candump": 1, "cut_line": 1}


def test_lines_longer_than_memory_should_hold_are_one_rejection(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    with path.open("wb") as file:
        file.write(GOOD[0].encode() + b"\n")
        for _ in range(40):
            file.write(b"1" * 1_000_000)
        file.write(b"\n" + GOOD[0].encode() + b"\n" + b"(1.0) can0 1" * 100_000)
    tracemalloc.start()
    reader = LogReader([path])
    frames = frames_of(*reader)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(frames) == 2
    assert reader.rejected == {"line_too_long": 1, "cut_line": 1}
    assert [text.split(": ")[0] for text in reader.problems] == [f"{path}:2", f"{path}:4"]
    assert peak < 30e6


def test_a_flood_of_channels_is_bounded(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("".join(f"(1.000000) x{k} 123#00\n" for k in range(400)))
    reader = LogReader([path])
    assert len(frames_of(*reader)) == 255
    assert reader.rejected == {"too_many_channels": 145}


def big_log(frames: int) -> bytes:
    rng = random.Random(5)
    lines = (
        text_of(
            f"{k}.{rng.randrange(10**6):06d}", Frame(0.0, 0x123, rng.randbytes(8), "can0", False)
        )
        for k in range(frames)
    )
    return ("\n".join(lines) + "\n").encode()


def test_what_was_read_before_a_compressed_file_is_cut_is_kept(tmp_path: Path) -> None:
    text = big_log(60_000)
    stored = gzip.compress(text, 1)
    path = tmp_path / "a.log.gz"
    path.write_bytes(stored[: len(stored) * 3 // 4])
    reader = LogReader([path])
    read = sum(len(chunk) for chunk in reader)
    assert 40_000 < read < 50_000
    assert reader.rejected == {"damaged_file": 1}
    assert reader.problems == [f"{path}:{read + 1}: reading ends here: the compressed file is cut"]
    with pytest.raises(LogError, match=rf":{read + 1}: reading ends here"):
        list(LogReader([path], strict=True))


@pytest.mark.slow
def test_a_cut_compressed_file_gives_no_cut_line_as_a_frame(tmp_path: Path) -> None:
    text = big_log(400)
    stored = gzip.compress(text)
    path = tmp_path / "a.log.gz"
    for end in range(len(stored) - 200, len(stored)):
        path.write_bytes(stored[:end])
        reader = LogReader([path])
        frames = frames_of(*reader)
        whole = [judged(line) for line in text.splitlines()[: len(frames)]]
        assert frames == whole
        assert reader.rejected == {"damaged_file": 1}


def test_damage_inside_a_compressed_file_is_reported(tmp_path: Path) -> None:
    stored = bytearray(gzip.compress(big_log(60_000), 1))
    stored[len(stored) // 2] ^= 0x55
    (tmp_path / "a.log.gz").write_bytes(stored)
    reader = LogReader([tmp_path / "a.log.gz"])
    list(reader)
    assert reader.rejected["damaged_file"] == 1
    assert reader.frames_read > 20_000


@pytest.mark.slow
@pytest.mark.parametrize("form", ["(%s) can0 123#%016X\n", " (%s)  can0  123   [8]  %s\n"])
@pytest.mark.parametrize("garbled", ["\1\2\3 no line\n", "9"])
def test_a_damaged_compressed_file_is_read_up_to_the_first_sign_of_it(
    tmp_path: Path, form: str, garbled: str
) -> None:
    # what a decompressor makes of damaged bytes: here a line that is none, or a stamp that is far
    # ahead, and all behind it damaged too, though it looks well
    lines = []
    for k in range(80_000):
        stamp = f"{1_600_000_000 + k // 1000}.{k % 1000:03d}000"
        data = k if "#" in form else k.to_bytes(8, "big").hex(" ").upper()
        lines.append(form % (stamp, data))
    at = 60_000
    lines[at] = garbled if garbled[-1] == "\n" else lines[at].replace("(16", "(96")
    path = tmp_path / "a.log.gz"
    stored = bytearray(gzip.compress("".join(lines).encode()))
    path.write_bytes(stored)
    whole = LogReader([path])
    assert sum(len(chunk) for chunk in whole) >= 79_999, "a sound file is read to its end"
    stored[-8] ^= 1  # the checksum
    path.write_bytes(stored)
    reader = LogReader([path])
    t = np.concatenate([chunk.t for chunk in reader])
    assert 59_900 <= len(t) <= at
    assert t.max() < 1_600_000_060.0
    assert reader.frames_read == len(t)
    assert reader.rejected == {"damaged_file": 1}
    (problem,) = reader.problems
    assert "reading ends here: " in problem
    assert "check" in problem, "the reason is the checksum"


@pytest.mark.parametrize(
    "stored",
    [b"\x1f\x8b", b"\x1f\x8bnot gzip at all", gzip.compress(b"a", mtime=0)[:12]],
    ids=["beginning", "other", "cut"],
)
def test_what_only_begins_like_gzip_is_an_error(tmp_path: Path, stored: bytes) -> None:
    (tmp_path / "a.log.gz").write_bytes(stored)
    with pytest.raises(
        LogError, match=r"a\.log\.gz: (cannot be read: |the format of this log is not known)"
    ):
        list(LogReader([tmp_path / "a.log.gz"]))


def test_an_extended_id_is_never_taken_for_a_standard_one(tmp_path: Path) -> None:
    path = tmp_path / "a.log"
    path.write_text("(1.000000) can0 00000123#00\n(1.000000) can0 123#00\n")
    assert [f.can_id for f in frames_of(*LogReader([path]))] == [0x123 | CAN_EFF_FLAG, 0x123]
