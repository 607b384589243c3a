"""What candump prints on a screen (not -L or -l), and what people copy from there.

    (1436509052.249713)  can0  044   [5]  2A 36 6C 2B BA      -t a
    (2015-07-10 08:17:32.249713)  can0  044   [5]  ...        -t A, taken as UTC
    (000.010250)  can0  044   [5]  ...                        -t z since the start, -t d differences
    can0  TX B -  200  [12]  11 22 ...                        -x; [two digits] is CAN FD

With -a (text), -c (colours), -i (binary digits) and -S (last byte first) too. Without time stamps,
and as cansend takes it (044#2A366C2BBA), time is counted from a message whose cycle is stated;
where no such message comes, the file is refused with a remedy.

Nearly all lines have one of a few shapes (`candump_screen_shape`) and are read together; any other
goes to the strict reader of single lines (`candump_screen_line`), which decides.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_MASK, Channels, FrameColumns, concatenate
from imucald.can.id_filter import IdFilters
from imucald.can.logs.ascii_columns import Bytes, Index, line_ends
from imucald.can.logs.candump_line import shown
from imucald.can.logs.candump_screen_line import (
    AS_CANSEND,
    PRINTED,
    LineFault,
    ScreenFrame,
    frame_of_line,
)
from imucald.can.logs.candump_screen_shape import Found, ScreenShape
from imucald.can.logs.candump_screen_times import CountedTimes, StampedTimes
from imucald.can.logs.frame_batches import columns_of_frames
from imucald.can.logs.known_shapes import KnownShapes
from imucald.can.logs.log_format import Cycles, ReadStatistics
from imucald.can.logs.text_blocks import OpenLog
from imucald.can.logs.text_log_reader import PADDING, Place, read_text_log
from imucald.core.errors import LogError

REMEDY: Final = "record with: candump -l can0"

LOOK_LINES: Final = 200
"""First lines by which differences are separated from times since the start."""

_COLOUR: Final = re.compile(rb"\x1b\[[0-9;]*m")
_ESCAPE: Final = 0x1B


class CandumpScreenParser:
    """Turns blocks of screen output into columns; keeps what it learned from block to block."""

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._filters = filters
        self._channels = channels
        self._statistics = statistics
        self._shapes = KnownShapes[ScreenShape, Found](self._shape_of)
        self._time: StampedTimes | CountedTimes | None = None
        self.cycles: Cycles = ()

    def parse(self, buf: Bytes, size: int, place: Place) -> tuple[FrameColumns, int]:
        """Return the wanted frames of whole lines, as `LineParser.parse` says."""
        if (buf[:size] == _ESCAPE).any():
            text = _COLOUR.sub(b"", buf[:size].tobytes())
            buf, size = np.frombuffer(text + bytes(PADDING), np.uint8), len(text)
        stops = line_ends(buf, size)
        starts = np.concatenate([[0], stops[:-1] + 1])
        if self._time is None:
            few = zip(starts[:LOOK_LINES].tolist(), stops[:LOOK_LINES].tolist(), strict=True)
            self._time = self._look([buf[a:b].tobytes() for a, b in few], place[0])
        left, found = self._find(buf, starts, stops)
        values = np.full(len(stops), np.nan)
        for part in found:
            values[part.line] = part.stamp
        singles: list[tuple[int, ScreenFrame]] = []
        for number in left.tolist():
            line = buf[starts[number] : stops[number]].tobytes()
            frame, value = self._judge(line, (place[0], place[1] + number))
            values[number] = np.nan if value is None else value
            if frame is not None:
                singles.append((number, frame))
        return self._timed([*found, self._of_singles(singles)], values), len(stops)

    def parse_rest(self, text: bytes, place: Place) -> FrameColumns:
        """Return the frame (or none) of a file's last line, which lacks its newline.

        It counts only where it is whole; else it was cut.
        """
        line = _COLOUR.sub(b"", text)
        if self._time is None:
            self._time = self._look([line], place[0])
        frame, value = self._judge(line, place, last=True)
        values = np.array([np.nan if value is None else value])
        singles = [] if frame is None else [(0, frame)]
        return self._timed([self._of_singles(singles)], values)

    def end(self) -> FrameColumns:
        """Return the frames whose cycle the file's end cut; another file's stamps may differ."""
        time, self._time = self._time, None
        rest = time.rest() if isinstance(time, CountedTimes) else None
        if isinstance(time, CountedTimes) and time.first is not None:
            self._statistics.stamp(time.first)
        return columns_of_frames([], self._channels.names) if rest is None else rest

    def _look(self, first: list[bytes], name: str) -> StampedTimes | CountedTimes:
        """How a file's stamps are meant. Raises LogError where it has none, and nothing counts."""
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
            text = "its frames have no time stamps, and none is of a message with a stated cycle"
            raise LogError(f"{name}: {text}; {REMEDY}")
        cycle, can_id, channel = min(known)
        self._statistics.note(
            f"{name}: no time stamps: time is counted from id 0x{can_id & CAN_EFF_MASK:X}, stated "
            f"every {1e3 * cycle:g} ms, and is only as exact as that; {REMEDY}"
        )
        return CountedTimes(can_id, channel, cycle)

    def _find(self, buf: Bytes, starts: Index, stops: Index) -> tuple[Index, list[Found]]:
        """The lines that have none of the known shapes, and the frames of the others."""
        times = self._time if isinstance(self._time, StampedTimes) else None

        def of_shape(shape: ScreenShape, lines: Index) -> tuple[Index, list[Found]]:
            if times is not None and not times.fits(shape.stamp):
                return lines, []
            left, found = shape.find(buf, starts, lines, times)
            return left, [found]

        def text(line: int) -> bytes:
            return buf[starts[line] : stops[line]].tobytes()

        return self._shapes.find(len(stops), text, of_shape)

    def _shape_of(self, line: bytes) -> ScreenShape | None:
        match = PRINTED.fullmatch(line.rstrip())
        if match is None or not ScreenShape.can_be_of(match):
            return None
        if isinstance(self._time, StampedTimes) and not self._time.fits(match["stamp"]):
            return None
        frame = frame_of_line(line, match)
        if not isinstance(frame, ScreenFrame) or not frame.data:
            return None
        index = self._channels.index(frame.channel)
        if index is None:
            return None
        return ScreenShape(match, index, self._channels, self._filters.of(frame.channel))

    def _judge(
        self, text: bytes, place: Place, last: bool = False
    ) -> tuple[ScreenFrame | None, float | None]:
        """Read one line strictly and count it: its frame, and what its stamp spells [s]."""
        line, time = text.rstrip(), self._time
        if not line or line.startswith(b"\t"):  # what -e explains about an error frame
            return None, None
        match, value = PRINTED.fullmatch(line), None
        words = "the time stamp is missing, or none of candump's"
        if isinstance(time, StampedTimes) and match is not None and match["stamp"] is not None:
            if time.fits(match["stamp"]):
                value = time.value(match["stamp"])
            else:
                words = "the time stamp has another form than those before"
                time.other(place[0], place[1] + 1)
        parsed = frame_of_line(line, match)
        if isinstance(parsed, str):
            self._statistics.ignore(parsed)
            return None, value
        if isinstance(parsed, ScreenFrame):
            if isinstance(time, StampedTimes) and value is None:
                parsed = LineFault("bad_timestamp", words)
            elif self._channels.index(parsed.channel) is None:
                parsed = LineFault("too_many_channels", "more than 255 channels")
        if isinstance(parsed, ScreenFrame):
            return parsed, value
        reason, words = ("cut_line", "the line is cut") if last else parsed
        self._statistics.reject_line(reason, place[0], place[1] + 1, f"{words}: {shown(text)}")
        return None, value

    def _of_singles(self, singles: list[tuple[int, ScreenFrame]]) -> Found:
        """Frames that were read one by one, with their lines."""
        names, frames = self._channels.names, [frame for _, frame in singles]
        channel = [names.index(frame.channel) for frame in frames]
        wanted = [self._filters.of(frame.channel).wanted(frame.can_id) for frame in frames]
        ours = [
            (0.0, frame.can_id, frame.data, index, frame.fd)
            for frame, index, is_ours in zip(frames, channel, wanted, strict=True)
            if is_ours
        ]
        return Found(
            np.array([number for number, _ in singles], np.intp),
            np.array(channel, np.uint8),
            np.array([frame.can_id for frame in frames], np.uint32),
            np.zeros(len(singles)),  # the block's stamps are known line by line
            np.array(wanted, np.bool_),
            columns_of_frames(ours, names),
        )

    def _timed(self, found: list[Found], values: NDArray[np.float64]) -> FrameColumns:
        """The wanted frames of a block in order, with their times; counts all frames.

        values: what the stamp of each line spells, NaN where there is none.
        """
        lines = np.concatenate([part.line[part.wanted] for part in found])
        order = np.argsort(lines, kind="stable")
        frames, lines = concatenate([part.frames for part in found]).take(order), lines[order]
        every = np.concatenate([part.line for part in found])
        self._statistics.frames_read += len(every)
        if isinstance(self._time, StampedTimes):
            t = self._time.times(values)
            if len(every):
                self._statistics.stamp(float(t[every.min()]))
            return frames.at(t[lines])
        assert self._time is not None  # what a block's frames are looked at for
        return self._counted(self._time, found, frames, lines)

    def _counted(
        self, time: CountedTimes, found: list[Found], frames: FrameColumns, lines: Index
    ) -> FrameColumns:
        every = np.sort(np.concatenate([part.line for part in found]))
        index = self._channels.index(time.channel)
        ends = [p.line[(p.can_id == time.can_id) & (p.channel == index)] for p in found]
        places, ends_at = (
            np.searchsorted(every, at) for at in (lines, np.sort(np.concatenate(ends)))
        )
        timed = time.take(frames, places, ends_at, len(every))
        if time.first is not None:
            self._statistics.stamp(time.first)
        return timed


class CandumpScreenReader:
    """Reads files of candump's screen output into columns."""

    endings: ClassVar[tuple[str, ...]] = ()

    @staticmethod
    def begins(head: bytes) -> bool:
        """Whether one of the first lines is printed by candump, or is as cansend takes it."""
        lines = _COLOUR.sub(b"", head).splitlines()
        return any(
            PRINTED.fullmatch(line.rstrip()) or AS_CANSEND.match(line) for line in lines[:50]
        )

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._statistics = statistics
        self._parser = CandumpScreenParser(filters, channels, statistics)
        self.cycles: Cycles = ()

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in chunks, as `LogFormat.read` says."""
        self._parser.cycles = self.cycles
        return read_text_log(path, self._parser, self._statistics, report)


FORMAT = CandumpScreenReader
