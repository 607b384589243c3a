"""Convert candump text to columns, one block of lines at a time.

The compiled code reads the lines in candump's usual layout, some million per second. It accepts
only lines that the strict reader of single lines (`candump_line`) accepts too, and passes any other
line to it. Without the compiled code, the strict reader reads all lines. It is also the reference
in tests.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import CLASSIC_BYTES, FD_BYTES, Channels, FrameColumns, concatenate
from imucald.can.id_filter import IdFilter, IdFilters
from imucald.can.logs.candump_line import REASONS, Line, parse_line, shown
from imucald.can.logs.frame_batches import Place, columns_of_frames, read_blocks
from imucald.can.logs.log_format import DamageError, ReadStatistics
from imucald.can.logs.text_blocks import Bytes, OpenLog
from imucald.core import compiled
from imucald.core.arrays import Index
from imucald.core.compiled import Kernels

PIECE_LINES: Final = 64
"""Number of lines of a damaged file that are parsed together."""
_LOG_LINE: Final = re.compile(
    rb"^\([ \t]{0,32}\d{1,19}\.\d{1,19}\)[ \t]{1,32}\S{1,32}[ \t]{1,32}[0-9A-Fa-f]{3,8}#", re.M
)
PADDING: Final = 16
"""Extra bytes of a block after its text, because the compiled code reads whole words."""
LEAST_LINE: Final = len("(0.0) a 1#\n")
"""Length of the shortest line with a frame [bytes]."""
_NEW_CHANNEL, _LONG_FRAME = 1, 3
"""Reasons why the compiled code stopped before the end, if something must be done."""
_PLACE, _NUMBER, _FRAMES, _ODD, _AS_TEXT, _ANY_FD = range(6)
"""Indices of the counters of the compiled code."""


class _Lines(Struct, frozen=True):
    """The contents of a block.

    frames: wanted frames, with the position of each line (N,). odd: number and position of each
    line for the strict reader (M, 2). count: number of all lines.
    """

    frames: FrameColumns
    place: Index
    odd: Index
    count: int


def _line_at(buf: Bytes, start: int, size: int) -> bytes:
    """Return the line of `buf[:size]` that begins at index `start`, without its newline."""
    length = 256
    while (end := (text := buf[start : min(start + length, size)].tobytes()).find(b"\n")) < 0:
        length *= 4
    return text[:end]


def _filters(channels: Channels, filter_of: Callable[[str], IdFilter]) -> tuple[NDArray[Any], ...]:
    """Return the filters of the channels found so far, as arrays (see `core/kernels/candump.c`)."""
    filters = [filter_of(name) for name in channels.names]
    names = [bytes([len(name)]) + name.encode("ascii").ljust(32, b"\0") for name in channels.names]
    masked = [pair for one in filters for pair in one.masked]
    return (
        np.frombuffer(b"".join(names), np.uint8).reshape(len(names), 33),
        np.array([one.verdict for one in filters], np.uint8).reshape(len(filters), 16**3),
        np.array([one.everything for one in filters], np.uint8),
        np.concatenate([np.zeros(0, np.uint32), *(one.exact for one in filters)]),
        np.cumsum([0, *(len(one.exact) for one in filters)]),
        np.array(masked, np.uint32).reshape(len(masked), 2),
        np.cumsum([0, *(len(one.masked) for one in filters)]),
    )


class _LineReader:
    """Reads the blocks of one recording.

    index_of: called with a line of a new channel. Returns the channel's index if the line is valid
    and there are not too many channels, else None.
    """

    def __init__(
        self,
        channels: Channels,
        filter_of: Callable[[str], IdFilter],
        index_of: Callable[[bytes], int | None],
    ) -> None:
        self._channels, self._filter_of, self._index_of = channels, filter_of, index_of
        self._known: tuple[NDArray[Any], ...] | None = None
        self._width = CLASSIC_BYTES
        self._odd = np.empty((4096, 2), np.int64)
        self._make(0)

    def _make(self, most: int) -> None:
        self._columns: tuple[NDArray[Any], ...] = (
            np.empty(most),
            np.empty(most, np.uint32),
            np.empty(most, np.uint8),
            np.empty((most, self._width), np.uint8),
            np.empty(most, np.uint8),
            np.empty(most, np.bool_),
            np.empty(most, np.int64),
        )

    def read(self, kernels: Kernels, buf: Bytes, size: int) -> _Lines:
        """Read the complete lines in `buf[:size]`. `buf` must be at least `PADDING` longer."""
        if len(self._columns[0]) < size // LEAST_LINE + 1:
            self._make(size // LEAST_LINE + 1)
        odd, counts, stopped = [self._odd[:0]], np.zeros(6, np.int64), -1
        while stopped:
            self._known = self._known or _filters(self._channels, self._filter_of)
            counts[_ODD] = 0
            stopped = kernels.candump(buf, size, *self._known, *self._columns, self._odd, counts)
            odd.append(self._odd[: counts[_ODD]].copy())
            if stopped == _LONG_FRAME:  # begin again with wider columns
                self._width = FD_BYTES
                self._make(len(self._columns[0]))
                return self.read(kernels, buf, size)
            if stopped == _NEW_CHANNEL:
                number, start = int(counts[_NUMBER]), int(counts[_PLACE])
                text = _line_at(buf, start, size)
                if self._index_of(text) is None:
                    odd.append(np.array([[number, start]]))
                    counts[_PLACE], counts[_NUMBER] = start + len(text) + 1, number + 1
                else:
                    self._known = None
        n = int(counts[_FRAMES])
        t, can_id, length, data, channel, fd, place = (
            column[:n].copy() for column in self._columns
        )
        if counts[_AS_TEXT]:
            for i in np.flatnonzero(np.isnan(t)).tolist():
                start = int(place[i]) + 1
                t[i] = float(buf[start : start + 40].tobytes().partition(b")")[0])
        if not length.max(initial=0) > CLASSIC_BYTES:
            data = np.ascontiguousarray(data[:, :CLASSIC_BYTES])
        frames = FrameColumns(
            t, can_id, length, data, channel, self._channels.names, fd if counts[_ANY_FD] else None
        )
        return _Lines(frames, place, np.concatenate(odd), int(counts[_NUMBER]))


class CandumpReader:
    """Reads files of candump text into columns."""

    endings: ClassVar[tuple[str, ...]] = (".log",)

    @staticmethod
    def begins(head: bytes) -> bool:
        """True if one of the first lines has the form `(seconds) channel id#...`."""
        return _LOG_LINE.search(head) is not None

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._filters = filters
        self._channels = channels
        self._statistics = statistics
        self._lines = _LineReader(channels, filters.filter_of, self._index_of)

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in chunks, see `LogFormat.read`."""
        parts: list[FrameColumns] = []
        count = frames = 0
        for part in read_blocks(
            path, PADDING, self._statistics, report, self._pieces, self._parse_rest
        ):
            count += 1
            if len(part):
                parts.append(part)
                frames += len(part)
            # Rare frames make small columns, and later steps have costs per chunk; but progress
            # must be visible.
            if parts and (frames >= 32_768 or count >= 8):
                yield concatenate(parts)
                parts, count, frames = [], 0, 0
        if parts:
            yield concatenate(parts)

    def _pieces(self, buf: Bytes, size: int, place: Place) -> Iterator[tuple[FrameColumns, int]]:
        """Parse a block. In a damaged file, small pieces are parsed, and a damaged piece is dropped
        completely."""
        if not self._statistics.damage:
            yield self._parse(buf, size, place)
            return
        start, lines = 0, place[1]
        ends = np.flatnonzero(buf[:size] == ord("\n"))[PIECE_LINES - 1 :: PIECE_LINES] + 1
        for end in dict.fromkeys([*ends.tolist(), size]):
            before = self._statistics.frames_read
            columns, count = self._parse(buf[start:], end - start, (place[0], lines))
            try:
                for t in columns.t.tolist():
                    self._statistics.follows(t, f"{place[0]}:{lines + 1}")
            except DamageError:
                self._statistics.frames_read = before
                raise
            start, lines = end, lines + count
            yield columns, count

    def _parse(self, buf: Bytes, size: int, place: Place) -> tuple[FrameColumns, int]:
        """Return the wanted frames in the complete lines `buf[:size]`, and the number of lines.

        `buf` is (size + PADDING,) or longer. In strict mode, a bad line raises LogError.
        """
        if compiled.kernels is None:
            texts = buf[:size].tobytes().split(b"\n")[:-1]
            lines = [self._judge(text, (place[0], n)) for n, text in enumerate(texts, place[1])]
            return self._columns(lines), len(texts)
        found = self._lines.read(compiled.kernels, buf, size)
        if self._statistics.first_stamp is None:
            self._stamp_first(buf[:size].tobytes().split(b"\n"))
        singles, places = [], [found.place]
        for number, start in found.odd.tolist():
            line = self._judge(_line_at(buf, start, size), (place[0], place[1] + number))
            if line is not None:
                singles.append(line)
                places.append(np.array([start]))
        self._statistics.frames_read += found.count - len(found.odd)
        if not singles:
            return found.frames, found.count
        frames = concatenate([found.frames, self._columns(singles)])
        return frames.take(np.argsort(np.concatenate(places))), found.count

    def _parse_rest(self, text: bytes, place: Place) -> FrameColumns:
        """Return the frame (or none) of a file's last line without newline.

        The line is used only if it is complete. An incomplete line counts as cut.
        """
        return self._columns([self._judge(text, place, last=True)])

    def _judge(self, text: bytes, place: Place, last: bool = False) -> Line | None:
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
        if not isinstance(line, Line) or not line.is_usual:
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


FORMAT = CandumpReader
