"""Read blocks of candump text in compiled code, which reads each byte once.

The compiled code accepts only lines that the strict reader (`candump_line`) accepts too. All other
lines are passed to the strict reader. Without the compiled code, the strict reader reads all lines.
This reader is also the reference in tests.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import CLASSIC_BYTES, FD_BYTES, Channels, FrameColumns
from imucald.can.id_filter import IdFilter
from imucald.can.logs.text_blocks import Bytes
from imucald.core.arrays import Index
from imucald.core.compiled import Kernels

PADDING: Final = 16
"""Extra bytes of a block after its text, because the compiled code reads whole words."""
LEAST_LINE: Final = len("(0.0) a 1#\n")
"""Length of the shortest line with a frame [bytes]."""
_NEW_CHANNEL, _LONG_FRAME = 1, 3
"""Reasons why the compiled code stopped before the end, if something must be done."""
_PLACE, _NUMBER, _FRAMES, _ODD, _AS_TEXT, _ANY_FD = range(6)
"""Indices of the counters of the compiled code."""


class Lines(Struct, frozen=True):
    """The contents of a block.

    frames: wanted frames, with the position of each line (N,). odd: number and position of each
    line for the strict reader (M, 2). count: number of all lines.
    """

    frames: FrameColumns
    place: Index
    odd: Index
    count: int


def line_at(buf: Bytes, start: int, size: int) -> bytes:
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


class LineReader:
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
        """Make columns for `most` frames."""
        self._columns: tuple[NDArray[Any], ...] = (
            np.empty(most),
            np.empty(most, np.uint32),
            np.empty(most, np.uint8),
            np.empty((most, self._width), np.uint8),
            np.empty(most, np.uint8),
            np.empty(most, np.bool_),
            np.empty(most, np.int64),
        )

    def read(self, kernels: Kernels, buf: Bytes, size: int) -> Lines:
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
                text = line_at(buf, start, size)
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
        return Lines(frames, place, np.concatenate(odd), int(counts[_NUMBER]))
