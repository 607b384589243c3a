"""Detect errors of the files of one recording: the same file twice, time stamps that are not in
seconds, files that overlap in time or are in the wrong order."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import numpy as np

from imucald.can.columns import FrameColumns
from imucald.can.logs.log_format import Cycles
from imucald.can.logs.text_blocks import OpenLog, is_read_once
from imucald.core.arrays import median
from imucald.core.errors import LogError

MIN_FRAMES: Final = 64
"""Smallest number of frames for a comparison. This number of frames with the same times and
payloads (including sensor noise) never occurs in two recordings."""

UNITS: Final = {
    1e3: "milliseconds",
    1e6: "microseconds",
    1e9: "nanoseconds",
    1e-3: "milliseconds where the format has microseconds",
    1e-6: "seconds where the format has microseconds",
}
"""The unit of time stamps, by the factor by which they are too large."""
TOLERANCE: Final = 1.5
"""Accepted factor between a message's cycle and the stated cycle, as in `check`."""
IS_THE_SAME: Final = "is the same recording as"

Log = Path | str | OpenLog


def refuse_same_files(paths: Iterable[Log]) -> None:
    """Raise LogError if a file is named twice, because its evidence would count twice."""
    seen: dict[tuple[int, int], Log] = {}
    for path in paths:
        if isinstance(path, OpenLog) or is_read_once(path):
            continue
        try:
            found = os.stat(path)  # noqa: PTH116 - a str or a Path
        except OSError:
            continue  # opening it reports the reason
        key = found.st_dev, found.st_ino
        if key in seen:
            raise same_recording(path, seen[key])
        seen[key] = path


class FirstFrames:
    """Checks the first chunk of each file of a recording."""

    def __init__(self, cycles: Cycles) -> None:
        """Prepare the checks. cycles: messages with their stated cycle time [s]."""
        self._cycles = cycles
        self._seen: dict[bytes, Log] = {}

    def checked_chunks(self, path: Log, chunks: Iterable[FrameColumns]) -> Iterator[FrameColumns]:
        """Yield the chunks of a file that are not empty. Raises LogError if an earlier file began
        with the same frames at the same times, or if the time stamps are not in seconds."""
        begins = True
        for frames in chunks:
            if len(frames):
                if begins:
                    self._take(path, frames)
                begins = False
                yield frames

    def _take(self, path: Log, frames: FrameColumns) -> None:
        if len(frames) < MIN_FRAMES:
            return
        factor = _by_date(median(frames.t)) or self._by_cycles(frames)
        if factor is not None and factor < 1.0:
            raise LogError(
                f"{path}: its time stamps are {1.0 / factor:.0f} times too small for the "
                f"stated cycles (they seem to be {UNITS[factor]}): multiply them by "
                f"{1.0 / factor:.0f}"
            )
        if factor is not None:
            raise LogError(
                f"{path}: its time stamps seem to be {UNITS[factor]}, for example "
                f"{frames.t[0]:.15g}; they must be seconds: divide them by {factor:.0f}"
            )
        first = frames.take(slice(0, MIN_FRAMES))
        key = b"".join(column.tobytes() for column in (first.t, first.can_id, first.data))
        if key in self._seen:
            raise same_recording(path, self._seen[key])
        self._seen[key] = path

    def _by_cycles(self, frames: FrameColumns) -> float | None:
        """Return the factor by which all intervals between frames of a message are too large."""
        found: list[float] = []
        for match, cycle in self._cycles:
            ours = np.flatnonzero(((frames.can_id ^ match.can_id) & match.full_mask) == 0)
            t, channel = frames.t[ours], frames.channel[ours]
            for index in sorted(set(channel.tolist())):
                if match.channel in (None, frames.channels[index]):
                    between = np.diff(t[channel == index])
                    found += [median(between) / cycle] if len(between) else []
        # the stated cycle of one may be wrong
        if len(found) < 2:
            return None
        least, most = min(found), max(found)
        return next((f for f in UNITS if f / TOLERANCE < least <= most < f * TOLERANCE), None)


def _by_date(t: float) -> float | None:
    """Return the divisor that converts a stamp to seconds of this century; None if the stamp is not
    too large."""
    # the year 10000: more than any stamp in seconds, less than one of this century in ms
    if t < 253_402_300_800.0:
        return None
    # the year 2100
    return next((f for f in UNITS if f > 1.0 and t / f < 4_102_444_800.0), None)


def same_recording(log: Log, other: Log) -> LogError:
    """Return the error for a recording that is given with two names."""
    text = f"{log}: {IS_THE_SAME} {other}: it would count twice; leave one of them out"
    return LogError(text)


CLOCK_SET_S: Final = 946_684_800.0
"""The year 2000 [s]. A log that begins earlier has no time of day; it counts from its start."""


def overlap_words(later: object, earlier: object, seconds: float, shorter_s: float) -> str:
    """Return the text for two logs that overlap; shorter_s: length of the shorter one."""
    # two logs of equal length seldom begin with the same frame
    if seconds >= 0.99 * shorter_s:
        return f"{later} and {earlier} overlap completely in time; are their clocks right?"
    return f"{later} begins {seconds:.1f} s before {earlier} ends"


class Overlaps:
    """The first and last time stamp of the wanted frames of each file."""

    def __init__(self) -> None:
        self._spans: dict[str, tuple[float, float]] = {}

    def register_frames(self, log: Log, frames: FrameColumns) -> None:
        """Register frames of a file (at least one)."""
        first, last = float(frames.t.min()), float(frames.t.max())
        before = self._spans.get(str(log), (first, last))
        self._spans[str(log)] = min(before[0], first), max(before[1], last)

    def texts(self) -> Iterator[str]:
        """Yield a text for each problem. Files without a time of day are ignored."""
        latest: tuple[str, float, float] | None = None
        for log, (first, last) in self._spans.items():
            if first < CLOCK_SET_S:
                continue
            if latest is not None:
                name, begin, end = latest
                shared = min(end, last) - max(begin, first)
                if shared > 0.0:
                    later, earlier = (log, name) if first >= begin else (name, log)
                    words = overlap_words(later, earlier, shared, min(last - first, end - begin))
                    mark = "" if words.endswith("?") else ":"
                    yield (
                        f"{words}{mark} the frames in both logs count twice; "
                        "cut them out of one of the logs"
                    )
                elif last < begin:
                    yield (
                        f"{log} is earlier than {name}, which is read before it: name the pieces "
                        "in the order of their times"
                    )
            if latest is None or last > latest[2]:
                latest = log, first, last
