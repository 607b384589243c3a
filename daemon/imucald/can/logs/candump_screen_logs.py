"""Read candump's screen output (without -L or -l), also if copied from a terminal.

    (1436509052.249713)  can0  044   [5]  2A 36 6C 2B BA      -t a
    (2015-07-10 08:17:32.249713)  can0  044   [5]  ...        -t A, taken as UTC
    (000.010250)  can0  044   [5]  ...                        -t z since the start, -t d differences
    can0  TX B -  200  [12]  11 22 ...                        -x; [two digits] is CAN FD

The options -a (text), -c (colours), -i (binary digits) and -S (last byte first) are accepted too.
Lines without time stamps and lines in cansend's form (044#2A366C2BBA) are accepted. Time is then
counted from a message with a stated cycle. If no such message is in the file, the file is refused
with a remedy.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ClassVar, Final

from imucald.can.columns import CAN_EFF_MASK, Channels, FrameColumns
from imucald.can.id_filter import IdFilters
from imucald.can.logs.candump_line import shown
from imucald.can.logs.candump_screen_line import (
    AS_CANSEND,
    PRINTED,
    LineFault,
    ScreenFrame,
    frame_of_line,
)
from imucald.can.logs.candump_screen_times import CountedTimes, StampedTimes
from imucald.can.logs.frame_batches import FrameBatches, read_lines
from imucald.can.logs.log_format import Cycles, ReadStatistics
from imucald.can.logs.text_blocks import OpenLog
from imucald.core.errors import LogError

REMEDY: Final = "record with: candump -l can0"

LOOK_LINES: Final = 200
"""Number of first lines used to distinguish time differences from times since the start."""

_COLOUR: Final = re.compile(rb"\x1b\[[0-9;]*m")


class CandumpScreenReader:
    """Reads files of candump's screen output into columns, line by line."""

    endings: ClassVar[tuple[str, ...]] = ()

    @staticmethod
    def begins(head: bytes) -> bool:
        """True if one of the first lines has the form of candump's output or of cansend's input."""
        lines = _COLOUR.sub(b"", head).splitlines()
        return any(
            PRINTED.fullmatch(line.rstrip()) or AS_CANSEND.match(line) for line in lines[:50]
        )

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._channels = channels
        self._statistics = statistics
        self._batches = FrameBatches(filters, channels, statistics)
        self._time: StampedTimes | CountedTimes | None = None
        self.cycles: Cycles = ()

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in batches, see `LogFormat.read`."""
        self._time = None  # each file may have another form of stamps
        yield from read_lines(path, self._batches, self._statistics, report, self._take)
        if isinstance(self._time, CountedTimes):
            self._add_counted(self._time, self._time.end())
            yield self._batches.columns()

    def _take(self, lines: list[bytes], name: str, before: int, last: bool) -> None:
        lines = [_COLOUR.sub(b"", line).rstrip() for line in lines]
        if self._time is None:
            self._time = self._look(lines[:LOOK_LINES], name)
        for number, line in enumerate(lines, before + 1):
            if line and not line.startswith(b"\t"):  # explanation of an error frame (-e)
                fault = self._line(self._time, line, name, number)
                if fault is not None:
                    reason, words = ("cut_line", "the line is cut") if last else fault
                    self._statistics.reject_line(reason, name, number, f"{words}: {shown(line)}")

    def _line(
        self, time: StampedTimes | CountedTimes, line: bytes, name: str, number: int
    ) -> LineFault | None:
        """Process one line. Return why it cannot be used, or None."""
        match, t = PRINTED.fullmatch(line), None
        words = "the time stamp is missing, or is not one of candump"
        if isinstance(time, StampedTimes) and match is not None and match["stamp"] is not None:
            if time.fits(match["stamp"]):
                t = time.time(match["stamp"])
            else:
                words = "the time stamp has another form than in the lines before"
                time.other(name, number)
        frame = frame_of_line(line, match)
        if isinstance(frame, LineFault):
            return frame
        if isinstance(frame, str):
            self._statistics.ignore(frame)
            return None
        if isinstance(time, StampedTimes) and t is None:
            return LineFault("bad_timestamp", words)
        index = self._channels.index(frame.channel)
        if index is None:
            return LineFault("too_many_channels", "more than 255 channels")
        if t is not None:
            self._batches.add_frame(t, frame.can_id, frame.data, frame.channel, frame.fd)
        elif isinstance(time, CountedTimes):
            is_wanted = self._batches.is_wanted(index, frame.can_id, frame.channel)
            self._statistics.frames_read += not is_wanted
            self._add_counted(time, time.take_frame(frame, is_wanted))
        return None

    def _add_counted(self, time: CountedTimes, frames: list[tuple[float, ScreenFrame]]) -> None:
        if time.first is not None:
            self._statistics.stamp(time.first)
        for t, frame in frames:
            self._batches.add_frame(t, frame.can_id, frame.data, frame.channel, frame.fd)

    def _look(self, first: list[bytes], name: str) -> StampedTimes | CountedTimes:
        """Find the form of a file's time stamps.

        Raises LogError if it has no time stamps and no message to count time from.
        """
        lines = [line.rstrip() for line in first]
        matches = [PRINTED.fullmatch(line) for line in lines]
        stamps = [m["stamp"] for m in matches if m is not None and m["stamp"] is not None]
        if stamps:
            return StampedTimes(stamps)
        parsed = [frame_of_line(line, m) for line, m in zip(lines, matches, strict=True)]
        known = [
            (cycle, frame.can_id, frame.channel)
            for frame in parsed
            if isinstance(frame, ScreenFrame)
            for match, cycle in self.cycles
            if match.matches(frame.can_id, frame.channel)
        ]
        if not known:
            text = "its frames have no time stamps, and no message in it has a stated cycle"
            raise LogError(f"{name}: {text}; {REMEDY}")
        cycle, can_id, channel = min(known)
        self._statistics.note(
            f"{name}: the log has no time stamps. The time is counted by id "
            f"0x{can_id & CAN_EFF_MASK:X}, which should come every {1e3 * cycle:g} ms, and is "
            f"only roughly right; {REMEDY}"
        )
        return CountedTimes(can_id, channel, cycle)


FORMAT = CandumpScreenReader
