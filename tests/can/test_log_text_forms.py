"""ASC as other machines write it, and compressed logs that unpack without end."""

from __future__ import annotations

import contextlib
import gzip
import sqlite3
import struct
import tracemalloc
import zlib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from full_disk import full_after
from imucald.can.logs import unpacking
from imucald.can.logs.log_reader import LogReader
from imucald.core.errors import LogError

HEAD = "date Sam M\xe4r 28 15:00:00.000 2026\nbase hex  timestamps {}\ninternal events logged\n"


def asc(path: Path, lines: list[str], stamps: str = "absolute", encoding: str = "cp1252") -> Path:
    path.write_bytes((HEAD.format(stamps) + "".join(f"{x}\n" for x in lines)).encode(encoding))
    return path


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_the_encoding_of_an_asc_file_does_not_matter(tmp_path: Path, encoding: str) -> None:
    path = asc(tmp_path / "a.asc", ["0.100000 1 C2 Rx d 2 01 02"], encoding=encoding)
    (chunk,) = LogReader([path])
    assert chunk.can_id.tolist() == [0xC2]
    assert chunk.data[0, :2].tolist() == [1, 2]


def test_relative_stamps_of_asc_count_from_the_line_before(tmp_path: Path) -> None:
    lines = [f"   0.01{k}000 1 C2 Rx d 1 0{k}" for k in range(4)]
    (chunk,) = LogReader([asc(tmp_path / "a.asc", lines, "relative")])
    assert chunk.t == pytest.approx(np.cumsum([0.010, 0.011, 0.012, 0.013]))


@pytest.mark.parametrize(("stamps", "times"), [("absolute", [0.1, 0.2]), ("relative", [0.1, 0.3])])
def test_stamps_of_asc_may_have_a_decimal_comma(
    tmp_path: Path, stamps: str, times: list[float]
) -> None:
    lines = ["   0,100000 1  C2   Rx   d 2 01 02", "   0,200000 1  C2   Rx   d 2 03 04"]
    (chunk,) = LogReader([asc(tmp_path / "a.asc", lines, stamps)])
    assert chunk.t == pytest.approx(times)
    assert chunk.data[:, 0].tolist() == [1, 3]


def test_a_name_for_an_id_is_named_with_its_remedy(tmp_path: Path) -> None:
    lines = ["0.1 1 C2 Rx d 1 01", "0.2 1 ESC_Speed Rx d 1 01"]
    with pytest.raises(LogError, match=r"ESC_Speed.*export the log with numeric ids"):
        list(LogReader([asc(tmp_path / "a.asc", lines)]))


def test_a_classic_frame_with_a_raw_length_code_has_eight_bytes(tmp_path: Path) -> None:
    (chunk,) = LogReader([asc(tmp_path / "a.asc", ["0.1 1 C2 Rx d f 01 02 03 04 05 06 07 08"])])
    assert chunk.length.tolist() == [8]


def test_a_line_without_end_takes_little_memory(tmp_path: Path) -> None:
    path = asc(tmp_path / "a.asc", ["0.1 1 C2 Rx d 1 01"])
    with path.open("ab") as file:
        file.write(b"0" * 50_000_000)
    tracemalloc.start()
    reader = LogReader([path])
    assert sum(map(len, reader)) == 1
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()
    assert "longer than" in reader.problems[0]


def test_a_zstandard_bomb_takes_little_memory(tmp_path: Path) -> None:
    zstandard = pytest.importorskip("zstandard")
    packed = zstandard.ZstdCompressor(level=3).compress(bytes(500_000_000))
    path = tmp_path / "a.log.zst"
    path.write_bytes(packed)
    tracemalloc.start()
    with pytest.raises(LogError):
        list(LogReader([path]))
    assert tracemalloc.get_traced_memory()[1] < 60e6
    tracemalloc.stop()


def test_what_is_unpacked_into_a_temporary_file_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(unpacking, "FREE_BYTES", 1 << 20)
    path = tmp_path / "a.mf4.gz"
    path.write_bytes(gzip.compress(b"MDF     " + bytes(40_000_000)))
    with unpacking.plain_file(path) as (plain, damage):
        assert plain.stat().st_size < 45_000_000
    monkeypatch.setattr(unpacking, "MOST_TIMES", 10)
    with unpacking.plain_file(path) as (plain, damage):
        assert plain.stat().st_size < 4_000_000
    assert "no recording can be compressed that much" in damage


def test_a_container_of_blf_that_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    body = struct.pack("<H6xL4x", 2, 128 << 10) + zlib.compress(bytes(400_000_000), 1)
    head = struct.pack("<4sLBBBBBBBBQQ112x", b"LOGG", 144, *bytes(8), 0, 0)
    item = struct.pack("<4sHHLL", b"LOBJ", 16, 1, 16 + len(body), 10) + body
    path = tmp_path / "a.blf"
    path.write_bytes(head + item)
    tracemalloc.start()
    with pytest.raises(
        LogError, match="unpacked container at byte 144 would be larger than 64 MiB"
    ):
        list(LogReader([path]))
    assert tracemalloc.get_traced_memory()[1] < 20e6
    tracemalloc.stop()


@pytest.mark.parametrize("begins", [b"MDF     4.10    ", b"UnFinMF 4.10    "])
@pytest.mark.parametrize("stated", [400_000_000, 1000])
def test_a_block_of_mf4_that_unpacks_without_end_is_refused(
    tmp_path: Path, stated: int, begins: bytes
) -> None:
    packed = zlib.compress(bytes(400_000_000), 1)
    first = struct.pack("<4s4xQQQ", b"##HD", 32, 1, 96)
    body = struct.pack("<2sBxIQQ", b"DT", 0, 0, stated, len(packed)) + packed
    block = struct.pack("<4s4xQQ", b"##DZ", 24 + len(body), 0) + body
    path = tmp_path / "a.mf4"
    path.write_bytes(begins.ljust(64, b"\0") + first + block)
    with pytest.raises(LogError, match="unpacked block at byte 96 would be larger than 64 MiB"):
        list(LogReader([path]))


def test_a_full_disk_does_not_cut_a_log_that_is_unpacked(tmp_path: Path) -> None:
    """What fits would be read as the whole drive, and its result kept."""
    path = tmp_path / "a.blf.gz"
    path.write_bytes(gzip.compress(b"LOGG" + bytes(3_000_000)))
    with full_after(2_000_000), pytest.raises(LogError, match=r"a\.blf\.gz: cannot be unpacked"):
        list(LogReader([path]))


def test_temporary_files_leave_some_of_their_disk_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of all processes together: the disk is what they share."""
    path = tmp_path / "a.blf.gz"
    path.write_bytes(gzip.compress(b"LOGG" + bytes(3_000_000)))
    for free, is_refused in ((1.1, False), (0.9, True)):
        disk = SimpleNamespace(total=100 << 30, free=free * (1 << 30))
        monkeypatch.setattr("shutil.disk_usage", lambda _, disk=disk: disk)
        if is_refused:
            with pytest.raises(LogError, match=r"no space left .* 1024 MiB of the disk stay free"):
                list(LogReader([path]))
        else:
            with unpacking.plain_file(path) as (plain, damage):
                assert plain.stat().st_size == 3_000_004
                assert damage == ""


ROW = "x * 0.01 AS ts, 291 AS arbitration_id, 0 AS extended, 0 AS remote, 0 AS error, 8 AS dlc"
ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n)"
STATED = "ts REAL, arbitration_id INT, extended INT, remote INT, error INT, dlc INT"


@pytest.mark.parametrize(
    ("made", "why"),
    [
        (
            f"CREATE VIEW messages AS {ENDLESS} SELECT {ROW}, x'00' AS data FROM n",
            "not a plain table",
        ),
        (f"CREATE TABLE Messages ({STATED}, data AS (zeroblob(900000000)))", "generated columns"),
        ("CREATE VIRTUAL TABLE messages USING fts5(ts)", "not a plain table"),
    ],
)
def test_messages_of_a_database_that_are_no_rows_are_refused(
    tmp_path: Path, made: str, why: str
) -> None:
    """A file of some kB, of which a reader would never come to the end."""
    path = tmp_path / "a.db"
    with contextlib.closing(sqlite3.connect(path)) as db:
        db.execute(made)
        if made.startswith("CREATE TABLE"):
            db.execute("INSERT INTO messages VALUES (1.0, 291, 0, 0, 0, 8)")
        db.commit()
    with pytest.raises(LogError, match=rf"a\.db: cannot be read: .*{why}"):
        list(LogReader([path]))
