"""Files of one recording that hold the same seconds, or come in the wrong order."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from imucald.can.columns import FrameColumns
from imucald.can.logs.text_blocks import OpenLog

CLOCK_SET_S: Final = 946_684_800.0
"""Year 2000: a log that begins earlier has no time of day, it counts from its own start."""

Log = Path | str | OpenLog


def overlap_words(later: object, earlier: object, seconds: float, shorter_s: float) -> str:
    """Two logs that share some time; shorter_s: length of the shorter one."""
    if seconds >= shorter_s:
        return f"{later} and {earlier} overlap completely in time; are their clocks right?"
    return f"{later} begins {seconds:.1f} s before {earlier} ends"


class Overlaps:
    """First and last time stamp of each file, of the frames that are wanted."""

    def __init__(self) -> None:
        self._spans: dict[str, tuple[float, float]] = {}

    def take(self, log: Log, frames: FrameColumns) -> None:
        """Take frames of a file, at least one."""
        first, last = float(frames.t.min()), float(frames.t.max())
        before = self._spans.get(str(log), (first, last))
        self._spans[str(log)] = min(before[0], first), max(before[1], last)

    def texts(self) -> Iterator[str]:
        """What is odd, in words; nothing of files without a time of day."""
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
                    yield f"{words}{mark} the frames in both logs count twice; cut them out of one"
                elif last < begin:
                    yield (
                        f"{log} is earlier than {name}, which is read before it: name the pieces "
                        "in the order of their times"
                    )
            if latest is None or last > latest[2]:
                latest = log, first, last
