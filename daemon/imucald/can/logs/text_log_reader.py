"""Reads a log that is text, block by block; how its lines become frames is a parser's work."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from imucald.can.columns import FrameColumns, concatenate
from imucald.can.logs.ascii_columns import Bytes
from imucald.can.logs.candump_line import MAX_LINE_BYTES
from imucald.can.logs.log_format import DamageError, ReadStatistics
from imucald.can.logs.text_blocks import OpenLog, TextBlocks, open_source
from imucald.core.errors import LogError

PADDING: Final = 512
"""Bytes by which a block is longer than its text, so that runs may be read from any place."""

CHUNK_FRAMES: Final = 32_768
"""Frames gathered from blocks before they are passed on: what follows has costs per chunk."""

CHUNK_BLOCKS: Final = 8
"""Blocks after which they are passed on however few they are, so that progress shows."""

PIECE_LINES: Final = 64
"""Lines of a damaged file that are parsed at once."""

NEWLINE: Final = 0x0A

KEPT_BYTES: Final = 16 << 20
"""Freed memory that the C library may keep for reuse, above the arrays of one block (about 6 MiB
with their copies)."""

Place = tuple[str, int]
"""File name, number of lines before."""


class LineParser(Protocol):
    """Turns blocks of lines into columns; what is bad in them goes to the statistics."""

    def parse(self, buf: Bytes, size: int, place: Place) -> tuple[FrameColumns, int]:
        """Return the wanted frames of `buf[:size]`, whole lines, and the number of lines.

        `buf` is (size + PADDING,) or longer. Raises LogError at a bad line of a strict reading.
        """
        ...

    def parse_rest(self, text: bytes, place: Place) -> FrameColumns:
        """Return the frame (or none) of a file's last line, which lacks its newline."""
        ...

    def end(self) -> FrameColumns:
        """Return the frames that a file's end leaves over, and be ready for another file."""
        ...


def read_text_log(
    path: Path | str | OpenLog,
    parser: LineParser,
    statistics: ReadStatistics,
    report: Callable[[int], None],
) -> Iterator[FrameColumns]:
    """Yield the wanted frames of one file in chunks, as `LogFormat.read` says."""
    _keep_freed_memory()
    return _gathered(_blocks(path, parser, statistics, report))


def _blocks(
    path: Path | str | OpenLog,
    parser: LineParser,
    statistics: ReadStatistics,
    report: Callable[[int], None],
) -> Iterator[FrameColumns]:
    name, lines = str(path), 0
    with statistics.until_damage(path), open_source(path) as source:
        blocks = TextBlocks(source, PADDING, MAX_LINE_BYTES)
        for buf, size in blocks:
            if statistics.damage:
                for columns, count in _cautiously(parser, statistics, buf, size, (name, lines)):
                    lines += count
                    yield columns
                continue
            columns, count = parser.parse(buf, size, (name, lines))
            lines += count
            report(blocks.bytes_read)
            yield columns
        if blocks.damage and not lines:
            raise LogError(f"{name}: cannot be read: {blocks.damage}")
        if blocks.damage:
            # The last line is cut with the file, even where what is left of it can be read.
            where = f"{name}:{lines + 1}"
            statistics.reject("damaged_file", f"{where}: reading ends here: {blocks.damage}")
        elif blocks.rest:
            yield parser.parse_rest(blocks.rest, (name, lines))
    yield parser.end()


def _cautiously(
    parser: LineParser, statistics: ReadStatistics, buf: Bytes, size: int, place: Place
) -> Iterator[tuple[FrameColumns, int]]:
    """Parse a damaged file's block in small pieces: one with a sign of it is left out whole."""
    start, lines = 0, place[1]
    ends = np.flatnonzero(buf[:size] == NEWLINE)[PIECE_LINES - 1 :: PIECE_LINES] + 1
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
    """Let glibc reuse freed memory, instead of giving it back and faulting it in for each block.

    It sets its threshold for that to the largest block it has seen freed. The array is never
    touched, so it costs nothing; reading takes less than half the time. Elsewhere: no effect.
    """
    np.empty(KEPT_BYTES, np.uint8)


def _gathered(blocks: Iterator[FrameColumns]) -> Iterator[FrameColumns]:
    """Yield what several blocks hold as one, since rare frames make small columns."""
    parts: list[FrameColumns] = []
    count = frames = 0
    for part in blocks:
        count += 1
        if len(part):
            parts.append(part)
            frames += len(part)
        if parts and (frames >= CHUNK_FRAMES or count >= CHUNK_BLOCKS):
            yield concatenate(parts)
            parts, count, frames = [], 0, 0
    if parts:
        yield concatenate(parts)
