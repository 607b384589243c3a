"""Recorded logs through the engine, by columns."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucald.can.columns import FrameColumns
from imucald.can.logs.log_reader import LogReader
from imucald.runtime.engine import Engine
from imucald.runtime.summary import RunCounts, summary

Sink = Callable[[FrameColumns], None]
"""Takes the frames that the engine gives out."""

SLICE_S = 0.05
"""Longest sleep of a paced replay [s]."""


@dataclass
class Replay:
    """One replay of logs through an engine.

    sink: takes the output frames; without one they are not even encoded. speed: None is as fast as
    it goes, 1.0 is real time.
    """

    engine: Engine
    reader: LogReader
    sink: Sink | None = None
    speed: float | None = None

    def run(self) -> dict[str, Any]:
        """Replay to the end; return the summary. Raises LogError."""
        first = last = None
        for chunk in self.reader:
            if not len(chunk):
                continue
            if first is None:
                first = float(chunk.t[0])
                began = time.monotonic()
            last = float(chunk.t[-1])
            if self.speed is None:
                self._feed(chunk)
            else:
                self._feed_paced(chunk, began - first / self.speed)
        duration = last - first if first is not None and last is not None else 0.0
        start = self.reader.first_stamp
        lead = first - start if first is not None and start is not None else 0.0
        return summary(self.engine, self.counts(), max(duration, 0.0), max(lead, 0.0))

    def _feed(self, chunk: FrameColumns) -> None:
        out = self.engine.columns(chunk, keep=self.sink is not None)
        if out is not None and self.sink is not None and len(out):
            self.sink(out)

    def _feed_paced(self, chunk: FrameColumns, origin: float) -> None:
        """Hand out frames when monotonic time reaches origin + t / speed."""
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
        """Frames so far; rejected are both bad lines and frames that protection refused."""
        rejected = Counter(self.engine.router.rejected)
        rejected.update(self.reader.rejected)
        return RunCounts(self.reader.frames_read, self.engine.router.used, rejected)
