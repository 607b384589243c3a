"""The interface of all log formats, and the statistics of a reader.

To add a format, add a file to this folder whose name ends with `_logs`. The module must define a
`LogFormat` with the name FORMAT; `log_reader` finds it, asks its `begins` and knows its `endings`.
For a format that python-can reads, add its suffix and its `_BEGINNINGS` in `python_can_logs`.
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

DAMAGED_STEP: Final = 10.0
"""In a damaged file, a larger step of time stamps is a sign of damage [s]. The value is equal to
the longest gap that does not start a new segment (`runtime.timebase`)."""


class DamageError(Exception):
    """The first sign of damage in a damaged file, with its place."""


class _ForeignLines:
    """A run of lines that do not have the file's format. problem: index of the run's text in the
    problems."""

    def __init__(self, name: str, line: int, text: str, problem: int | None) -> None:
        self.name, self.text, self.problem = name, text, problem
        self.last, self.count = line, 1


class ReadStatistics:
    """Counts over all files of one reader."""

    def __init__(self, strict: bool) -> None:
        """Start counting. strict: the first rejection raises LogError instead of being counted."""
        self.strict = strict
        self.frames_read = 0
        self.first_stamp: float | None = None
        """Time stamp of the first valid frame [s]."""
        self.ignored: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.problems: list[str] = []
        self.damage = ""
        """Why the current file cannot be trusted; empty if no damage is known."""
        self._last_stamp: float | None = None
        self._foreign: _ForeignLines | None = None

    @contextlib.contextmanager
    def until_damage(self, path: Path | str | OpenLog) -> Iterator[None]:
        """Context for reading one file. In a damaged compressed file, the first bad line or time
        step ends the body."""
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
        """Check a time stamp [s] of a damaged file. Raises DamageError if its step is too large."""
        if self._last_stamp is not None and not abs(t - self._last_stamp) <= DAMAGED_STEP:
            raise DamageError(f"{place}: the time stamps step from {self._last_stamp} to {t}")
        self._last_stamp = t

    def reject(self, reason: str, text: str) -> None:
        """Count one rejection; `text` begins with its place. In strict mode, it raises LogError.

        Raises DamageError if the file is already known to be damaged.
        """
        if self.strict:
            raise LogError(text)
        if self.damage and reason != "damaged_file":
            raise DamageError(text)
        self.rejected[reason] += 1
        # bounds the memory for any file
        if len(self.problems) < 20:
            self.problems.append(text)

    def reject_line(self, reason: str, name: str, number: int, words: str) -> None:
        """Reject a line of a text, see `reject`. Consecutive lines without the file's format (such
        as a header or comments, including blank lines) are one problem with a count."""
        text = f"{name}:{number}: {words}"
        run = self._foreign
        if reason != "not_candump" or self.strict or self.damage:
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
        """Store a text about something that reduces the value of a log. In strict mode, LogError is
        raised; its text states that this is not a bad line."""
        if self.strict:
            raise LogError(f"{text} (with --strict, such a log is refused)")
        self.problems.append(text)

    def stamp(self, t: float) -> None:
        """Register the time stamp [s] of a valid frame. The first one is stored."""
        if self.first_stamp is None:
            self.first_stamp = t

    def ignore(self, kind: str) -> None:
        """Count one valid frame without data (remote, error) or of an unused kind (XL)."""
        self.frames_read += 1
        self.ignored[kind] += 1


Cycles = Sequence[tuple[IdMatch, float]]
"""Messages with their stated cycle time [s]."""


@runtime_checkable
class CountsTime(Protocol):
    """A format that may lack time stamps. The reader then counts cycles of a known message."""

    cycles: Cycles


class LogFormat(Protocol):
    """A reader of one recording's files, which share filters, channels and statistics."""

    endings: ClassVar[tuple[str, ...]]
    """Suffixes of file names in lower case, without suffixes of compression such as ``.gz``.
    Endings are used if the first bytes do not identify the format."""

    @staticmethod
    def begins(head: bytes) -> bool:
        """True if a file with these first uncompressed bytes (up to 4 KiB) has this format."""
        ...

    def __init__(
        self, filters: IdFilters, channels: Channels, statistics: ReadStatistics
    ) -> None: ...

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield a file's wanted frames. Chunks may be empty. `report` is called with bytes read.

        Raises LogError for a file that is not a log. Bad parts of a log are counted in the
        statistics.
        """
