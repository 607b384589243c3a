"""Replay: pass recorded logs through the engine as columns."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from msgspec import Struct

from imucald.can.columns import FrameColumns
from imucald.can.logs.log_reader import LogReader
from imucald.runtime.engine import Engine
from imucald.runtime.summary import RunCounts, summary

Sink = Callable[[FrameColumns], None]
"""Function that receives the output frames of the engine."""

SLICE_S = 0.05
"""Longest sleep of a replay with a stated speed [s]."""


class Replay(Struct):
    """One replay of logs through an engine.

    sink: receives the output frames. Without a sink, output frames are not encoded. speed: 1.0
    means real time; None means as fast as possible.
    """

    engine: Engine
    reader: LogReader
    sink: Sink | None = None
    speed: float | None = None

    _first: float | None = None
    _span: tuple[float, float] | None = None

    def run(self) -> dict[str, Any]:
        """Replay to the end; return the summary. Raises LogError."""
        for _ in self.chunks():
            pass
        return self.summary()

    def chunks(self) -> Iterator[None]:
        """Replay chunk by chunk. The iterator yields after each chunk of frames that the engine has
        processed."""
        began = 0.0
        for chunk in self.reader:
            if not len(chunk):
                continue
            if self._first is None:
                self._first = float(chunk.t[0])
                began = time.monotonic()
            earliest, latest = self._span or (math.inf, -math.inf)
            self._span = min(earliest, float(chunk.t.min())), max(latest, float(chunk.t.max()))
            if self.speed is None:
                self._feed(chunk)
            else:
                self._feed_paced(chunk, began - self._first / self.speed)
            yield

    @property
    def span(self) -> tuple[float, float] | None:
        """Earliest and latest time stamp of configured frames so far [s]; None without frames. The
        first stamp need not be the earliest: parts of a log may be in the wrong order, and clocks
        may be set back.
        """
        return self._span

    @property
    def lead(self) -> float:
        """Time from the beginning of the log to the first configured frame [s]."""
        start = self.reader.first_stamp
        return 0.0 if self._first is None or start is None else max(self._first - start, 0.0)

    def summary(self) -> dict[str, Any]:
        """Return the summary of the frames so far, with the keys in docs/json.md."""
        first, last = self._span or (0.0, 0.0)
        return summary(self.engine, self.counts(), last - first, self.lead)

    def _feed(self, chunk: FrameColumns) -> None:
        out = self.engine.columns(chunk, keep=self.sink is not None)
        if out is not None and self.sink is not None and len(out):
            self.sink(out)

    def _feed_paced(self, chunk: FrameColumns, origin: float) -> None:
        """Pass each frame to the engine when the monotonic time reaches origin + t / speed [s]."""
        due = origin + chunk.t / (self.speed or 1.0)
        start = 0
        while start < len(chunk):
            now = time.monotonic()
            stop = start + int(np.searchsorted(due[start:], now, side="right"))
            if stop > start:
                self._feed(chunk.take(slice(start, stop)))
                start = stop
            else:
                time.sleep(min(max(float(due[start]) - now, 0.0), SLICE_S))

    def counts(self) -> RunCounts:
        """Counts of frames so far. Bad lines of the log, and frames that the end-to-end protection
        refused, count as rejected.
        """
        rejected = Counter(self.engine.router.rejected)
        rejected.update(self.reader.rejected)
        return RunCounts(self.reader.frames_read, self.engine.router.used, rejected)
