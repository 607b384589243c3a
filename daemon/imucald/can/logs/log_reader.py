"""Recorded logs, one after another, as columns of frames.

Candump text (``.log`` or any other name, plain or gzip, "-" for standard input) is read by
columns; ``.asc .blf .trc .csv .mf4 .db`` through python-can. Several files are read in the order
given and as one recording: where a later file begins at an earlier time, so do its frames, and
whoever makes stream time of it meets a discontinuity.
"""

from __future__ import annotations

import importlib
import os
import pkgutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Final

from imucald.can import logs
from imucald.can.columns import CAN_EFF_FLAG, Channels, FrameColumns, IdMatch
from imucald.can.id_filter import IdFilters
from imucald.can.logs.candump_writer import CandumpWriter
from imucald.can.logs.log_format import LogFormat, ReadStatistics
from imucald.can.logs.text_blocks import STDIN, OpenLog

__all__ = ["CAN_EFF_FLAG", "CandumpWriter", "FrameColumns", "IdMatch", "LogReader"]


def find_formats() -> tuple[type[LogFormat], ...]:
    """Every format that can be read: FORMAT of each module of this folder named `..._logs`."""
    names = (module.name for module in pkgutil.iter_modules(logs.__path__))
    return tuple(
        importlib.import_module(f"{logs.__name__}.{name}").FORMAT
        for name in sorted(names)
        if name.endswith("_logs")
    )


FORMATS: Final = find_formats()

CANDUMP_ENDING: Final = ".log"
"""A file whose ending no format names is read as candump text."""

Progress = Callable[[int, int | None], None]
"""Called with bytes read and bytes in all (None where standard input is among the files)."""


class LogReader:
    """Iterate over the wanted data frames of recorded logs, in recorded order.

    Bad lines are counted in `rejected` by reason and skipped; `problems` has the first of them as
    "file:line: reason". With strict the first one raises LogError, as does always a file that
    cannot be opened or is no log at all. Each iteration reads, and counts, from the start.
    """

    def __init__(
        self,
        paths: Sequence[Path | str | OpenLog],
        keep: Sequence[IdMatch] | None = None,
        strict: bool = False,
        progress: Progress | None = None,
    ) -> None:
        """keep: which frames are wanted; None for all."""
        self._paths = list(paths)
        self._keep = keep
        self._progress = progress
        self._statistics = ReadStatistics(strict)
        self._bytes_before = 0
        self._bytes_total: int | None = None

    @property
    def frames_read(self) -> int:
        """Return the number of all valid frames so far, wanted or not."""
        return self._statistics.frames_read

    @property
    def first_stamp(self) -> float | None:
        """Return the time stamp of the first valid frame so far [s], wanted or not."""
        return self._statistics.first_stamp

    @property
    def ignored(self) -> dict[str, int]:
        """Return how many of them are remote_frame, error_frame, xl_frame: never passed on."""
        return dict(self._statistics.ignored)

    @property
    def rejected(self) -> dict[str, int]:
        """Return the number of rejections by reason."""
        return dict(self._statistics.rejected)

    @property
    def problems(self) -> list[str]:
        """Return the first rejections as texts, "file:line: reason: line"."""
        return list(self._statistics.problems)

    def __iter__(self) -> Iterator[FrameColumns]:
        """Yield chunks of bounded size, none of them empty. Raises LogError."""
        self._statistics = ReadStatistics(self._statistics.strict)
        self._bytes_before = 0
        self._bytes_total = _total_bytes(self._paths)
        shared = IdFilters(self._keep), Channels(), self._statistics
        readers = [kind(*shared) for kind in FORMATS]
        candump = next(r for r in readers if CANDUMP_ENDING in r.endings)
        for path in self._paths:
            ending = _ending(path)
            reader = next((r for r in readers if ending in r.endings), candump)
            yield from reader.read(path, self._report)
            self._bytes_before += _file_bytes(path)
            self._report(0)

    def _report(self, bytes_of_file: int) -> None:
        if self._progress is not None:
            self._progress(self._bytes_before + bytes_of_file, self._bytes_total)


def _ending(path: Path | str | OpenLog) -> str:
    """The ending of a file's name, before ``.gz``, in small letters."""
    name = Path(str(path))
    return Path(name.stem if name.suffix.lower() == ".gz" else name.name).suffix.lower()


def _file_bytes(path: Path | str | OpenLog) -> int:
    if isinstance(path, OpenLog) or str(path) == STDIN:
        return 0
    try:
        return os.stat(path).st_size  # noqa: PTH116
    except OSError:
        return 0


def _total_bytes(paths: Sequence[Path | str | OpenLog]) -> int | None:
    if any(isinstance(path, OpenLog) or str(path) == STDIN for path in paths):
        return None
    return sum(_file_bytes(path) for path in paths)
