"""Find files of one recording that overlap in time or are in the wrong order."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from imucald.can.columns import FrameColumns
from imucald.can.logs.text_blocks import OpenLog

CLOCK_SET_S: Final = 946_684_800.0
"""The year 2000 [s]. A log that begins earlier has no time of day; it counts from its start."""

COMPLETE: Final = 0.99
"""An overlap is called complete if it covers at least this share of the shorter log. The limit is
below 1, because two logs of equal length seldom begin with the same frame."""

Log = Path | str | OpenLog


def overlap_words(later: object, earlier: object, seconds: float, shorter_s: float) -> str:
    """Return the text for two logs that overlap; shorter_s: length of the shorter one."""
    if seconds >= COMPLETE * shorter_s:
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
