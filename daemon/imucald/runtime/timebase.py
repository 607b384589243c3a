"""Convert recorded or received time stamps to stream time: seconds from the first configured frame,
never decreasing.

Time stamps are wall-clock times. Time stamps may be slightly out of order, stand still, or jump
when a person sets the clock. In a slightly disordered log, stream time stands still until the
stamps increase again. A jump or a long hole begins a new segment at the next tick, and all parts
that compare values over time are informed. A hole lasts at most `FORWARD_STEP` of stream time. The
stamps of a live bus are in order, so a small step back is detected too, and stream time continues.
A jump forward to stamps that were already reached is not a hole: in a shuffled log, such a jump
takes one tick, while a hole takes a hundred ticks. All holes together last at most `HOLE_SHARE`
times as long as the time between the holes. A log whose stamps jump forward at every frame
therefore does not need hours of computing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.motion.ticks import TICK_RATE

BACKWARD_STEP = 1.0
"""A stamp is a clock step, not disorder, if it is older than the newest stamp by more than this
[s]."""
FORWARD_STEP = 10.0
"""A stamp is a clock step or a hole if it is newer than the newest stamp by more than this [s].
Values before and after it are not combined. For a stamp that is not later than all earlier
segments, the limit is `BACKWARD_STEP`.
"""

SET_BACK = 0.05
"""Largest disorder on a live bus [s].

If all stamps during this time are further behind stream time, the clock was set back. A step of
more than `BACKWARD_STEP` is detected at the first stamp.
"""

FIRST_LOOK = 256
"""Number of stamps in the first search for a step. The number is small, so that the computing time
for a log with a step in each row is proportional to its length."""

HOLE_SHARE = 10.0
"""Longest duration of all holes together after the first hole, divided by the time with frames. One
second of frames therefore allows one hole of `FORWARD_STEP`. More holes do not occur in a drive."""


class TimeSegment(Struct, frozen=True):
    """Rows [start, stop) of a chunk. t: stream times of the rows [s]. gap: True if a new segment
    begins at `start`.
    """

    start: int
    stop: int
    t: NDArray[np.float64]
    gap: bool


class TimeBase:
    """Converts stamps to stream time, one by one or in columns. Both kinds of calls may be
    mixed."""

    def __init__(self) -> None:
        self.steps = 0
        """Number of discontinuities."""
        self.started = False
        self.is_live = False
        """True if the single stamps are from a live bus: from one clock, in the order of
        reception."""
        self._offset = 0.0
        self._newest = -math.inf  # stamp
        self._highest = -math.inf  # stamp, of all segments
        self._now = 0.0  # stream time
        self._frame = 0.0  # stream time of the newest stamp
        self._behind: float | None = None  # the first of stamps that are behind, live
        self._holes = 0.0  # stream time of all jumps, holes among them

    @property
    def now(self) -> float:
        """Present stream time [s]."""
        return self._now

    def stream_time(self, stamp: float) -> tuple[float, bool]:
        """Convert one stamp. Return the stream time [s], and whether a new segment begins."""
        if not self.started:
            self.started = True
            self._offset, self._newest = stamp, stamp
            return 0.0, False
        gap = self._is_step(stamp)
        if gap:
            self._begin_segment(stamp)
        elif self.is_live and self._now - (stamp - self._offset) > SET_BACK:
            self._take_behind(stamp)
        elif stamp > self._newest:
            self._newest = stamp
            self._behind = None
        self._now = self._frame = max(self._now, stamp - self._offset)
        return self._now, gap

    def _is_step(self, stamp: float) -> bool:
        """Return whether a new segment begins with this stamp."""
        limit = FORWARD_STEP if stamp > self._highest else BACKWARD_STEP
        return not -BACKWARD_STEP <= stamp - self._newest <= limit or self._is_overtaken(stamp)

    def _is_overtaken(self, stamp: float) -> bool:
        """Return whether a stamp is behind the stream time that `idle` has reached, because the
        clock was set back during a silence.

        A comparison with the newest stamp alone may not show the step back. Stream time would then
        stand still until the stamps have reached it.
        """
        return self._now > self._frame and stamp - self._offset < self._now - BACKWARD_STEP

    def _take_behind(self, stamp: float) -> None:
        """Process a stamp of a live bus that is behind stream time by less than a step.

        If several successive stamps are behind, the clock was set back. Stream time then continues
        from the value at which it stood still.
        """
        first = self._behind
        if first is None or stamp < first:
            self._behind = stamp
        elif stamp - first > SET_BACK:
            self.steps += 1
            self._highest = max(self._highest, self._newest)
            self._newest, self._offset, self._behind = stamp, first - self._now, None

    def idle(self, elapsed: float) -> float:
        """Advance stream time without a stamp. Return stream time [s].

        elapsed: time since the newest stamp [s], by a clock that does not step.
        """
        self._now = max(self._now, self._frame + min(elapsed, FORWARD_STEP))
        return self._now

    def segments(self, stamps: NDArray[np.float64]) -> Iterator[TimeSegment]:
        """Split a column of stamps (N,) into segments without a step or hole. Yield each segment
        with its stream times."""
        start, n = 0, len(stamps)
        while start < n:
            _, gap = self.stream_time(float(stamps[start]))
            t = self._times(stamps[start:])
            yield TimeSegment(start, start + len(t), t, gap)
            start += len(t)

    def _times(self, stamps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the stream times of the stamps before the next step. The first stamp was already
        processed by `stream_time`."""
        size, is_step = FIRST_LOOK, np.zeros(0, bool)
        while not is_step.any() and len(is_step) + 1 < len(stamps):
            newest = np.maximum.accumulate(np.append(self._newest, stamps[1:size]))
            later, ahead = stamps[1:size], stamps[1:size] - newest[:-1]
            limit = np.where(later > self._highest, FORWARD_STEP, BACKWARD_STEP)
            is_step = ~((ahead >= -BACKWARD_STEP) & (ahead <= limit))
            size *= 16
        n = 1 + (int(is_step.argmax()) if is_step.any() else len(is_step))
        t = np.maximum.accumulate(np.append(self._now, stamps[1:n] - self._offset))
        self._now = self._frame = float(t[-1])
        self._newest = max(self._newest, float(stamps[1:n].max(initial=-math.inf)))
        return t

    def _begin_segment(self, stamp: float) -> None:
        self.steps += 1
        self._behind = None
        self._highest = max(self._highest, self._newest)
        hole = 0.0
        if stamp > self._highest + FORWARD_STEP:
            left = FORWARD_STEP + HOLE_SHARE * (self._frame - self._holes) - self._holes
            hole = max(min(FORWARD_STEP, left), 0.0)
        resume = max(self._now, self._frame + hole)
        self._newest = stamp
        self._now = (math.floor(resume * TICK_RATE) + 1) / TICK_RATE
        self._holes += self._now - self._frame
        self._offset = stamp - self._now
