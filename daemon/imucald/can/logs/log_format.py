"""What every log format is: a reader of files that begin in a certain way, and what it counts.

A new format is a new file of this folder whose name ends with `_logs` and which has a `LogFormat`
under the name FORMAT: `log_reader` finds it. One that python-can reads needs only its ending in
`python_can_logs`.
"""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import ClassVar, Final, Protocol, runtime_checkable

from imucald.can.columns import Channels, FrameColumns, IdMatch
from imucald.can.id_filter import IdFilters
from imucald.can.logs.text_blocks import OpenLog
from imucald.can.logs.unpacking import damage_within
from imucald.core.errors import LogError

MAX_PROBLEMS: Final = 20
"""Texts kept: enough to see what is wrong, and bounded whatever the file holds."""

FOREIGN_LINE: Final = "not_candump"
"""The reason of lines that have nothing in common with a frame's."""

DAMAGED_STEP: Final = 10.0
"""Where bytes are known to be damaged, stamps further apart are a sign of it [s]; as much as stream
time bridges."""


class DamageError(Exception):
    """The first sign of damage in a file that is known to be damaged; with its place."""


class _ForeignLines:
    """A run of lines that are not of a file's format; problem: its place among the problems."""

    def __init__(self, name: str, line: int, text: str, problem: int | None) -> None:
        self.name, self.text, self.problem = name, text, problem
        self.last, self.count = line, 1


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
        self.damage = ""
        """Why the file that is being read cannot be trusted, where that is known."""
        self._last_stamp: float | None = None
        self._foreign: _ForeignLines | None = None

    @contextlib.contextmanager
    def until_damage(self, path: Path | str | OpenLog) -> Iterator[None]:
        """Where a compressed file is damaged, its first bad line or step of time ends the body."""
        self.damage = "" if isinstance(path, OpenLog) else damage_within(Path(path))
        self._last_stamp = None
        try:
            yield
        except DamageError as sign:
            text, self.damage = f"{sign}; reading ends here: {self.damage}", ""
            self.reject("damaged_file", text)
        finally:
            self.damage = ""

    def follows(self, t: float, place: str) -> None:
        """Take a stamp [s] of a damaged file; raises DamageError where it does not follow."""
        if self._last_stamp is not None and not abs(t - self._last_stamp) <= DAMAGED_STEP:
            raise DamageError(f"{place}: the time stamps step from {self._last_stamp} to {t}")
        self._last_stamp = t

    def reject(self, reason: str, text: str) -> None:
        """Count one rejection; `text` begins with its place. Raises LogError where strict.

        DamageError where the file is known to be damaged before.
        """
        if self.strict:
            raise LogError(text)
        if self.damage and reason != "damaged_file":
            raise DamageError(text)
        self.rejected[reason] += 1
        if len(self.problems) < MAX_PROBLEMS:
            self.problems.append(text)

    def reject_line(self, reason: str, name: str, number: int, words: str) -> None:
        """As `reject`, of a text's line. Lines in a row that are not of the format at all, such as
        a header or comments, blank ones among them, are one problem with their count."""
        text = f"{name}:{number}: {words}"
        run = self._foreign
        if reason != FOREIGN_LINE or self.strict or self.damage:
            self.reject(reason, text)
        elif run is not None and run.name == name and run.last < number <= run.last + 2:
            self.rejected[reason] += 1
            run.last, run.count = number, run.count + 1
            if run.problem is not None:
                more = f"and {run.count - 1} more such lines up to line {number}"
                self.problems[run.problem] = f"{run.text} ({more})"
        else:
            self.reject(reason, text)
            kept = self.problems[-1] is text
            problem = len(self.problems) - 1 if kept else None
            self._foreign = _ForeignLines(name, number, text, problem)

    def note(self, text: str) -> None:
        """Report something that limits what a log is worth. Raises LogError where strict, which
        says that this, and no bad line, is the reason."""
        if self.strict:
            raise LogError(f"{text} (with --strict, such a log is refused)")
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
