"""Recorded or received time stamps -> stream time: seconds from our first frame, never backwards.

Stamps are wall clock. They come a little out of order, stand still, and step when somebody sets the
clock. Small disorder is flattened; a step (or a long hole) begins a new segment at the next tick,
and whoever differences over time is informed. A hole lasts `FORWARD_STEP` of stream time at most.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.motion.ticks import TICK_RATE

BACKWARD_STEP = 1.0
"""A stamp older than this against the newest is a clock step, not disorder [s]."""
FORWARD_STEP = 10.0
"""A stamp newer than this is a clock step or a hole: nothing is carried across it [s]."""


@dataclass(frozen=True)
class TimeSegment:
    """Rows [start, stop) of a chunk with their stream times; `gap`: a new segment begins here."""

    start: int
    stop: int
    t: NDArray[np.float64]
    gap: bool


class TimeBase:
    """Keeps the offset between stamps and stream time. Scalar and column use may be mixed."""

    def __init__(self) -> None:
        self.steps = 0
        """Discontinuities seen."""
        self.started = False
        self._offset = 0.0
        self._newest = -math.inf  # stamp
        self._now = 0.0  # stream time
        self._frame = 0.0  # stream time of the newest stamp

    @property
    def now(self) -> float:
        """Stream time of the newest stamp [s]."""
        return self._now

    def stream_time(self, stamp: float) -> tuple[float, bool]:
        """Return (stream time [s], whether a new segment begins)."""
        if not self.started:
            self.started = True
            self._offset, self._newest = stamp, stamp
            return 0.0, False
        gap = not -BACKWARD_STEP <= stamp - self._newest <= FORWARD_STEP
        if gap:
            self._begin_segment(stamp)
        elif stamp > self._newest:
            self._newest = stamp
        self._now = self._frame = max(self._now, stamp - self._offset)
        return self._now, gap

    def idle(self, elapsed: float) -> float:
        """Let time pass without a stamp; return stream time [s].

        elapsed: seconds since the newest stamp, by a clock that does not step.
        """
        self._now = max(self._now, self._frame + min(elapsed, FORWARD_STEP))
        return self._now

    def segments(self, stamps: NDArray[np.float64]) -> Iterator[TimeSegment]:
        """Split a column of stamps (N,) into segments without discontinuity, with stream times."""
        start, n = 0, len(stamps)
        while start < n:
            gap = False
            if not self.started:
                self.started = True
                self._offset = self._newest = float(stamps[0])
            elif not -BACKWARD_STEP <= float(stamps[start]) - self._newest <= FORWARD_STEP:
                gap = True
                self._begin_segment(float(stamps[start]))
            newest = np.maximum.accumulate(np.maximum(stamps[start:], self._newest))
            change = stamps[start + 1 :] - newest[:-1]
            bad = np.flatnonzero((change < -BACKWARD_STEP) | (change > FORWARD_STEP))
            stop = start + 1 + int(bad[0]) if len(bad) else n
            t = np.maximum.accumulate(np.maximum(stamps[start:stop] - self._offset, self._now))
            self._newest = float(newest[stop - start - 1])
            self._now = self._frame = float(t[-1])
            yield TimeSegment(start, stop, t, gap)
            start = stop

    def _begin_segment(self, stamp: float) -> None:
        self.steps += 1
        resume = self._now if stamp < self._newest else self._frame + FORWARD_STEP
        self._newest = stamp
        self._now = (math.floor(max(resume, self._now) * TICK_RATE) + 1) / TICK_RATE
        self._offset = stamp - self._now
