"""Recorded logs, one after another, as columns of frames.

Candump text (``.log`` or any other name, plain or gzip, "-" for standard input) is read by
columns; ``.asc .blf .trc .csv .mf4 .db`` through python-can. Several files are read in the order
given and as one recording: where a later file begins at an earlier time, so do its frames, and
whoever makes stream time of it meets a discontinuity.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from imucald.can.columns import (
    CAN_EFF_FLAG,
    Channels,
    FrameColumns,
    IdFilters,
    IdMatch,
    concatenate,
)
from imucald.can.logs.candump import PADDING, CandumpParser
from imucald.can.logs.candump_line import MAX_LINE_BYTES
from imucald.can.logs.candump_writer import CandumpWriter
from imucald.can.logs.python_can_logs import PythonCanReader, is_python_can_format
from imucald.can.logs.read_statistics import ReadStatistics
from imucald.can.logs.text_blocks import STDIN, TextBlocks, open_source
from imucald.core.errors import LogError

__all__ = ["CAN_EFF_FLAG", "CandumpWriter", "FrameColumns", "IdMatch", "LogReader"]

CHUNK_FRAMES: Final = 16_384
"""Frames gathered from blocks before they are passed on: what follows has costs per chunk."""

CHUNK_BLOCKS: Final = 8
"""Blocks after which they are passed on however few they are, so that progress shows."""

KEPT_BYTES: Final = 16 << 20
"""Freed memory that the C library may keep for reuse, above the arrays of one block (about 6 MiB
with their copies)."""

Progress = Callable[[int, int | None], None]
"""Called with bytes read and bytes in all (None where standard input is among the files)."""


class LogReader:
    """Iterate over the wanted data frames of recorded logs, in recorded order.

    Bad lines are counted in `rejected` by reason and skipped; `problems` has the first of them as
    "file:line: reason". With strict the first one raises LogError, as does always a file that
    cannot be opened or is no log at all. Each iteration reads, and counts, from the start.
    """

    def __init__(
        self,
        paths: Sequence[Path | str],
        keep: Sequence[IdMatch] | None = None,
        strict: bool = False,
        progress: Progress | None = None,
    ) -> None:
        """keep: which frames are wanted; None for all."""
        self._paths = list(paths)
        self._keep = keep
        self._progress = progress
        self._statistics = ReadStatistics(strict)
        self._bytes_before = 0
        self._bytes_total: int | None = None

    @property
    def frames_read(self) -> int:
        """Return the number of all valid frames so far, wanted or not."""
        return self._statistics.frames_read

    @property
    def first_stamp(self) -> float | None:
        """Return the time stamp of the first valid frame so far [s], wanted or not."""
        return self._statistics.first_stamp

    @property
    def ignored(self) -> dict[str, int]:
        """Return how many of them are remote_frame, error_frame, xl_frame: never passed on."""
        return dict(self._statistics.ignored)

    @property
    def rejected(self) -> dict[str, int]:
        """Return the number of rejections by reason."""
        return dict(self._statistics.rejected)

    @property
    def problems(self) -> list[str]:
        """Return the first rejections as texts, "file:line: reason: line"."""
        return list(self._statistics.problems)

    def __iter__(self) -> Iterator[FrameColumns]:
        """Yield chunks of bounded size, none of them empty. Raises LogError."""
        self._statistics = ReadStatistics(self._statistics.strict)
        self._bytes_before = 0
        self._bytes_total = _total_bytes(self._paths)
        _keep_freed_memory()
        channels, filters = Channels(), IdFilters(self._keep)
        candump = CandumpParser(filters, channels, self._statistics)
        foreign = PythonCanReader(filters, channels, self._statistics)
        for path in self._paths:
            if is_python_can_format(path):
                yield from foreign.read(Path(path), self._report)
            else:
                yield from _gathered(self._read_candump(path, candump))
            self._bytes_before += _file_bytes(path)
            self._report(0)

    def _report(self, bytes_of_file: int) -> None:
        if self._progress is not None:
            self._progress(self._bytes_before + bytes_of_file, self._bytes_total)

    def _read_candump(self, path: Path | str, parser: CandumpParser) -> Iterator[FrameColumns]:
        name, lines = str(path), 0
        with open_source(path) as source:
            blocks = TextBlocks(source, PADDING, MAX_LINE_BYTES)
            for buf, size in blocks:
                columns, count = parser.parse(buf, size, (name, lines))
                lines += count
                self._report(blocks.bytes_read)
                yield columns
            if blocks.damage and not lines:
                raise LogError(f"{name}: cannot be read: {blocks.damage}")
            if blocks.damage:
                # The last line is cut with the file, even where what is left of it can be read.
                where = f"{name}:{lines + 1}"
                self._statistics.reject(
                    "damaged_file", f"{where}: reading ends here: {blocks.damage}"
                )
            elif blocks.rest:
                yield parser.parse_rest(blocks.rest, (name, lines))


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


def _file_bytes(path: Path | str) -> int:
    try:
        return 0 if str(path) == STDIN else os.stat(path).st_size  # noqa: PTH116
    except OSError:
        return 0


def _total_bytes(paths: Sequence[Path | str]) -> int | None:
    if any(str(path) == STDIN for path in paths):
        return None
    return sum(_file_bytes(path) for path in paths)
