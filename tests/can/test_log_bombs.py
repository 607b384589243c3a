"""Files that state lengths which no recording has: refused before memory is taken for them."""

from __future__ import annotations

import sqlite3
import struct
import time
import tracemalloc
import zlib
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from imucald.can.logs.log_reader import LogReader
from imucald.can.logs.unpacking import FREE_BYTES
from imucald.core.errors import LogError
from paths import ROOT

FUZZED = ROOT / "tests" / "fuzz" / "corpus"
LONG = 4 * FREE_BYTES
MOST = 3 * FREE_BYTES
"""A block that is taken, the one before it and both as one [bytes]."""
CONTAINER, CAN_MESSAGE, OTHER = 10, 1, 77


def sparse(path: Path, begin: bytes) -> Path:
    with path.open("wb") as file:
        file.write(begin)
        file.truncate(len(begin) + LONG)
    return path


def blf_object(length: int, kind: int) -> bytes:
    return struct.pack("<4sHHLL", b"LOBJ", 16, 1, length, kind)


def blf_head() -> bytes:
    day = (2020, 1, 3, 3, 12, 0, 0, 0)
    counts = [0] * 12
    return struct.pack("<4sL8BQQLL8H8H72x", b"LOGG", 144, *counts, *day, *day)


def blf_container(plain: bytes) -> bytes:
    packed = zlib.compress(plain, 9)
    length = 32 + len(packed)
    return blf_object(length, CONTAINER) + struct.pack("<H14x", 2) + packed + bytes(length % 4)


def long_blf_container(folder: Path) -> Path:
    begin = blf_head() + blf_object(LONG, CONTAINER) + struct.pack("<H14x", 0)
    return sparse(folder / "drive.blf", begin)


def long_blf_object(folder: Path) -> Path:
    return sparse(folder / "drive.blf", blf_head() + blf_object(LONG, OTHER))


def blf_object_over_many_containers(folder: Path) -> Path:
    half = bytes(FREE_BYTES // 2)
    path = folder / "drive.blf"
    first = blf_container(blf_object(0xFFFF_FFF0, CAN_MESSAGE) + half)
    path.write_bytes(blf_head() + first + 9 * blf_container(half))
    return path


def long_packet(folder: Path) -> Path:
    head = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 227)
    return sparse(folder / "drive.pcap", head + struct.pack("<IIII", 1, 1, LONG, 16))


def long_first_block(folder: Path) -> Path:
    head = struct.pack("<IIIHHq", 0x0A0D0D0A, LONG, 0x1A2B3C4D, 1, 0, -1)
    return sparse(folder / "drive.pcapng", head)


def long_record(folder: Path) -> Path:
    """An MF4 file of 3,632 bytes whose group states records of 4 GiB."""
    path = folder / "drive.mf4"
    path.write_bytes((FUZZED / "mf4_log" / "981f2b0c711becd66b8fbe52b3a7a76c3e3c72b3").read_bytes())
    return path


def long_row(folder: Path) -> Path:
    path = folder / "drive.db"
    columns = "ts, arbitration_id, extended, remote, error, dlc, data"
    with closing(sqlite3.connect(path)) as database:
        database.execute(f"CREATE TABLE messages({columns})")
        database.execute(f"INSERT INTO messages VALUES (1, 2, 0, 0, 0, 8, zeroblob({LONG}))")
        database.commit()
    return path


@pytest.mark.parametrize(
    "written",
    [
        long_blf_container,
        long_blf_object,
        blf_object_over_many_containers,
        long_packet,
        long_first_block,
        long_record,
        long_row,
    ],
)
def test_a_length_that_no_recording_has_takes_no_memory(
    written: Callable[[Path], Path], tmp_path: Path
) -> None:
    path = written(tmp_path)
    tracemalloc.start()
    try:
        with pytest.raises(LogError):
            list(LogReader([path], None))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < MOST


def test_an_mf4_whose_record_is_longer_than_its_data_is_refused_at_once(tmp_path: Path) -> None:
    path = long_record(tmp_path)
    began = time.process_time()
    with pytest.raises(LogError, match="states 12834570492 bytes of records, but has 252"):
        list(LogReader([path], None))
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize("column", [0, 1, 4, 5])
def test_a_number_of_gvret_that_no_float_holds_is_a_bad_line(column: int, tmp_path: Path) -> None:
    good = "1000000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,"
    bad = good.split(",")
    bad[column] = "9" * 400
    heading = "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"
    path = tmp_path / "drive.csv"
    path.write_text("\n".join([heading, ",".join(bad), good, ""]))
    reader = LogReader([path], None)
    frames = sum(len(columns) for columns in reader)
    assert frames == (2 if column == 4 else 1)  # the number of a bus is a name
