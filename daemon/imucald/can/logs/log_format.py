"""What every log format is: a reader of files that begin in a certain way, and what it counts.

A new format is a new file of this folder whose name ends with `_logs` and which has a `LogFormat`
under the name FORMAT: `log_reader` finds it. One that python-can reads needs only its ending in
`python_can_logs`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import ClassVar, Final, Protocol, runtime_checkable

from imucald.can.columns import Channels, FrameColumns, IdMatch
from imucald.can.id_filter import IdFilters
from imucald.can.logs.text_blocks import OpenLog
from imucald.core.errors import LogError

MAX_PROBLEMS: Final = 20
"""Texts kept: enough to see what is wrong, and bounded whatever the file holds."""


class ReadStatistics:
    """Counts over all files of one reader."""

    def __init__(self, strict: bool) -> None:
        """strict: raise LogError at the first rejection instead of counting it."""
        self.strict = strict
        self.frames_read = 0
        self.first_stamp: float | None = None
        """Time stamp of the first valid frame [s]."""
        self.ignored: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.problems: list[str] = []

    def reject(self, reason: str, text: str) -> None:
        """Count one rejection; `text` begins with its place. Raises LogError where strict."""
        if self.strict:
            raise LogError(text)
        self.rejected[reason] += 1
        if len(self.problems) < MAX_PROBLEMS:
            self.problems.append(text)

    def note(self, text: str) -> None:
        """Tell of something that limits what a log is worth. Raises LogError where strict."""
        if self.strict:
            raise LogError(text)
        self.problems.append(text)

    def stamp(self, t: float) -> None:
        """Take note of a valid frame's time stamp [s]: the first one is kept."""
        if self.first_stamp is None:
            self.first_stamp = t

    def ignore(self, kind: str) -> None:
        """Count one valid frame that carries no data (remote, error) or is not for us (XL)."""
        self.frames_read += 1
        self.ignored[kind] += 1


Cycles = Sequence[tuple[IdMatch, float]]
"""Messages with their stated cycle time [s]."""


@runtime_checkable
class CountsTime(Protocol):
    """A format that may lack time stamps, and counts cycles of a known message instead."""

    cycles: Cycles


class LogFormat(Protocol):
    """A reader of one recording's files, which share filters, channels and statistics."""

    endings: ClassVar[tuple[str, ...]]
    """Of file names, in small letters; ``.gz`` and the like behind them do not count. They decide
    where the first bytes do not."""

    @staticmethod
    def begins(head: bytes) -> bool:
        """Whether a file with these first plain bytes (4 KiB, less where it is shorter) is one."""
        ...

    def __init__(
        self, filters: IdFilters, channels: Channels, statistics: ReadStatistics
    ) -> None: ...

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield a file's wanted frames, empty chunks among them; `report` gets the bytes read.

        Raises LogError for a file that is no log at all; what is bad in one goes to statistics.
        """
