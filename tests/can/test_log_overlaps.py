"""Files of one recording that hold the same seconds, or come in the wrong order."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imucald.can.columns import FrameColumns
from imucald.can.logs.candump_writer import CandumpWriter
from imucald.can.logs.frame_batches import columns_of_frames
from imucald.can.logs.log_reader import LogReader
from imucald.can.logs.recording_files import CLOCK_SET_S

TODAY = CLOCK_SET_S + 8e8


def recorded(path: Path, start: float, seconds: float) -> Path:
    """Ten frames a second."""
    t = start + 0.1 * np.arange(round(10 * seconds) + 1)
    frames = [(float(x), 0x120, bytes(8), 0, False) for x in t]
    with CandumpWriter(path) as writer:
        writer.write_columns(columns_of_frames(frames, ("can0",)))
    return path


def overlaps(*paths: Path) -> list[str]:
    reader = LogReader(list(paths))
    for _ in range(2):  # what was read before does not count twice
        assert all(isinstance(chunk, FrameColumns) for chunk in reader)
    return reader.overlaps


def test_of_three_pieces_each_is_held_against_the_one_that_ends_last(tmp_path: Path) -> None:
    """The second lies within the first, which the third overlaps."""
    first, second, third = (tmp_path / f"{i}.log" for i in (1, 2, 3))
    recorded(first, TODAY, 60.0)
    recorded(second, TODAY + 10.0, 5.0)
    recorded(third, TODAY + 58.0, 60.0)
    within, shared = overlaps(first, second, third)
    assert within.startswith(f"{second} and {first} overlap completely in time; are their clocks")
    assert shared.startswith(f"{third} begins 2.0 s before {first} ends")


def test_two_logs_of_one_length_overlap_completely_though_they_begin_with_other_frames(
    tmp_path: Path,
) -> None:
    first = recorded(tmp_path / "1.log", TODAY, 60.0)
    second = recorded(tmp_path / "2.log", TODAY + 0.03, 60.0)
    (text,) = overlaps(first, second)
    assert text.startswith(f"{second} and {first} overlap completely in time")


def test_pieces_that_follow_one_another_share_nothing(tmp_path: Path) -> None:
    first = recorded(tmp_path / "1.log", TODAY, 60.0)
    assert overlaps(first, recorded(tmp_path / "2.log", TODAY + 60.0, 60.0)) == []


def test_of_logs_that_count_from_their_own_start_nothing_is_known(tmp_path: Path) -> None:
    """That both begin near 0 s does not make them simultaneous."""
    first = recorded(tmp_path / "1.log", 0.0, 60.0)
    second = recorded(tmp_path / "2.log", 0.5, 30.0)
    assert overlaps(first, second, recorded(tmp_path / "3.log", TODAY, 30.0)) == []
