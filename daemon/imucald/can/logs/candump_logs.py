"""Candump text to columns, a block of lines at a time.

Every line is checked whole, but only wanted frames are turned into numbers. Each line's head is
compared with the shapes seen so far (`candump_shape`), then the id is read and the place of ``#``
and the number of digits are checked. What is left to know is whether all the rest are hexadecimal
digits: the block is searched for other characters once, and their number must be just that of the
marks and spaces the lines are known to hold. If not, they are counted line by line. Any line that
falls out anywhere goes to the strict reader of single lines (`candump_line`), which decides.
With the compiled part lines are taken one by one (`candump_lines`), to the same result.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from imucald.can.columns import CLASSIC_BYTES, FD_BYTES, Channels, FrameColumns, concatenate
from imucald.can.id_filter import IdFilters
from imucald.can.logs.ascii_columns import Bytes, hex_bytes, runs_at
from imucald.can.logs.candump_block import CandumpBlock, Hits
from imucald.can.logs.candump_line import REASONS, Line, parse_line, shown
from imucald.can.logs.candump_lines import LineReader, line_at
from imucald.can.logs.candump_shape import Layout, Shape
from imucald.can.logs.known_shapes import KnownShapes
from imucald.can.logs.log_format import ReadStatistics
from imucald.can.logs.text_blocks import OpenLog
from imucald.can.logs.text_log_reader import PADDING, Place, read_text_log
from imucald.core import compiled

_LOG_LINE: Final = re.compile(
    rb"^\([ \t]{0,32}\d{1,19}\.\d{1,19}\)[ \t]{1,32}\S{1,32}[ \t]{1,32}[0-9A-Fa-f]{3,8}#", re.M
)


class CandumpParser:
    """Turns blocks of candump text into columns; keeps what it learned from block to block."""

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._filters = filters
        self._channels = channels
        self._statistics = statistics
        self._shapes = KnownShapes[Shape, Hits](self._shape_of)
        self._lines = LineReader(channels, filters.of, self._index_of)

    def parse(self, buf: Bytes, size: int, place: Place) -> tuple[FrameColumns, int]:
        """Return the wanted frames of `buf[:size]`, whole lines, and the number of lines.

        `buf` is (size + PADDING,) or longer. Raises LogError at a bad line of a strict reading.
        """
        if compiled.kernels is not None:
            return self._parse_compiled(compiled.kernels, buf, size, place)
        block = CandumpBlock(buf, size)
        _, hits = self._shapes.find(len(block), block.text, block.find)
        odd, wrong = block.settle()
        if wrong is not None:
            hits = [h.only(~wrong[h.line]) for h in hits]
        if self._statistics.first_stamp is None:
            self._stamp_first(block.text(number) for number in range(len(block)))
        singles: list[tuple[int, Line]] = []
        for number in odd.tolist():
            line = self.judge(block.text(number), (place[0], place[1] + number))
            if line is not None:
                singles.append((number, line))
        self._statistics.frames_read += len(block) - len(odd)
        return self._columns(buf, hits, singles), len(block)

    def _parse_compiled(
        self, kernels: compiled.Kernels, buf: Bytes, size: int, place: Place
    ) -> tuple[FrameColumns, int]:
        """As `parse`."""
        found = self._lines.read(kernels, buf, size)
        if self._statistics.first_stamp is None:
            self._stamp_first(buf[:size].tobytes().split(b"\n"))
        singles: list[tuple[int, Line]] = []
        for number, start in found.odd.tolist():
            text = line_at(buf, start, size)
            line = self.judge(text, (place[0], place[1] + number))
            if line is not None:
                singles.append((start, line))
        self._statistics.frames_read += found.count - len(found.odd)
        if not singles:
            return found.frames, found.count
        both = [found.frames, _of_lines([line for _, line in singles], self._channels.names)]
        order = np.argsort(np.concatenate([found.place, [at for at, _ in singles]]))
        return concatenate(both).take(order), found.count

    def parse_rest(self, text: bytes, place: Place) -> FrameColumns:
        """Return the frame (or none) of a file's last line, which lacks its newline.

        It counts only where it is whole; else it was cut.
        """
        line = self.judge(text, place, last=True)
        return self._columns(np.zeros(PADDING, np.uint8), [], [] if line is None else [(0, line)])

    def end(self) -> FrameColumns:
        """Return no frames: each had its own time stamp."""
        return self._columns(np.zeros(PADDING, np.uint8), [], [])

    def judge(self, text: bytes, place: Place, last: bool = False) -> Line | None:
        """Read one line strictly and count it; return it if it is a wanted data frame."""
        line: Line | str | None = parse_line(text)
        if line is None:
            return None
        if isinstance(line, Line):
            self._statistics.stamp(line.t)
        if isinstance(line, Line) and line.kind != "data":
            self._statistics.ignore(line.kind)
            return None
        if isinstance(line, Line) and self._channels.index(line.channel) is None:
            line = "too_many_channels"
        if isinstance(line, str):
            reason = "cut_line" if last else line
            words = f"{REASONS[reason]}: {shown(text)}"
            self._statistics.reject_line(reason, place[0], place[1] + 1, words)
            return None
        self._statistics.frames_read += 1
        return line if self._filters.of(line.channel).wanted(line.can_id) else None

    def _stamp_first(self, lines: Iterable[bytes]) -> None:
        """Find the log's first frame, wanted or not."""
        for text in lines:
            line = parse_line(text)
            if isinstance(line, Line):
                self._statistics.stamp(line.t)
                return

    def _index_of(self, text: bytes) -> int | None:
        """The index of a line's channel; None where it is no line as candump lays it out, or there
        are too many."""
        line = parse_line(text)
        if not isinstance(line, Line) or line.layout is None:
            return None
        return self._channels.index(line.channel)

    def _shape_of(self, text: bytes) -> Shape | None:
        line = parse_line(text)
        if not isinstance(line, Line) or line.layout is None:
            return None
        index = self._channels.index(line.channel)
        if index is None:
            return None
        layout = Layout(*line.layout, line.channel)
        return Shape(layout, index, self._filters.of(line.channel))

    def _columns(
        self, buf: Bytes, hits: list[Hits], singles: list[tuple[int, Line]]
    ) -> FrameColumns:
        channels = self._channels.names
        parts = [_of_hits(buf, h, channels) for h in hits]
        if singles or not hits:
            parts.append(_of_lines([line for _, line in singles], channels))
        if len(parts) == 1:
            return parts[0]
        numbers = [h.line for h in hits] + [np.array([n for n, _ in singles], np.intp)]
        return concatenate(parts).take(np.argsort(np.concatenate(numbers), kind="stable"))


class CandumpReader:
    """Reads files of candump text into columns."""

    endings: ClassVar[tuple[str, ...]] = (".log",)

    @staticmethod
    def begins(head: bytes) -> bool:
        """Whether one of the first lines is `(seconds) channel id#...`."""
        return _LOG_LINE.search(head) is not None

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._statistics = statistics
        self._parser = CandumpParser(filters, channels, statistics)

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in chunks, as `LogFormat.read` says."""
        return read_text_log(path, self._parser, self._statistics, report)


_DIGIT_MASKS: Final = np.tril(np.full((2 * FD_BYTES + 1, 2 * FD_BYTES), 0xFF, np.uint8), -1).view(
    "<u8"
)
"""(129, 16): ones over as many characters as data digits."""


def _of_hits(buf: Bytes, hits: Hits, channels: tuple[str, ...]) -> FrameColumns:
    count = len(hits.line)
    length = (hits.digits >> 1).astype(np.uint8)
    words = 2 * (CLASSIC_BYTES if length.max(initial=0) <= CLASSIC_BYTES else FD_BYTES) // 8
    digits = runs_at(buf, hits.at, words)
    digits &= _DIGIT_MASKS[:, :words][hits.digits]
    data = hex_bytes(digits).astype("<u4").view(np.uint8).reshape(count, 4 * words)
    channel = np.full(count, hits.shape.channel_index, np.uint8)
    t = hits.shape.times(buf, hits.start)
    fd = np.ones(count, np.bool_) if hits.fd else None
    return FrameColumns(t, hits.can_id, length, data, channel, channels, fd)


def _of_lines(lines: list[Line], channels: tuple[str, ...]) -> FrameColumns:
    longest = max((len(line.data) for line in lines), default=0)
    width = CLASSIC_BYTES if longest <= CLASSIC_BYTES else FD_BYTES
    text = b"".join(line.data.ljust(width, b"\0") for line in lines)
    fd = np.array([line.fd for line in lines], np.bool_)
    return FrameColumns(
        np.array([line.t for line in lines], np.float64),
        np.array([line.can_id for line in lines], np.uint32),
        np.array([len(line.data) for line in lines], np.uint8),
        np.frombuffer(text, np.uint8).reshape(len(lines), width),
        np.array([channels.index(line.channel) for line in lines], np.uint8),
        channels,
        fd if fd.any() else None,
    )


FORMAT = CandumpReader
