"""Count and filter single frames, and collect them in columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from imucald.can.columns import CLASSIC_BYTES, FD_BYTES, KNOWN_IDS, Channels, FrameColumns
from imucald.can.id_filter import IdFilters
from imucald.can.logs.candump_line import MAX_LINE_BYTES
from imucald.can.logs.log_format import ReadStatistics
from imucald.can.logs.text_blocks import Bytes, OpenLog, TextBlocks, open_source
from imucald.core.errors import LogError

BATCH_FRAMES: Final = 8192
"""Number of wanted frames collected before they are passed on."""

GatheredFrame = tuple[float, int, bytes, int, bool]
"""Time [s], id with flag, payload, channel index, CAN FD."""

Place = tuple[str, int]
"""File name, number of lines before this place."""


class FrameBatches:
    """Collects valid data frames. `columns` returns the wanted frames."""

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._filters = filters
        self._channels = channels
        self._statistics = statistics
        self._verdicts: dict[tuple[int, int], bool] = {}
        self._batch: list[GatheredFrame] = []

    @property
    def is_full(self) -> bool:
        """True if the batch is full, so that `columns` should be called."""
        return len(self._batch) >= BATCH_FRAMES

    def add_frame(self, t: float, can_id: int, data: bytes, channel: str, fd: bool) -> bool:
        """Count a valid frame and keep it if it is wanted. False if there are too many channels."""
        index = self._channels.index(channel)
        if index is None:
            return False
        if self._statistics.damage:
            self._statistics.follows(t, f"frame {self._statistics.frames_read + 1}")
        self._statistics.stamp(t)
        self._statistics.frames_read += 1
        if self.is_wanted(index, can_id, channel):
            self._batch.append((t, can_id, data, index, fd))
        return True

    def is_wanted(self, index: int, can_id: int, channel: str) -> bool:
        """True if frames with this id on this channel are wanted."""
        key = index, can_id
        if key not in self._verdicts:
            if len(self._verdicts) >= KNOWN_IDS:
                self._verdicts.clear()
            self._verdicts[key] = self._filters.filter_of(channel).wanted(can_id)
        return self._verdicts[key]

    def __len__(self) -> int:
        return len(self._batch)

    def drop_from(self, place: int) -> None:
        """Remove the frames collected since there were `place` of them."""
        del self._batch[place:]

    def columns(self) -> FrameColumns:
        """Return the frames collected so far, and start a new batch."""
        batch, self._batch = self._batch, []
        return columns_of_frames(batch, self._channels.names)


def read_lines(
    path: Path | str | OpenLog,
    batches: FrameBatches,
    statistics: ReadStatistics,
    report: Callable[[int], None],
    take: Callable[[list[bytes], str, int, bool], None],
) -> Iterator[FrameColumns]:
    """Yield the frames that `take` adds to the batches from the lines of a text.

    take: called with lines, the file's name, the number of lines before, and whether this is the
    last line without a newline. Raises LogError for a file that cannot be read at all.
    """

    def parse(buf: Bytes, size: int, place: Place) -> Iterator[tuple[FrameColumns, int]]:
        lines = buf[:size].tobytes().split(b"\n")[:-1]
        for start in range(0, len(lines), BATCH_FRAMES):
            piece = lines[start : start + BATCH_FRAMES]
            take(piece, place[0], place[1] + start, False)
            yield batches.columns(), len(piece)

    def parse_rest(text: bytes, place: Place) -> FrameColumns:
        take([text], *place, True)
        return batches.columns()

    yield from read_blocks(path, 0, statistics, report, parse, parse_rest)
    yield batches.columns()


def read_blocks(
    path: Path | str | OpenLog,
    padding: int,
    statistics: ReadStatistics,
    report: Callable[[int], None],
    parse: Callable[[Bytes, int, Place], Iterator[tuple[FrameColumns, int]]],
    parse_rest: Callable[[bytes, Place], FrameColumns],
) -> Iterator[FrameColumns]:
    """Yield the frames of a text, block by block.

    padding: free bytes behind each block. parse: called with a buffer and the size of its complete
    lines; yields frames and the number of their lines. parse_rest: called with the last line if it
    has no newline. Raises LogError for a file that cannot be read at all.
    """
    name, number = str(path), 0
    with statistics.until_damage(path), open_source(path) as source:
        blocks = TextBlocks(source, padding, MAX_LINE_BYTES)
        for buf, size in blocks:
            report(blocks.bytes_read)
            for columns, count in parse(buf, size, (name, number)):
                number += count
                yield columns
        if blocks.damage and not number:
            raise LogError(f"{name}: cannot be read: {blocks.damage}")
        if blocks.damage:
            # In a cut file, the last line is cut too, even if its remaining text is a valid line.
            text = f"{name}:{number + 1}: reading ends here: {blocks.damage}"
            statistics.reject("damaged_file", text)
        elif blocks.rest:
            yield parse_rest(blocks.rest, (name, number))


def columns_of_frames(batch: list[GatheredFrame], channels: tuple[str, ...]) -> FrameColumns:
    """Convert frames (the list may be empty) to columns."""
    t, can_id, data, channel, fd = zip(*batch, strict=True) if batch else ((),) * 5
    length = [len(payload) for payload in data]
    width = CLASSIC_BYTES if max(length, default=0) <= CLASSIC_BYTES else FD_BYTES
    text = b"".join(payload.ljust(width, b"\0") for payload in data)
    is_fd = np.array(fd, np.bool_)
    return FrameColumns(
        np.array(t, np.float64),
        np.array(can_id, np.uint32),
        np.array(length, np.uint8),
        np.frombuffer(text, np.uint8).reshape(len(batch), width),
        np.array(channel, np.uint8),
        channels,
        is_fd if is_fd.any() else None,
    )
