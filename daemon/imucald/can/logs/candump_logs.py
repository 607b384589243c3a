"""Convert candump text to columns, one block of lines at a time.

The compiled code (`candump_lines`) reads the lines in candump's usual layout, some million per
second. Any other line is passed to the strict reader of single lines (`candump_line`). Without the
compiled code, the strict reader reads all lines.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from imucald.can.columns import Channels, FrameColumns, concatenate
from imucald.can.id_filter import IdFilters
from imucald.can.logs.candump_line import REASONS, Line, parse_line, shown
from imucald.can.logs.candump_lines import PADDING, LineReader, line_at
from imucald.can.logs.frame_batches import Place, columns_of_frames, read_blocks
from imucald.can.logs.log_format import DamageError, ReadStatistics
from imucald.can.logs.text_blocks import Bytes, OpenLog
from imucald.core import compiled

PIECE_LINES: Final = 64
"""Number of lines of a damaged file that are parsed together."""

KEPT_BYTES: Final = 16 << 20
"""Freed memory that the C library may keep for reuse [bytes]. The limit is more than the arrays of
one block (about 6 MiB with their copies)."""

_LOG_LINE: Final = re.compile(
    rb"^\([ \t]{0,32}\d{1,19}\.\d{1,19}\)[ \t]{1,32}\S{1,32}[ \t]{1,32}[0-9A-Fa-f]{3,8}#", re.M
)


class CandumpParser:
    """Converts blocks of candump text to columns. The parser keeps its state from block to
    block."""

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._filters = filters
        self._channels = channels
        self._statistics = statistics
        self._lines = LineReader(channels, filters.filter_of, self._index_of)

    def parse(self, buf: Bytes, size: int, place: Place) -> tuple[FrameColumns, int]:
        """Return the wanted frames in the complete lines `buf[:size]`, and the number of lines.

        `buf` is (size + PADDING,) or longer. In strict mode, a bad line raises LogError.
        """
        if compiled.kernels is None:
            texts = buf[:size].tobytes().split(b"\n")[:-1]
            lines = [self.judge(text, (place[0], n)) for n, text in enumerate(texts, place[1])]
            return self._columns(lines), len(texts)
        found = self._lines.read(compiled.kernels, buf, size)
        if self._statistics.first_stamp is None:
            self._stamp_first(buf[:size].tobytes().split(b"\n"))
        singles, places = [], [found.place]
        for number, start in found.odd.tolist():
            line = self.judge(line_at(buf, start, size), (place[0], place[1] + number))
            if line is not None:
                singles.append(line)
                places.append(np.array([start]))
        self._statistics.frames_read += found.count - len(found.odd)
        if not singles:
            return found.frames, found.count
        frames = concatenate([found.frames, self._columns(singles)])
        return frames.take(np.argsort(np.concatenate(places))), found.count

    def parse_rest(self, text: bytes, place: Place) -> FrameColumns:
        """Return the frame (or none) of a file's last line without newline.

        The line is used only if it is complete. An incomplete line counts as cut.
        """
        return self._columns([self.judge(text, place, last=True)])

    def judge(self, text: bytes, place: Place, last: bool = False) -> Line | None:
        """Parse one line strictly and count it. Return it if it is a wanted data frame."""
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
        return line if self._filters.filter_of(line.channel).wanted(line.can_id) else None

    def _stamp_first(self, lines: Iterable[bytes]) -> None:
        """Find the time stamp of the log's first frame, wanted or not."""
        for text in lines:
            line = parse_line(text)
            if isinstance(line, Line):
                self._statistics.stamp(line.t)
                return

    def _index_of(self, text: bytes) -> int | None:
        """Return the index of a line's channel. None if the line does not have candump's layout, or
        if there are too many channels."""
        line = parse_line(text)
        if not isinstance(line, Line) or line.layout is None:
            return None
        return self._channels.index(line.channel)

    def _columns(self, lines: Iterable[Line | None]) -> FrameColumns:
        names = self._channels.names
        index = {name: k for k, name in enumerate(names)}
        frames = [
            (line.t, line.can_id, line.data, index[line.channel], line.fd)
            for line in lines
            if line is not None
        ]
        return columns_of_frames(frames, names)


class CandumpReader:
    """Reads files of candump text into columns."""

    endings: ClassVar[tuple[str, ...]] = (".log",)

    @staticmethod
    def begins(head: bytes) -> bool:
        """True if one of the first lines has the form `(seconds) channel id#...`."""
        return _LOG_LINE.search(head) is not None

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._statistics = statistics
        self._parser = CandumpParser(filters, channels, statistics)

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in chunks, see `LogFormat.read`."""
        _keep_freed_memory()
        parser = self._parser
        parts = read_blocks(
            path, PADDING, self._statistics, report, self._parsed, parser.parse_rest
        )
        return _gathered(parts)

    def _parsed(self, buf: Bytes, size: int, place: Place) -> Iterator[tuple[FrameColumns, int]]:
        if self._statistics.damage:
            return _cautiously(self._parser, self._statistics, buf, size, place)
        return iter([self._parser.parse(buf, size, place)])


def _cautiously(
    parser: CandumpParser, statistics: ReadStatistics, buf: Bytes, size: int, place: Place
) -> Iterator[tuple[FrameColumns, int]]:
    """Parse a block of a damaged file in small pieces. A damaged piece is dropped completely."""
    start, lines = 0, place[1]
    ends = np.flatnonzero(buf[:size] == 0x0A)[PIECE_LINES - 1 :: PIECE_LINES] + 1
    for end in [*ends.tolist(), size]:
        if end == start:
            continue
        before = statistics.frames_read
        columns, count = parser.parse(buf[start:], end - start, (place[0], lines))
        try:
            for t in columns.t.tolist():
                statistics.follows(t, f"{place[0]}:{lines + 1}")
        except DamageError:
            statistics.frames_read = before
            raise
        start, lines = end, lines + count
        yield columns, count


def _keep_freed_memory() -> None:
    """Make glibc keep freed memory for reuse, instead of returning it to the system each time.

    glibc sets its threshold to the largest block that was freed. The array here is never written,
    so it costs no memory. Reading then takes less than half the time. Without glibc, the function
    has no effect.
    """
    np.empty(KEPT_BYTES, np.uint8)


def _gathered(blocks: Iterator[FrameColumns]) -> Iterator[FrameColumns]:
    """Join the frames of several blocks, since rare frames make small columns."""
    parts: list[FrameColumns] = []
    count = frames = 0
    for part in blocks:
        count += 1
        if len(part):
            parts.append(part)
            frames += len(part)
        # later steps have costs per chunk
        # so that progress is visible
        if parts and (frames >= 32_768 or count >= 8):
            yield concatenate(parts)
            parts, count, frames = [], 0, 0
    if parts:
        yield concatenate(parts)


FORMAT = CandumpReader
