"""Find logs: by names, open files, folders and patterns."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from imucald.can.logs.log_reader import find_formats
from imucald.can.logs.text_blocks import STDIN, OpenLog, folder_error
from imucald.can.logs.unpacking import plain_ending
from imucald.core.errors import LogError

LogSource = str | os.PathLike[str] | Any
"""A log's name, or a file that is open for reading bytes (candump text, plain or gzip)."""

AMBIGUOUS = frozenset({".csv", ".db"})
"""Suffixes of logs that other files have too. A log with such a suffix must be given by its
name."""


@cache
def log_endings() -> frozenset[str]:
    """Return the suffixes of log files in a folder, without suffixes of compression."""
    return frozenset(end for kind in find_formats() for end in kind.endings) - AMBIGUOUS


def opened(source: LogSource) -> Path | str | OpenLog:
    """Return a source for the log reader. Raises LogError if the argument cannot be a log."""
    if isinstance(source, str | os.PathLike):
        if str(source) != STDIN and Path(source).is_dir():
            raise folder_error(source)
        return source if isinstance(source, str) else Path(source)
    if not hasattr(source, "readinto") or hasattr(source, "encoding"):
        kind = type(source).__name__
        raise LogError(f"a {kind} is not a log: give a name, or a file opened for reading bytes")
    name = getattr(source, "name", None)
    return OpenLog(source, name if isinstance(name, str) else "<open file>")


def pieces(log: LogSource | Sequence[LogSource]) -> Sequence[LogSource]:
    """Return the pieces of a recording. A recording may be a single piece."""
    return log if isinstance(log, list | tuple) else [log]


def find_logs(*where: str | os.PathLike[str]) -> list[Path]:
    """List logs: each source is a file's name, a folder, or a shell pattern.

    From a folder, files with the suffix of a log are taken (except .csv and .db, which other files
    have too), compressed or not, sorted by name. Raises LogError if no log is found.
    """
    return [Path(name) for name in found_names([os.fspath(one) for one in where])]


def found_names(where: Sequence[str]) -> list[str]:
    """Find logs for the command line. '-' (standard input) is accepted, and names of files are not
    changed."""
    found: list[str] = []
    for name in where:
        if name != STDIN and Path(name).is_dir():
            inside = (p for p in sorted(Path(name).rglob("*")) if p.is_file())
            found += _some(name, (str(p) for p in inside if plain_ending(p) in log_endings()))
        elif name == STDIN or Path(name).exists():
            found.append(name)
        else:
            import glob  # noqa: PLC0415 - patterns are rare

            is_pattern = glob.has_magic(name)
            matching = sorted(glob.glob(name, recursive=True)) if is_pattern else [name]  # noqa: PTH207 - names as given
            found += _some(name, matching)
    return found


def _some(where: str, names: Iterable[str]) -> list[str]:
    found = list(names)
    if not found:
        raise LogError(f"there is no log at {where}")
    return found
