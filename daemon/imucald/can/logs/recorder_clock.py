"""Correct the time stamps of a file with a model of the recorder's clock.

A recorder reads a clock at the end of each frame. The stamps of neighbouring frames are therefore
near each other. Four faults can be detected from the frames:

- A single stamp is damaged, for example by a wrong bit on the disk: it is far from the stamps of
  both neighbours, which are near each other. The frame is rejected.
- The clock restarts (its higher digits are not printed): the same step back occurs repeatedly.
- The clock is coarse, or frames are delivered in bursts: frames of one cyclic sender are closer
  together than a bus allows. They were sent after the previous burst, so they are spread evenly
  over the time since then, in their order.
- The clock is not in seconds: there are more frames than any bus can carry in the time.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, FrameColumns, concatenate
from imucald.can.logs.log_format import DAMAGED_STEP, ReadStatistics
from imucald.can.logs.text_blocks import OpenLog
from imucald.core.arrays import median
from imucald.core.errors import LogError

Log = Path | str | OpenLog
Times = NDArray[np.float64]

BIT_S: Final = 1e-6
"""Shortest bit of classic CAN and of the header of a CAN FD frame [s]."""
HEAD_BITS, FD_HEAD_BITS, FD_TAIL_BITS, LONG_ID_BITS = 47, 30, 28, 20
"""Bits of a frame without its data: with the gap after it, without stuff bits (ISO 11898-1)."""
LEAST_GAP: Final = 0.9
"""Smallest time between the ends of two frames, as a share of the second frame's time on the bus.
The share would be 1 if the stamps had no limited resolution."""
SAME_ID_SHARE: Final = 0.25
"""Time stamps are coarse if more than this share of the frames has another frame of the same id in
its run. A run is a sequence of frames that follow each other faster than a bus allows."""

MIN_LOOPS: Final = 5
"""If the same step back occurs at least this number of times, the clock restarts."""
LOOP_TOLERANCE: Final = 0.1
"""Largest relative difference between the steps back of a clock that restarts. The gaps between
frames cause the difference."""
ROOM_PART: Final = 100
"""The gap at a restart of the clock is assumed to be at most as long as the longest of every 100
gaps between frames."""
DELTA_SHARE: Final = 0.2
"""If at least this share of steps goes back, the stamps are time differences. For differences,
half of the steps go back."""
MIN_FRAMES: Final = 64
"""Smallest number of frames for finding the resolution."""
MAX_STEP: Final = 1.5
"""A longer gap between bursts (in usual steps) counts as a hole in the recording. The frames after
a hole are spread over one usual step."""


def by_the_clock(
    log: Log, chunks: Iterator[FrameColumns], statistics: ReadStatistics
) -> Iterator[FrameColumns]:
    """Yield a file's frames with the times at which they were sent, as far as known.

    The corrections are reported in a note of the statistics. Frames with a damaged stamp are
    rejected. Raises LogError if no bus can transmit so many frames in the time of the stamps.
    """
    bus, loop, bursts = _BusTime(log), None, None
    for chunk in _without_damaged_stamps(log, chunks, statistics):
        if loop is None:
            loop = _Loop(_loop_length(chunk.t))
            if loop.length:
                statistics.note(
                    f"{log}: its time stamps start from zero again every {loop.length:g} s; "
                    "this was corrected. Better record with: candump -l can0"
                )
        frames = chunk.at(loop.times(chunk.t)) if loop.length else chunk
        bus.add_frames(frames)
        if bursts is None:
            bursts = _Bursts(_burst_step(frames))
            if bursts.step:
                statistics.note(
                    f"{log}: its time stamps come in steps of {bursts.step:.3g} s: frames "
                    "with the same stamp were spread evenly, which is right to some "
                    "milliseconds. Better record with: candump -l can0"
                )
        if not bursts.step or len(frames := bursts.add_frames(frames)):
            yield frames
    if bursts is not None and bursts.step and len(rest := bursts.rest()):
        yield rest


def _without_damaged_stamps(
    log: Log, chunks: Iterator[FrameColumns], statistics: ReadStatistics
) -> Iterator[FrameColumns]:
    """Yield the frames, in chunks that are not empty, without single frames whose stamp is more
    than `DAMAGED_STEP` from those of both neighbours, which are nearer to each other than that.

    Several such frames in a row are not rejected, because it is not known which stamps are right.
    """
    before, is_alone_before = math.nan, False
    undecided: list[FrameColumns] = []  # the next frame decides about these
    for chunk in itertools.chain((one for one in chunks if len(one)), [None]):
        if chunk is None and not undecided:
            return
        frames = concatenate(undecided if chunk is None else [*undecided, chunk])
        t = np.append(before, frames.t)
        is_far = np.abs(np.diff(t)) > DAMAGED_STEP
        is_alone = np.zeros(len(frames) + 1, dtype=bool)
        is_alone[0] = is_alone_before
        is_alone[1:-1] = is_far[:-1] & is_far[1:] & (np.abs(t[2:] - t[:-2]) <= DAMAGED_STEP)
        run = is_far[-2:]
        left = 0 if chunk is None else len(run) if run.all() else int(run[-1])
        decided = len(frames) - left
        is_wrong = is_alone[1:] & ~is_alone[:-1] & ~np.append(is_alone[2:], False)
        is_wrong = is_wrong[:decided]
        for k in np.flatnonzero(is_wrong).tolist():
            statistics.reject(
                "bad_timestamp",
                f"{log}: the time stamp {t[k + 1]:.6f} is {t[k + 1] - t[k]:+.1f} s from those of "
                "the frames before and after it",
            )
        statistics.frames_read -= int(np.count_nonzero(is_wrong))  # they were counted as read
        undecided = [frames.take(slice(decided, len(frames)))] if left else []
        before, is_alone_before = float(t[decided]), bool(is_alone[decided])
        if is_far.any():
            frames = frames.take(slice(0, decided)).take(~is_wrong)
        if len(frames):
            yield frames


def _steps_back(t: Times) -> Times:
    steps = np.diff(t)
    return -steps[steps < 0.0]


def _loop_length(t: Times) -> float:
    """Return the period after which the first stamps of a file restart [s]; 0 if they do not."""
    back = _steps_back(t)
    if len(back) < MIN_LOOPS:
        return 0.0
    length = float(t.max() - t.min())
    back = back[back > 0.5 * length]
    if len(back) < MIN_LOOPS or back.min() < (1.0 - LOOP_TOLERANCE) * length:
        return 0.0
    steps = np.diff(t)
    if steps.max() > 0.5 * length:
        return 0.0  # stamps jump back and forth: they are damaged
    gaps = steps[steps >= 0.0]
    room = float(np.partition(gaps, -len(gaps) // ROOM_PART)[-len(gaps) // ROOM_PART])
    # The clock's period is a round number: the first one that fits with the gap at the end.
    for digits in range(1, 6):
        unit = 10.0 ** (math.floor(math.log10(length)) + 1 - digits)
        round_one = math.ceil(length / unit) * unit
        if round_one - length <= room:
            return float(f"{round_one:.{digits}g}")
    return length + median(gaps)


class _Loop:
    """Makes continuous times from a clock that restarts. length: its period [s], 0 if none."""

    def __init__(self, length: float) -> None:
        self.length = length
        self._last: float | None = None
        self._turns = 0

    def times(self, t: Times) -> Times:
        """Return the continuous times [s] of the next frames, (N,)."""
        before = t[0] if self._last is None else self._last
        steps = np.diff(t, prepend=before)
        # A frame out of order at the restart belongs to the previous period.
        half = 0.5 * self.length
        over = (steps < -half).astype(np.int64) - (steps > half).astype(np.int64)
        turns = self._turns + np.cumsum(over)
        self._last, self._turns = float(t[-1]), int(turns[-1])
        return t + self.length * turns


class _BusTime:
    """Compares the shortest bus time of a file's frames with the time of its stamps."""

    def __init__(self, log: Log) -> None:
        self._log = log
        self._begin()

    def _begin(self) -> None:
        self._seconds: Times = np.zeros(0)
        self._frames = self._back = 0
        self._first, self._end, self._last = math.inf, -math.inf, math.nan

    def add_frames(self, frames: FrameColumns) -> None:
        """Add the next frames. Raises LogError if there are too many for their stamps."""
        t = frames.t
        if t[0] < self._last - DAMAGED_STEP or _steps_back(t).max(initial=0.0) > DAMAGED_STEP:
            self._begin()  # the clock was set back, or another recording follows
            return
        self._last, self._frames = float(t[-1]), self._frames + len(frames)
        self._first = min(self._first, float(t.min()))
        self._end = max(self._end, float(t.max()))
        known = len(self._seconds)  # a channel of earlier frames may be silent now
        on_bus: Times = np.bincount(frames.channel, _bus_seconds(frames), known).astype(np.float64)
        on_bus[:known] += self._seconds
        self._seconds = on_bus
        self._back += int(np.count_nonzero(_steps_back(t)))
        needed, passed = float(on_bus.max()), self._end - self._first
        if needed > passed and self._back > DELTA_SHARE * self._frames > DELTA_SHARE * MIN_FRAMES:
            raise LogError(
                f"{self._log}: its time stamps seem to count from the line before: "
                f"{self._frames} frames lie within {passed:.3g} s, and {self._back} stamps go "
                "back; record with: candump -l can0"
            )
        # a recorder may deliver so much bus traffic late, with a single time stamp
        if needed > passed + 2.0:
            raise LogError(
                f"{self._log}: {self._frames} frames lie within {passed:.3g} s by their time "
                f"stamps; a bus of 1 Mbit/s needs at least {needed:.1f} s for them: the "
                "stamps have another unit, or count from the frame before. Export them in "
                "seconds from the start, or record with: candump -l can0"
            )


def _bus_seconds(frames: FrameColumns) -> Times:
    """Return the shortest time of each frame on a bus [s], (N,)."""
    bits = frames.length * 8.0
    seconds = (bits + HEAD_BITS) * BIT_S
    if frames.fd is not None:
        fast = (bits + FD_TAIL_BITS) * (BIT_S / 8) + FD_HEAD_BITS * BIT_S
        seconds = np.where(frames.fd, fast, seconds)
    long_id = frames.can_id >= CAN_EFF_FLAG
    return seconds + long_id * (LONG_ID_BITS * BIT_S)


def _runs(frames: FrameColumns) -> NDArray[np.intp]:
    """Return the first frame of each run of frames closer together than a bus allows."""
    gap, least = np.diff(frames.t), LEAST_GAP * _bus_seconds(frames)[1:]
    return np.flatnonzero(np.r_[True, ~((gap >= 0.0) & (gap < least))])


def _burst_step(frames: FrameColumns) -> float:
    """Return the usual time between bursts [s]; 0 if each frame has its own stamp.

    In bursts, many frames are in one run with another frame of the same id. No sender and no bus is
    that fast. Copies made by a gateway or logger are not counted.
    """
    frames = frames.take(~_is_copy(frames))
    count = len(frames)
    if count < MIN_FRAMES:
        return 0.0
    runs = _runs(frames)
    if len(runs) > count // 2 or len(runs) < 2:
        return 0.0
    run = np.zeros(count, np.uint64)
    run[runs[1:]] = 1
    run = np.cumsum(run, dtype=np.uint64)
    key = (run << np.uint64(40)) + (frames.channel.astype(np.uint64) << np.uint64(32))
    _, times = np.unique(key + frames.can_id, return_counts=True)
    if int(times[times > 1].sum()) <= SAME_ID_SHARE * count:
        return 0.0
    steps = np.diff(frames.t[runs])
    if np.count_nonzero(steps <= 0.0) > LOOP_TOLERANCE * len(steps):
        return 0.0  # no clock
    step = median(steps)
    # After spreading, the distance of frames must be possible on a bus.
    fits = step * len(runs) > np.bincount(frames.channel, _bus_seconds(frames)).max()
    return step if fits else 0.0


def _is_copy(frames: FrameColumns) -> NDArray[np.bool_]:
    """Return which frames (N,) copy the previous frame. In a run of equal frames, every second
    frame counts as a copy."""
    same = np.zeros(len(frames), dtype=bool)
    same[1:] = (np.diff(frames.t) == 0.0) & (frames.data[1:] == frames.data[:-1]).all(axis=1)
    for column in (frames.can_id, frames.length, frames.channel):
        same[1:] &= column[1:] == column[:-1]
    place = np.arange(len(frames))
    since = place - np.maximum.accumulate(np.where(same, 0, place))
    copies: NDArray[np.bool_] = same & (since % 2 == 1)
    return copies


class _Bursts:
    """Spreads the frames of a burst over the time since the previous burst. step: period [s]."""

    def __init__(self, step: float) -> None:
        self.step = max(step, 0.0)
        self._before: float | None = None
        self._open: FrameColumns | None = None

    def add_frames(self, frames: FrameColumns) -> FrameColumns:
        """Add frames. Return the frames of completed bursts, with their times."""
        if self._open is not None:
            frames = concatenate([self._open, frames])
        last = int(_runs(frames)[-1])
        self._open = frames.take(slice(last, len(frames)))
        return self._spread(frames.take(slice(0, last)))

    def rest(self) -> FrameColumns:
        """Return the frames of the last burst, with their times."""
        assert self._open is not None
        return self._spread(self._open)

    def _spread(self, frames: FrameColumns) -> FrameColumns:
        if not len(frames):
            return frames
        runs = _runs(frames)
        count = np.diff(np.r_[runs, len(frames)])
        t = frames.t[runs]
        since = np.diff(t, prepend=t[0] - self.step if self._before is None else self._before)
        self._before = float(t[-1])
        since[~((since >= 0.0) & (since <= MAX_STEP * self.step))] = self.step
        run = np.repeat(np.arange(len(count)), count)
        left = np.cumsum(count)[run] - 1 - np.arange(len(frames))
        # Times are one step late: this is the true time for a clock that is read too coarsely,
        # and no time is before the first stamp.
        return frames.at(t[run] + self.step - since[run] * left / count[run])
