"""Whatever people have recorded is read, known by its first bytes; what cannot be used says why.

tests/data/candump holds what candump (can-utils 2020.11) printed of the same frames in each of its
forms, all at once on one virtual interface.
"""

from __future__ import annotations

import bz2
import contextlib
import gzip
import io
import json
import lzma
import os
import re
import struct
import threading
from pathlib import Path

import pytest

from imucald import cli
from imucald.can.logs.log_reader import CAN_EFF_FLAG, IdMatch, LogReader
from imucald.can.python_can import can
from imucald.core import compiled
from imucald.core.errors import LogError
from log_text import Frame, frames_of
from paths import ROOT

FORMS = ROOT / "tests" / "data" / "candump"
WITH_STAMPS = ["ta", "td", "tz", "tA", "tax", "tza", "tac", "taccc", "taS", "tai"]
WITHOUT_STAMPS = ["plain", "x", "ascii"]


def log_file() -> list[Frame]:
    """The frames as candump -L wrote them."""
    return frames_of(*LogReader([FORMS / "L.txt"], strict=True))


@pytest.mark.parametrize("form", WITH_STAMPS)
def test_every_form_of_candump_gives_the_frames_of_its_log_file(form: str) -> None:
    expected = log_file()
    reader = LogReader([FORMS / f"{form}.txt"], strict=True)
    found = frames_of(*reader)
    assert [f._replace(t=0.0) for f in found] == [f._replace(t=0.0) for f in expected]
    start = found[0].t - expected[0].t if form in ("td", "tz", "tza") else 0.0
    assert [f.t - start for f in found] == pytest.approx([f.t for f in expected], abs=2e-6)
    assert reader.ignored == {"remote_frame": 4}


@pytest.mark.parametrize(
    ("printed", "data"),
    [
        ("[3]  7B C5 65", "7BC565"),
        ("[3]  7B C5 65   '{.e'", "7BC565"),
        ("[3]  7B  C5 65", "7BC565"),
        ("[3]  7b c5 65", "7BC565"),
        ("[3]  65`C5`7B", "7BC565"),
        ("[0] ", ""),
        ("[12]  01 02 03 04 05 06 07 08 09 0A 0B 0C", "0102030405060708090A0B0C"),
        ("[3]  7B C5", None),
        ("[3]  7B C5 6", None),
        ("[3]  7B C5 65A", None),
        ("[3]  7B C5 6G", None),
        ("[3]  7B \t\t 65", None),
        ("[3]  7BC565", None),
        ("[9]  01 02 03 04 05 06 07 08 09", None),
    ],
)
def test_bytes_are_those_that_are_printed_or_the_line_is_refused(
    printed: str, data: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "one.txt"
    good = " (1.000000)  can0  123   [1]  2A\n"
    path.write_text(f"{good} (2.000000)  can0  123   {printed}\n (3.000000)  can0{good[17:]}")
    reader = LogReader([path])
    found = [f.data.hex().upper() for f in frames_of(*reader)]
    assert found == ["2A", *([] if data is None else [data]), "2A"]
    assert reader.rejected == ({} if data is not None else {"bad_hex": 1})


def test_several_interfaces_keep_their_names() -> None:
    found = frames_of(*LogReader([FORMS / "taany.txt"]))
    assert {f.channel for f in found} == {"vcan0", "vcan1"}


@pytest.mark.parametrize("form", WITHOUT_STAMPS)
def test_without_time_stamps_time_is_counted_from_a_message_of_known_cycle(form: str) -> None:
    cycles = [(IdMatch(0x201, 0x7FF), 0.5), (IdMatch(0x044, 0x7FF), 0.01)]
    reader = LogReader([FORMS / f"{form}.txt"], cycles=cycles)
    found = frames_of(*reader)
    expected = log_file()
    assert [f._replace(t=0.0) for f in found] == [f._replace(t=0.0) for f in expected]
    times = [f.t for f in found if f.can_id == 0x044]
    assert times == pytest.approx([0.01, 0.02])
    between = [f.t for f in found[1 : [f.can_id for f in found].index(0x044, 1)]]
    assert between == sorted(between)
    assert 0.01 < between[0] < between[-1] < 0.02
    (note,) = reader.problems
    assert "id 0x44, which should come every 10 ms" in note
    assert "candump -l can0" in note
    with pytest.raises(LogError, match=r"no time stamps.*with --strict, such a log is refused"):
        list(LogReader([FORMS / f"{form}.txt"], strict=True, cycles=cycles))


@pytest.mark.parametrize("form", WITHOUT_STAMPS)
def test_frames_that_nothing_gives_a_time_are_refused_with_the_remedy(form: str) -> None:
    for cycles in ([], [(IdMatch(0x555, 0x7FF), 0.01)]):
        with pytest.raises(LogError, match=r"no time stamps.*candump -l can0"):
            list(LogReader([FORMS / f"{form}.txt"], cycles=cycles))


def test_frames_as_cansend_takes_them_are_read_in_the_same_way(tmp_path: Path) -> None:
    path = tmp_path / "frames.txt"
    path.write_text("123#DEADBEEF\n00000123#R\n200##111223344\n123#00\nnonsense\n")
    with pytest.raises(LogError, match="candump -l can0"):
        list(LogReader([path]))
    reader = LogReader([path], cycles=[(IdMatch(0x123, 0x7FF), 0.02)])
    assert frames_of(*reader) == [
        Frame(pytest.approx(0.02), 0x123, bytes.fromhex("DEADBEEF"), "can0", False),
        Frame(pytest.approx(0.03), 0x200, bytes.fromhex("11223344"), "can0", True),
        Frame(pytest.approx(0.04), 0x123, b"\0", "can0", False),
    ]
    assert reader.rejected == {"not_candump": 1}


@pytest.mark.slow
def test_a_plain_recording_of_a_drive_calibrates_nearly_as_well(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log, plain = tmp_path / "drive.log", tmp_path / "plain.txt"
    assert cli.main(["simulate", "--out", str(log), "--minutes", "6", "--seed", "3"]) == 0
    with log.open() as source, plain.open("w") as out:
        for line in source:
            _, channel, frame = line.split()
            can_id, _, data = frame.partition("#")
            text = " ".join(data[i : i + 2] for i in range(0, len(data), 2))
            out.write(f"  {channel}  {can_id}   [{len(data) // 2}]  {text}\n")
    results = []
    for name in (log, plain):
        config = str(ROOT / "config" / "examples" / "passenger_car.yaml")
        result = tmp_path / "result.json"
        assert cli.main(["replay", "--config", config, str(name), "--json", str(result)]) == 0
        results.append(json.loads(result.read_text()))
    assert "time is counted" in capsys.readouterr().err
    yaws = [r["mount"]["yaw_deg"] for r in results]
    assert abs((yaws[1] - yaws[0] + 180.0) % 360.0 - 180.0) < 1.5
    assert results[1]["duration_s"] == pytest.approx(results[0]["duration_s"], rel=0.02)


def test_what_is_no_log_is_one_message(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiled, "slow_words", str)  # a machine without a C compiler says so
    path = tmp_path / "notes.log"
    path.write_text("".join(f"line {i} of a diary\n" for i in range(100)))
    config = str(ROOT / "config" / "imucald.yaml")
    assert cli.main(["replay", "--config", config, str(path)]) == 1
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert "line 0 of a diary" in lines[0]
    assert "candump -l can0" in lines[0]


def test_damaged_lines_of_screen_output_are_counted_by_reason(tmp_path: Path) -> None:
    good = (FORMS / "ta.txt").read_text().splitlines()
    wrong = [
        " (1795342254.398121)  vcan0  044   [5]  2A 36 6C 2B",
        " (1795342254.398121)  vcan0  844   [1]  2A",
        "  vcan0  044   [1]  2A",
        "nonsense",
        " (17953422:4.398121)  vcan0  044   [1]  2A",
    ]
    path = tmp_path / "a.log"
    path.write_text("\n".join([*good, *wrong, *good, good[0][:45]]))
    reader = LogReader([path])
    assert len(frames_of(*reader)) == 2 * len(log_file())
    assert reader.rejected == {
        "bad_hex": 1, "bad_id": 1, "bad_timestamp": 2, "not_candump": 1, "cut_line": 1,
    }  # fmt: skip
    assert reader.problems[0].startswith(
        f"{path}:{len(good) + 1}: the line does not have the stated number of data bytes"
    )


GVRET = """Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,
166064500,00000200,false,Rx,1,2,01,02,
166065000,18FEF1AA,true,Tx,0,0,
"""
OLD_GVRET = GVRET.replace(",Dir", "").replace(",Rx", "").replace(",Tx", "")


@pytest.mark.parametrize("text", [GVRET, OLD_GVRET, GVRET.replace("\n", "\r\n"), "\ufeff" + GVRET])
def test_csv_of_savvycan_is_read(tmp_path: Path, text: str) -> None:
    path = tmp_path / "drive.csv"
    path.write_text(text, encoding="utf-8", newline="")
    found = frames_of(*LogReader([path], strict=True))
    assert found == [
        Frame(pytest.approx(166.064), 0x21A, bytes.fromhex("FE3612FE690507AD"), "can0", False),
        Frame(pytest.approx(166.0645), 0x200, b"\x01\x02", "can1", False),
        Frame(pytest.approx(166.065), CAN_EFF_FLAG | 0x18FEF1AA, b"", "can0", False),
    ]


def test_bad_lines_of_savvycan_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text(
        GVRET + "x,1,false,Rx,0,0,\n1,800,false,Rx,0,0,\n1,1,false,Rx,0,3,01,02,\n1,1,fal"
    )
    reader = LogReader([path])
    assert len(frames_of(*reader)) == 3
    assert reader.rejected == {"bad_line": 2, "bad_id": 1, "cut_line": 1}


def test_an_unknown_csv_names_those_that_are_known(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    path.write_text("time;speed\n0.1;5\n")
    with pytest.raises(LogError, match=r"time;speed.*SavvyCAN.*python-can.*encode"):
        list(LogReader([path]))


def packers() -> list[tuple[str, object]]:
    zstandard = pytest.importorskip("zstandard")
    return [
        (".gz", gzip.compress), (".xz", lzma.compress), (".bz2", bz2.compress),
        (".zst", zstandard.ZstdCompressor().compress),
    ]  # fmt: skip


@pytest.mark.parametrize("kind", [".gz", ".xz", ".bz2", ".zst"])
@pytest.mark.parametrize("form", ["L", "ta"])
def test_compressed_logs_are_read_whatever_their_name(tmp_path: Path, kind: str, form: str) -> None:
    pack = dict(packers())[kind]
    text = (FORMS / f"{form}.txt").read_bytes()
    for name in (f"a.log{kind}", "a.dat"):
        path = tmp_path / name
        path.write_bytes(pack(text) + pack(text))  # type: ignore[operator]
        found = frames_of(*LogReader([path], strict=True))
        assert [f.data for f in found] == [f.data for f in log_file()] * 2


@pytest.mark.parametrize("kind", [".gz", ".xz", ".bz2", ".zst"])
def test_a_cut_compressed_log_says_so_and_keeps_what_there_is(tmp_path: Path, kind: str) -> None:
    lines = [f"({i / 1000 + 1e9:.6f}) can0 123#{i * 7919 % 2**32:08X}\n" for i in range(60_000)]
    packed = dict(packers())[kind]("".join(lines).encode())  # type: ignore[operator]
    path = tmp_path / f"a.log{kind}"
    path.write_bytes(packed[: len(packed) * 3 // 4])
    reader = LogReader([path])
    assert len(frames_of(*reader)) > 10_000
    assert reader.rejected["damaged_file"] == 1


def messages(count: int = 400) -> list[can.Message]:
    return [
        can.Message(timestamp=1.7e9 + i / 50, arbitration_id=0x200 + i % 3, is_extended_id=False,
                    data=struct.pack("<Q", i * 0x9E3779B97F4A7C15 % 2**64), channel=0)
        for i in range(count)
    ]  # fmt: skip


def write(path: Path) -> None:
    with can.Logger(path) as writer:
        for one in messages():
            writer.on_message_received(one)


@pytest.mark.parametrize("name", ["a.blf", "a.asc", "a.trc", "a.csv", "a.db"])
@pytest.mark.parametrize("other", ["b.log", "b.dat", "b.log.xz"])
def test_a_wrong_ending_does_not_matter(tmp_path: Path, name: str, other: str) -> None:
    write(tmp_path / name)
    content = (tmp_path / name).read_bytes()
    path = tmp_path / other
    path.write_bytes(lzma.compress(content) if other.endswith("xz") else content)
    found = frames_of(*LogReader([path], strict=True))
    assert [f.data for f in found] == [bytes(m.data) for m in messages()]


def test_a_blf_that_is_cut_says_where(tmp_path: Path) -> None:
    path = tmp_path / "a.blf"
    with can.BLFWriter(path, max_container_size=2048) as writer:
        for one in messages():
            writer.on_message_received(one)
    whole = path.read_bytes()
    assert len(frames_of(*LogReader([path], strict=True))) == 400
    path.write_bytes(whole[: len(whole) // 2])
    reader = LogReader([path])
    found = frames_of(*reader)
    assert 50 < len(found) < 350
    assert reader.rejected == {"cut_file": 1}
    (problem,) = reader.problems
    assert f"{len(whole) // 2} of {len(whole)} bytes" in problem
    assert f"{len(found)} frames were read, {found[-1].t - found[0].t:.1f} s" in problem
    with pytest.raises(LogError, match="cut"):
        list(LogReader([path], strict=True))


def test_a_blf_that_was_never_closed_says_that_it_is_cut(tmp_path: Path) -> None:
    """A logger that lost its power: the header states no size, the last block is not whole."""
    path = tmp_path / "a.blf"
    with can.BLFWriter(path, max_container_size=2048) as writer:
        for one in messages():
            writer.on_message_received(one)
    whole = bytearray(path.read_bytes())
    whole[16:32] = bytes(16)  # size of the file, size unpacked
    path.write_bytes(whole[:-100])
    reader = LogReader([path])
    assert len(frames_of(*reader)) > 300
    assert reader.rejected == {"cut_file": 1}
    path.write_bytes(whole[:60])
    with pytest.raises(LogError, match="cut"):
        list(LogReader([path]))


def written_mf4(path: Path) -> bytes:
    """The bytes of `messages` as python-can writes them to an MF4 file, which stays there."""
    pytest.importorskip("asammdf")
    from imucald.can.python_can import with_mf4

    with_mf4()
    from can.io.mf4 import MF4Writer

    with MF4Writer(path) as writer:
        for one in messages():
            writer.on_message_received(one)
    return path.read_bytes()


def test_an_mf4_that_is_cut_says_where(tmp_path: Path) -> None:
    path = tmp_path / "a.mf4"
    whole = written_mf4(path)
    assert len(frames_of(*LogReader([path], strict=True))) == 400
    for share in (0.99, 0.5, 0.05, 0.005):
        path.write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(LogError, match=r"a\.mf4: cannot be read: the file is cut"):
            list(LogReader([path]))


@pytest.mark.parametrize("begins", [b"MDF     ", b"UnFinMF "])
def test_an_mf4_whose_channel_lies_beyond_its_record_is_refused_before_it_is_read(
    tmp_path: Path, begins: bytes
) -> None:
    """asammdf's compiled part reads and writes there, whatever there is."""
    path = tmp_path / "a.mf4"
    whole = written_mf4(path)
    places = [found.start() for found in re.finditer(b"##CN", whole)]
    refused = 0
    for at in places:
        links = int.from_bytes(whole[at + 16 : at + 24], "little")
        first_byte = at + 24 + 8 * links + 4
        damaged = bytearray(whole)
        damaged[first_byte : first_byte + 4] = (520).to_bytes(4, "little")
        damaged[:8] = begins
        path.write_bytes(damaged)
        with pytest.raises(LogError, match=f"a channel at byte {at} lies beyond its record"):
            list(LogReader([path]))
        refused += 1
    assert refused >= 5


@pytest.mark.parametrize("begins", [b"MDF     ", b"UnFinMF "])
@pytest.mark.parametrize("kind", [b"##CN", b"##CG", b"##DG"])
def test_an_mf4_whose_list_leads_back_into_itself_is_refused(
    tmp_path: Path, kind: bytes, begins: bytes
) -> None:
    """asammdf follows it for ever."""
    path = tmp_path / "a.mf4"
    whole = bytearray(written_mf4(path))
    at = whole.index(kind)
    whole[at + 24 : at + 32] = at.to_bytes(8, "little")
    whole[:8] = begins
    path.write_bytes(whole)
    with pytest.raises(LogError, match=f"two links point to the block at byte {at}"):
        list(LogReader([path]))


def with_records(whole: bytes, stated: int, *, invalidation: int = 0, unfinished: int = 0) -> bytes:
    """An MF4 file whose first group states other records; unfinished: what its recorder left."""
    changed = bytearray(whole)
    at = whole.index(b"##CG") + 24 + 8 * 6
    struct.pack_into("<Q", changed, at + 8, stated)
    struct.pack_into("<I", changed, at + 28, invalidation)
    if unfinished:
        changed[:8] = b"UnFinMF "
        struct.pack_into("<H", changed, 60, unfinished)
    return bytes(changed)


@pytest.mark.parametrize("unfinished", [0, 4])
@pytest.mark.parametrize(("stated", "invalidation"), [(1 << 60, 0), (1, 0xFF00_0000), (0, 0)])
def test_an_mf4_that_states_records_other_than_its_data_is_refused(
    tmp_path: Path, stated: int, invalidation: int, unfinished: int
) -> None:
    """asammdf takes memory for too many. It reads data without records for ever."""
    path = tmp_path / "a.mf4"
    whole = written_mf4(path)
    path.write_bytes(with_records(whole, stated, invalidation=invalidation, unfinished=unfinished))
    with pytest.raises(LogError, match=r"states \d+ bytes of records, but has \d+ bytes"):
        list(LogReader([path]))


@pytest.mark.parametrize("stated", [0, 1 << 60])
def test_an_mf4_that_was_not_finished_needs_no_number_of_records(
    tmp_path: Path, stated: int
) -> None:
    path = tmp_path / "a.mf4"
    path.write_bytes(with_records(written_mf4(path), stated, unfinished=1))
    assert len(frames_of(*LogReader([path], strict=True))) == 400


def test_an_mf4_that_states_no_records_of_one_of_two_mixed_groups_is_read_to_its_end(
    tmp_path: Path,
) -> None:
    """asammdf lists the ids of its data for ever."""
    path = tmp_path / "a.mf4"
    whole = bytearray(with_records(written_mf4(path), 0))
    one = whole.index(b"##DG") + 24
    two, first = struct.unpack_from("<QQ", whole, one)
    after, second = struct.unpack_from("<QQ", whole, two + 24)
    of_one, of_two = (struct.unpack_from("<I", whole, at + 24 + 72)[0] for at in (first, second))
    struct.pack_into("<QQQQB", whole, one, after, first, len(whole), 0, 1)
    struct.pack_into("<Q", whole, first + 24, second)
    struct.pack_into("<QQ", whole, second + 24 + 48, 2, 5)
    data = 5 * (b"\1" + bytes(of_one) + b"\2" + bytes(of_two))
    whole += struct.pack("<4s4xQQ", b"##DT", 24 + len(data), 0) + data
    path.write_bytes(whole)
    assert list(LogReader([path])) == []


@pytest.mark.parametrize("unfinished", [0, 1, 4, 5, 16])
def test_an_mf4_whose_list_of_data_has_parts_is_read_if_asammdf_need_not_finish_it(
    tmp_path: Path, unfinished: int
) -> None:
    """asammdf looks at the first part for ever."""
    path = tmp_path / "a.mf4"
    whole = bytearray(with_records(written_mf4(path), 400, unfinished=unfinished))
    link = whole.index(b"##DG") + 24 + 8 * 2
    (data,) = struct.unpack_from("<Q", whole, link)
    whole += bytes(-len(whole) % 8)
    struct.pack_into("<Q", whole, link, len(whole))
    for following, block in ((len(whole) + 56, data), (0, 0)):
        whole += struct.pack("<4s4xQQQQIIQ", b"##DL", 56, 2, following, block, 0, bool(block), 0)
    path.write_bytes(whole)
    if unfinished & (4 | 16):
        with pytest.raises(LogError, match=r"not finished, and its list of data .* several parts"):
            list(LogReader([path]))
    else:
        assert len(frames_of(*LogReader([path], strict=True))) == 400


def frame(can_id: int, data: bytes, marks: int = 0) -> bytes:
    """A frame as linktype 227 has it (tcpdump.org/linktypes/LINKTYPE_CAN_SOCKETCAN.html)."""
    return struct.pack(">IBBBB", can_id, len(data), marks, 0, 0) + data


PACKETS = [
    frame(0x123, b"\x01\x02\x03"),
    frame(CAN_EFF_FLAG | 0x18FEF1AA, bytes(8)),
    frame(0x40000123, b""),  # a remote frame
    frame(0x20000004, bytes(8)),  # an error frame
    frame(0x200, bytes(range(12)), marks=4),
]
IN_PACKETS = [
    (0x123, b"\x01\x02\x03", False),
    (CAN_EFF_FLAG | 0x18FEF1AA, bytes(8), False),
    (0x200, bytes(range(12)), True),
]


def pcap(packets: list[bytes], link: int) -> bytes:
    out = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, link)
    for i, packet in enumerate(packets):
        out += struct.pack("<IIII", 1_700_000_000, 1000 * i, len(packet), len(packet)) + packet
    return out


def block(kind: int, body: bytes) -> bytes:
    body += bytes(-len(body) % 4)
    return struct.pack("<II", kind, len(body) + 12) + body + struct.pack("<I", len(body) + 12)


def pcapng(packets: list[bytes], link: int) -> bytes:
    out = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1))
    out += block(1, struct.pack("<HHI", link, 0, 65535))
    for i, packet in enumerate(packets):
        t = 1_700_000_000_000_000 + 1000 * i
        head = struct.pack("<IIIII", 0, t >> 32, t & 0xFFFFFFFF, len(packet), len(packet))
        out += block(6, head + packet)
    return out


def cooked(packet: bytes) -> bytes:
    """LINKTYPE_LINUX_SLL: what "any" gives."""
    return struct.pack(">HHH8sH", 0, 280, 0, bytes(8), 0x000C) + packet


@pytest.mark.parametrize("make", [pcap, pcapng])
@pytest.mark.parametrize("is_cooked", [False, True])
@pytest.mark.parametrize("name", ["a.pcap", "a.pcapng", "a.log", "a.pcap.gz"])
def test_captures_of_a_can_interface_are_read(tmp_path: Path, make, is_cooked, name) -> None:
    pytest.importorskip("dpkt")
    content = make([cooked(p) if is_cooked else p for p in PACKETS], 113 if is_cooked else 227)
    path = tmp_path / name
    path.write_bytes(gzip.compress(content) if name.endswith("gz") else content)
    reader = LogReader([path], strict=True)
    found = frames_of(*reader)
    assert [(f.can_id, f.data, f.fd) for f in found] == IN_PACKETS
    assert [f.t for f in found] == pytest.approx([1.7e9, 1.7e9 + 0.001, 1.7e9 + 0.004], abs=1e-6)
    assert reader.ignored == {"remote_frame": 1, "error_frame": 1}


@pytest.mark.parametrize("make", [pcap, pcapng])
def test_a_cut_capture_says_so(tmp_path: Path, make) -> None:
    pytest.importorskip("dpkt")
    path = tmp_path / "a.pcap"
    content = make(PACKETS[:2] * 50, 227)
    for cut in (3, 10, 20, 30):
        path.write_bytes(content[:-cut])
        reader = LogReader([path])
        assert len(frames_of(*reader)) in (98, 99)
        assert sum(reader.rejected.values()) == 1, cut


@pytest.mark.parametrize("is_cooked", [False, True])
def test_ids_in_the_order_of_a_pc_are_known_by_the_first_packets(tmp_path: Path, is_cooked) -> None:
    pytest.importorskip("dpkt")
    swapped = [packet[3::-1] + packet[4:] for packet in PACKETS]
    path = tmp_path / "a.pcap"
    packets = [cooked(p) if is_cooked else p for p in swapped]
    path.write_bytes(pcap(packets, 113 if is_cooked else 227))
    reader = LogReader([path])
    assert [(f.can_id, f.data, f.fd) for f in frames_of(*reader)] == IN_PACKETS
    assert "little-endian" in reader.problems[0]


def test_an_id_that_is_none_is_rejected(tmp_path: Path) -> None:
    pytest.importorskip("dpkt")
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap([*PACKETS, frame(0x12345, b"")], 227))
    reader = LogReader([path])
    assert len(frames_of(*reader)) == len(IN_PACKETS)
    assert reader.rejected == {"bad_id": 1}


def test_a_capture_with_its_header_in_the_other_byte_order_is_read(tmp_path: Path) -> None:
    pytest.importorskip("dpkt")
    out = struct.pack(">IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227)
    for i, packet in enumerate(PACKETS):
        out += struct.pack(">IIII", 1_700_000_000, 1000 * i, len(packet), len(packet)) + packet
    path = tmp_path / "a.pcap"
    path.write_bytes(out)
    assert [f.can_id for f in frames_of(*LogReader([path]))] == [
        can_id for can_id, *_ in IN_PACKETS
    ]


def test_a_capture_of_another_network_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("dpkt")
    path = tmp_path / "a.pcap"
    path.write_bytes(pcap([b"\0" * 60], 1))
    with pytest.raises(LogError, match=r"a capture of Ethernet .*not of a CAN interface"):
        list(LogReader([path]))


def test_standard_input_is_known_by_its_first_bytes_too(monkeypatch: pytest.MonkeyPatch) -> None:
    text = lzma.compress((FORMS / "ta.txt").read_bytes())
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text)))
    assert [f.data for f in frames_of(*LogReader(["-"]))] == [f.data for f in log_file()]


@pytest.mark.parametrize("packed", [False, True])
def test_a_pipe_that_has_a_name_is_read_from_its_beginning(tmp_path: Path, packed: bool) -> None:
    lines = [f"({k // 1000}.{k % 1000:06d}) can0 123#{k:016X}\n" for k in range(20_000)]
    text = "".join(lines).encode()
    pipe = tmp_path / "pipe.log"
    os.mkfifo(pipe)
    stored = gzip.compress(text) if packed else text
    writer = threading.Thread(target=pipe.write_bytes, args=[stored], daemon=True)
    writer.start()
    seen: list[int | None] = []
    reader = LogReader([pipe], progress=lambda _, total: seen.append(total))
    read = frames_of(*reader)
    writer.join(10.0)
    assert [frame.data for frame in read] == [k.to_bytes(8, "big") for k in range(20_000)]
    assert reader.rejected == {}
    assert set(seen) == {None}, "nobody knows how long a pipe is"


def test_a_capture_in_a_pipe_is_refused_with_the_reason(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.pcap"
    os.mkfifo(pipe)
    stored = pcap([], 227) * 1000
    writer = threading.Thread(target=_write_until_closed, args=[pipe, stored], daemon=True)
    writer.start()
    with pytest.raises(LogError, match="not from a pipe"):
        list(LogReader([pipe]))
    writer.join(10.0)
    assert not writer.is_alive()


def _write_until_closed(pipe: Path, stored: bytes) -> None:
    with contextlib.suppress(BrokenPipeError):
        pipe.write_bytes(stored)


def stamped(factor: float, start: float, path: Path) -> LogReader:
    """A log of two messages, every 10 and 20 ms, with stamps that are so many times too large."""
    stated = [(IdMatch(0x123, 0x7FF), 0.01), (IdMatch(0x124, 0x7FF), 0.02)]
    rows = sorted((0.01 * (1 + i) * k, 0x123 + i, k) for k in range(200) for i in range(2))
    lines = [f"({(start + t) * factor:.6f}) can0 {i:X}#{k:04X}\n" for t, i, k in rows]
    path.write_text("".join(lines))
    return LogReader([path], cycles=stated)


@pytest.mark.parametrize("start", [0.0, 1.6e9])
@pytest.mark.parametrize(("factor", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds")])
def test_stamps_that_are_not_seconds_are_refused_at_once(
    tmp_path: Path, start: float, factor: float, unit: str
) -> None:
    assert len(frames_of(*stamped(1.0, start, tmp_path / "good.log"))) == 400
    path = tmp_path / "a.log"
    with pytest.raises(
        LogError, match=f"a.log: its time stamps seem to be {unit}.*by {factor:.0f}"
    ):
        next(iter(stamped(factor, start, path)))


def test_one_stamp_far_ahead_does_not_make_a_log_one_of_milliseconds(tmp_path: Path) -> None:
    reader = stamped(1.0, 1.6e9, tmp_path / "a.log")
    lines = (tmp_path / "a.log").read_text().splitlines(keepends=True)
    lines[0] = lines[0].replace("(16", "(1699999")
    (tmp_path / "a.log").write_text("".join(lines))
    assert len(frames_of(*reader)) == 400
