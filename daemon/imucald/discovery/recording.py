"""The frames of a recording by channel and identifier, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, concatenate
from imucald.runtime.timebase import TimeBase

MAX_SECONDS = 2400.0
"""What is gathered: 40 min hold more turns and stops than any decision here needs."""
MAX_FRAMES = 6_000_000
"""The same for a fast bus; about 150 MB."""


@dataclass(frozen=True, eq=False)
class Traffic:
    """All frames of one identifier on one channel; t (N,) [s] from the recording's start."""

    channel: str
    can_id: int
    t: NDArray[np.float64]
    data: NDArray[np.uint8]
    length: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.t)


class GatheredFrames:
    """Gathers frames, then gives them by channel and identifier."""

    def __init__(self) -> None:
        self._timebase = TimeBase()
        self._parts: list[FrameColumns] = []
        self._frames = 0
        self.is_full = False
        """Whether frames came that were not looked at."""

    @classmethod
    def of(cls, chunks: Iterable[FrameColumns]) -> GatheredFrames:
        """Gather as many chunks as there is room for."""
        recording = cls()
        for chunk in chunks:
            recording.add(chunk)
            if recording.is_full:
                break
        return recording

    def add(self, frames: FrameColumns) -> None:
        """Take a chunk of all the frames of a log or a bus."""
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

    @property
    def frames(self) -> int:
        """Frames gathered."""
        return self._frames

    @property
    def seconds(self) -> float:
        """From the first frame to the last that was gathered."""
        return float(self._parts[-1].t[-1]) if self._parts else 0.0

    def traffic(self) -> list[Traffic]:
        """Every identifier of every channel, the smallest first."""
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
