"""Read recorded logs, one after another, as columns of frames.

A file's first bytes identify its format and its compression (gzip, xz, bzip2, Zstandard). If they
do not, its name is used. "-" is standard input. Several files are read in the given order as one
recording. The times of frames are not changed: if a later file begins at an earlier time, there is
a discontinuity.
"""

from __future__ import annotations

import importlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final

from imucald.can import logs
from imucald.can.columns import CAN_EFF_FLAG, Channels, FrameColumns, IdMatch
from imucald.can.id_filter import IdFilters
from imucald.can.logs.candump_line import shown
from imucald.can.logs.candump_writer import CandumpWriter
from imucald.can.logs.log_format import CountsTime, Cycles, LogFormat, ReadStatistics
from imucald.can.logs.recorder_clock import by_the_clock
from imucald.can.logs.recording_files import FirstFrames, Overlaps, refuse_same_files
from imucald.can.logs.text_blocks import OpenLog, is_read_once, looked_at
from imucald.can.logs.unpacking import first_bytes, plain_ending
from imucald.core.errors import LogError

__all__ = ["CAN_EFF_FLAG", "CandumpWriter", "FrameColumns", "IdMatch", "LogReader"]


FIRST_FORMAT: Final = "candump_logs"
"""The most frequent format. The other formats are loaded (5 ms) only if a log does not have it."""


def find_formats() -> Iterator[type[LogFormat]]:
    """Find all formats: FORMAT in each module of this folder with a name `..._logs`."""
    yield _format(FIRST_FORMAT)
    import pkgutil  # noqa: PLC0415 - see FIRST_FORMAT

    names = {module.name for module in pkgutil.iter_modules(logs.__path__)} - {FIRST_FORMAT}
    yield from (_format(name) for name in sorted(names) if name.endswith("_logs"))


def _format(name: str) -> type[LogFormat]:
    found: type[LogFormat] = importlib.import_module(f"{logs.__name__}.{name}").FORMAT
    return found


_MAY_BE_CANDUMP: Final = re.compile(rb"^\(\d", re.MULTILINE)
"""Beginning of a line in a damaged candump log that has no complete line in its first bytes."""

OTHER_PROGRAMS: Final = {
    "Microchip's CAN BUS Analyzer": re.compile(rb"(?://-+\s+)?Microchip Technology"),
    "CarBusAnalyzer": re.compile(rb"@ TEXT @"),
    "BUSMASTER": re.compile(rb"\*+ ?BUSMASTER"),
    "OVMS (CRTD)": re.compile(rb"\d+\.\d+ +\d?C[A-Z]{2} "),
}
"""Programs whose logs cannot be read, with the beginning of such logs. Errors name the program."""

HEAD_BYTES: Final = 4096
"""Number of first uncompressed bytes that identify a format."""

Progress = Callable[[int, int | None], None]
"""Callback for progress. Arguments: bytes read, and total bytes (None with standard input)."""


class LogReader:
    """Iterate over the wanted data frames of recorded logs, in recorded order.

    Bad lines are skipped and counted by reason in `rejected`. `problems` contains the first
    rejections as "file:line: reason". With strict, the first bad line raises LogError. A file
    always raises LogError if it cannot be opened, is not a log, has time stamps that are not in
    seconds, or is the same recording as an earlier file. Each iteration reads and counts from the
    start.
    """

    def __init__(
        self,
        paths: Sequence[Path | str | OpenLog],
        keep: Sequence[IdMatch] | None = None,
        strict: bool = False,
        progress: Progress | None = None,
        cycles: Cycles = (),
    ) -> None:
        """Prepare reading. keep: filters of the wanted frames; None for all. cycles: stated cycles,
        for logs without time stamps and to detect stamps that are not in seconds."""
        self._paths = list(paths)
        self._keep = keep
        self._progress = progress
        self._cycles = cycles
        self._statistics = ReadStatistics(strict)
        self._overlaps = Overlaps()
        self._bytes_before = self._bytes_read = 0
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
        """Return the numbers of remote_frame, error_frame, xl_frame, which are never passed on."""
        return dict(self._statistics.ignored)

    @property
    def rejected(self) -> dict[str, int]:
        """Return the number of rejections by reason."""
        return dict(self._statistics.rejected)

    @property
    def problems(self) -> list[str]:
        """Return the first rejections as texts, "file:line: reason: line"."""
        return list(self._statistics.problems)

    @property
    def overlaps(self) -> list[str]:
        """Return texts about files so far that overlap in time or are in the wrong order."""
        return list(self._overlaps.texts())

    def __iter__(self) -> Iterator[FrameColumns]:
        """Yield chunks of bounded size that are not empty. Raises LogError, see the class."""
        self._statistics = ReadStatistics(self._statistics.strict)
        self._overlaps = Overlaps()
        self._bytes_before = self._bytes_read = 0
        self._bytes_total = _total_bytes(self._paths)
        refuse_same_files(self._paths)
        first_frames = FirstFrames(self._cycles)
        readers = _Readers(IdFilters(self._keep), Channels(), self._statistics, self._cycles)
        for path in self._paths:
            with looked_at(path) as (head, handed):
                chosen = _reader_for(readers, first_bytes(head, HEAD_BYTES), path)
                read = first_frames.checked_chunks(path, chosen.read(handed, self._report))
                for columns in by_the_clock(path, read, self._statistics):
                    self._overlaps.register_frames(path, columns)
                    yield columns
            self._bytes_before += _file_bytes(path)
            self._report(0)

    def _report(self, bytes_of_file: int) -> None:
        self._bytes_read = self._bytes_before + bytes_of_file
        if self._progress is not None:
            self._progress(self._bytes_read, self._bytes_total)


class _Readers:
    """A reader for each format. Each reader is made at its first use."""

    def __init__(
        self, filters: IdFilters, channels: Channels, statistics: ReadStatistics, cycles: Cycles
    ) -> None:
        self._made: list[LogFormat] = []
        self._others = (kind(filters, channels, statistics) for kind in find_formats())
        self._cycles = cycles

    def __iter__(self) -> Iterator[LogFormat]:
        yield from self._made
        for reader in self._others:
            if isinstance(reader, CountsTime):
                reader.cycles = self._cycles
            self._made.append(reader)
            yield reader


def _reader_for(readers: Iterable[LogFormat], head: bytes, path: Path | str | OpenLog) -> LogFormat:
    """Return the reader for a file with these first bytes. Raises LogError if it is not a log."""
    found = next((r for r in readers if r.begins(head)), None)
    if found is not None:
        return found
    ending = plain_ending(Path(str(path)))
    if ending == ".csv" and head:
        first = shown(head.split(b"\n")[0].strip())
        raise LogError(
            f"{path}: its first line is '{first}'; imucald knows the CSV of SavvyCAN "
            "(Time Stamp,ID,"
            "Extended,Dir,Bus,LEN,D1,...,D8) and of python-can (timestamp,arbitration_id,extended,"
            "remote,error,dlc,data), with these headings and with commas between the columns; "
            "columns of signals are not read: encode them with your database (cantools) and save "
            "them as a CAN log"
        )
    for program, begins in OTHER_PROGRAMS.items():
        if begins.match(head):
            raise LogError(
                f"{path}: this is a log of {program}, which imucald cannot read; export it as "
                "ASC or BLF, or record with: candump -l can0"
            )
    by_name = next((r for r in readers if ending in r.endings), None)
    # an empty file, too, is read as candump text
    candump = next(r for r in readers if ".log" in r.endings)
    if by_name in (None, candump) and head.strip() and not _MAY_BE_CANDUMP.search(head):
        raise LogError(
            f"{path}: the format of this log is not known; it begins with "
            f"'{shown(head.lstrip())}'; record with: candump -l can0"
        )
    return by_name or candump


def _file_bytes(path: Path | str | OpenLog) -> int:
    if isinstance(path, OpenLog) or is_read_once(path):
        return 0
    try:
        return os.stat(path).st_size  # noqa: PTH116
    except OSError:
        return 0


def _total_bytes(paths: Sequence[Path | str | OpenLog]) -> int | None:
    if any(isinstance(path, OpenLog) or is_read_once(path) for path in paths):
        return None
    return sum(_file_bytes(path) for path in paths)
