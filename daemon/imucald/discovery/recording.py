"""The frames of a recording by channel and identifier, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, concatenate
from imucald.runtime.timebase import TimeBase

MAX_SECONDS = 2400.0
"""Longest collected time [s]. The decisions of this package need fewer turns and stops than a
vehicle makes in 40 min."""
MAX_FRAMES = 6_000_000
"""Largest number of collected frames, for a fast bus. This number of frames needs about 150 MB."""


@dataclass(frozen=True, eq=False)
class Traffic:
    """All frames of one identifier on one channel. t: (N,) time since the start of the recording
    [s]."""

    channel: str
    can_id: int
    t: NDArray[np.float64]
    data: NDArray[np.uint8]
    length: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.t)


class GatheredFrames:
    """Collects frames and returns them by channel and identifier."""

    def __init__(self) -> None:
        self._timebase = TimeBase()
        self._parts: list[FrameColumns] = []
        self._frames = 0
        self.is_full = False
        """True if there were more frames than could be collected."""

    @classmethod
    def from_chunks(cls, chunks: Iterable[FrameColumns]) -> GatheredFrames:
        """Collect chunks up to the limits."""
        recording = cls()
        for chunk in chunks:
            recording.add_chunk(chunk)
            if recording.is_full:
                break
        return recording

    def add_chunk(self, frames: FrameColumns) -> None:
        """Add a chunk of frames of a log or a bus. The chunk must contain all frames, not only the
        wanted frames."""
        for segment in self._timebase.segments(frames.t):
            if self.is_full or not len(segment.t):
                return
            chunk = frames.take(slice(segment.start, segment.stop))
            inside = segment.t <= MAX_SECONDS
            self.is_full = not bool(inside.all()) or self._frames + len(chunk) > MAX_FRAMES
            timed = FrameColumns(
                segment.t, chunk.can_id, chunk.length, chunk.data, chunk.channel,
                chunk.channels, chunk.fd,
            ).take(inside)  # fmt: skip
            self._frames += len(timed)
            if len(timed):
                self._parts.append(timed)

    def between(self, first: float, last: float) -> GatheredFrames:
        """Return the frames of a part of the recording. first, last: times since the first frame
        [s]."""
        made = GatheredFrames()
        for part in self._parts:
            made.add_chunk(part.take((part.t >= first) & (part.t < last)))
        return made

    @property
    def frames(self) -> int:
        """Number of collected frames."""
        return self._frames

    @property
    def seconds(self) -> float:
        """Time from the first to the last collected frame [s]."""
        return float(self._parts[-1].t[-1]) if self._parts else 0.0

    def traffic(self) -> list[Traffic]:
        """Return the frames of every identifier of every channel, the smallest first."""
        if not self._parts:
            return []
        whole = concatenate(self._parts)
        key = whole.channel.astype(np.uint64) << np.uint64(32) | whole.can_id.astype(np.uint64)
        order = np.argsort(key, kind="stable")
        edges = np.flatnonzero(np.diff(key[order])) + 1
        found = []
        for rows in np.split(order, edges):
            name = whole.channels[int(whole.channel[rows[0]])]
            can_id = int(whole.can_id[rows[0]])
            found.append(Traffic(name, can_id, whole.t[rows], whole.data[rows], whole.length[rows]))
        return found
