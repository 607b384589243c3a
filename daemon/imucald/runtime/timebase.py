"""Convert recorded or received time stamps to stream time: seconds from the first configured frame,
never backwards.

Stamps are wall-clock times. The stamps may be slightly out of order, stand still, or step when a
person sets the clock. Small disorder is flattened. A step (or a long hole) begins a new segment at
the next tick, and all parts that difference over time are informed. A hole lasts at most
`FORWARD_STEP` of stream time. A live bus has no disorder, so a small step back is seen as well, and
stream time continues. A jump forward to stamps that were reached before is not a hole: a shuffled
log takes one tick for each of its jumps, not the hundred of a hole. All holes together last at most
`HOLE_SHARE` times as long as the time between them. Stamps that jump ahead at every frame therefore
do not take hours.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.motion.ticks import TICK_RATE

BACKWARD_STEP = 1.0
"""A stamp that is older than the newest by more than this is a clock step, not disorder [s]."""
FORWARD_STEP = 10.0
"""A stamp that is newer by more than this is a clock step or a hole: nothing is carried across it
[s]. Among stamps that were reached before, one that is newer by more than `BACKWARD_STEP` is a
step.
"""

SET_BACK = 0.05
"""Largest disorder on a live bus [s].

If all stamps for this long are further behind, the clock was set back. A step of more than
`BACKWARD_STEP` is seen at the first stamp.
"""

FIRST_LOOK = 256
"""Stamps that are searched for a step at first, so that a log with a step in each row takes no more
than its length."""

HOLE_SHARE = 10.0
"""After the first hole, each whole hole needs a second of frames: more holes are no drive."""


class TimeSegment(Struct, frozen=True):
    """Rows [start, stop) of a chunk with their stream times; `gap`: whether a new segment begins
    here.
    """

    start: int
    stop: int
    t: NDArray[np.float64]
    gap: bool


class TimeBase:
    """Keeps the offset between stamps and stream time. Scalar and column calls may be mixed."""

    def __init__(self) -> None:
        self.steps = 0
        """Number of discontinuities."""
        self.started = False
        self.is_live = False
        """True if single stamps come from a live bus: from one clock, in the order received."""
        self._offset = 0.0
        self._newest = -math.inf  # stamp
        self._highest = -math.inf  # stamp, of all segments
        self._now = 0.0  # stream time
        self._frame = 0.0  # stream time of the newest stamp
        self._behind: float | None = None  # the first of stamps that are behind, live
        self._holes = 0.0  # stream time of all jumps, holes among them

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
        """Return whether `idle` has passed this stamp: the clock was set back during a silence.

        Compared with the newest stamp alone, it may look like a clock that went on, or like
        disorder. Stream time would then stand still until the stamps have caught up.
        """
        return self._now > self._frame and stamp - self._offset < self._now - BACKWARD_STEP

    def _take_behind(self, stamp: float) -> None:
        """Take a stamp of a live bus that is behind stream time by less than a step.

        If it is not the only one, the clock was set back and the samples continue. Stream time then
        also continues, from where it stood still.
        """
        first = self._behind
        if first is None or stamp < first:
            self._behind = stamp
        elif stamp - first > SET_BACK:
            self.steps += 1
            self._highest = max(self._highest, self._newest)
            self._newest, self._offset, self._behind = stamp, first - self._now, None

    def idle(self, elapsed: float) -> float:
        """Let time pass without a stamp; return stream time [s].

        elapsed: time since the newest stamp [s], by a clock that does not step.
        """
        self._now = max(self._now, self._frame + min(elapsed, FORWARD_STEP))
        return self._now

    def segments(self, stamps: NDArray[np.float64]) -> Iterator[TimeSegment]:
        """Split a column of stamps (N,) into segments without discontinuity, with stream times."""
        start, n = 0, len(stamps)
        while start < n:
            _, gap = self.stream_time(float(stamps[start]))
            t = self._times(stamps[start:])
            yield TimeSegment(start, start + len(t), t, gap)
            start += len(t)

    def _times(self, stamps: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the stream times of stamps up to the next step; the first was just taken."""
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
