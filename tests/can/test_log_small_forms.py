"""Small forms of logs from other programs: blanks, tabs, headers, differences, other formats."""

from __future__ import annotations

from pathlib import Path

import pytest

from imucald.can.logs.log_reader import LogReader
from imucald.core import compiled
from imucald.core.errors import LogError
from log_text import frames_of

HEADER = "*** EXAMPLE\n*** Log\n*** Tue May 11\n\n*** Pilot: A\n*** Race: B\n\n"
PLAIN = "".join(f"({k // 100:010d}.{k % 100:02d}0000) can0 123#{k:04X}\n" for k in range(300))
TRC_21 = ";$FILEVERSION=2.1\n;$STARTTIME=43000.5\n;$COLUMNS=N,O,T,B,I,d,R,L,D\n"


def read(path: Path, text: str, without_kernels: bool = False) -> tuple[list, LogReader]:
    path.write_text(text)
    reader = LogReader([path])
    if not without_kernels:
        return frames_of(*reader), reader
    with compiled.left_out():
        return frames_of(*reader), reader


@pytest.mark.parametrize("without_kernels", [False, True])
@pytest.mark.parametrize(
    "change",
    [
        pytest.param(lambda s: s.replace(" ", "\t"), id="tabs"),
        pytest.param(lambda s: s.replace("(0000000", "(       "), id="padded"),
        pytest.param(lambda s: s.replace(" can0", "\t  can0").replace(" 123", "\t123"), id="mixed"),
    ],
)
def test_blanks_and_tabs_do_not_matter(tmp_path: Path, change, without_kernels: bool) -> None:
    want, _ = read(tmp_path / "plain.log", PLAIN)
    found, reader = read(tmp_path / "a.log", change(PLAIN), without_kernels)
    assert len(found) == 300
    assert found == want
    assert reader.rejected == {}


@pytest.mark.parametrize("without_kernels", [False, True])
@pytest.mark.parametrize("text", [PLAIN, PLAIN.replace(" can0 123#", "  can0  123   [2]  00 ")])
def test_a_header_is_one_problem_with_its_lines(
    tmp_path: Path, text: str, without_kernels: bool
) -> None:
    found, reader = read(tmp_path / "a.log", HEADER + text.replace("[2]  00 00", "[2]  00 "))
    assert reader.rejected["not_candump"] == 5
    assert reader.problems[0].startswith(f"{tmp_path / 'a.log'}:1: ")
    assert "4 more such lines up to line 6" in reader.problems[0]
    if text is PLAIN:
        assert len(found) == 300
        assert len(reader.problems) == 1


def test_lines_of_another_kind_in_two_places_are_two_problems(tmp_path: Path) -> None:
    lines = PLAIN.splitlines(keepends=True)
    text = "# one\n# two\n" + "".join(lines[:9]) + "# three\n" + "".join(lines[9:])
    found, reader = read(tmp_path / "a.log", text)
    assert len(found) == 300
    assert [problem.split(": ")[0].rsplit(":")[-1] for problem in reader.problems] == ["1", "12"]


def test_differences_are_named(tmp_path: Path) -> None:
    steps = [0.0002, 0.0041, 0.0007, 0.0050]
    text = "".join(f"(000.{round(1e6 * steps[k % 4]):06d}) can0 123#{k:04X}\n" for k in range(2000))
    with pytest.raises(LogError, match="count from the line before"):
        read(tmp_path / "a.log", text)


def test_frames_that_are_only_out_of_order_are_no_differences(tmp_path: Path) -> None:
    stamps = [0.01 * k + (0.03 if k % 2 else 0.0) for k in range(2000)]
    text = "".join(f"({t:.6f}) can0 123#00\n" for t in stamps)
    assert len(read(tmp_path / "a.log", text)[0]) == 2000


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.log", "//----\nMicrochip Technology Inc.\nCAN BUS Analyzer\n", "Microchip's CAN BUS"),
        ("a.trc", "@ TEXT @ 2 @ 64 @\t46,016\t1\t0004\t45A\t8\n", "CarBusAnalyzer"),
        ("a.log", "***BUSMASTER Ver 1.7.2***\n***PROTOCOL CAN***\n", "BUSMASTER"),
    ],
)
def test_a_known_program_is_named(tmp_path: Path, name: str, text: str, said: str) -> None:
    with pytest.raises(LogError, match=rf"a log of {said}.*export it as ASC"):
        read(tmp_path / name, text)


def test_a_line_that_python_can_cannot_read_is_named_by_its_place(tmp_path: Path) -> None:
    text = ";$FILEVERSION=1.1\n;$STARTTIME=43000.5\n  1) TEXT Rx 0300 1 00\n"
    with pytest.raises(LogError, match=r"line 3 is not a line of TRC: '1\) TEXT Rx"):
        read(tmp_path / "a.trc", text)


@pytest.mark.parametrize(
    ("last", "frames"),
    [("   2 20.1 DT 1 0300 Rx - 0", 2), ("   2 20.1 DT 1 0300 Rx - 2 01 0", 1)],
)
def test_one_digit_at_the_end_of_trc_is_cut_only_where_it_is_data(
    tmp_path: Path, last: str, frames: int
) -> None:
    found, reader = read(tmp_path / "a.trc", TRC_21 + "   1 10.1 DT 1 0300 Rx - 1 00\n" + last)
    assert len(found) == frames
    assert sum(reader.rejected.values()) == 2 - frames


def test_semicolons_say_which_columns_are_wanted(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"arbitration_id,extended,.*commas between the columns"):
        read(tmp_path / "a.csv", "timestamp;arbitration_id;data\n0.1;0x123;00\n")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("a.log", PLAIN + "(-1.500000) can0 123#00\n"),
        ("a.csv", "Time Stamp,ID,Extended,Dir,Bus,LEN,D1\n-5,123,false,Rx,0,1,00\n"),
    ],
)
def test_a_negative_stamp_is_named_with_its_remedy(tmp_path: Path, name: str, text: str) -> None:
    _, reader = read(tmp_path / name, text)
    assert "negative: add the same time to all stamps" in reader.problems[0]
