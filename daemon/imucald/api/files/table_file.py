"""Common parts of all file formats. Tables are written in pieces, and each file contains a
description of the tables."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol

from imucald import __version__
from imucald.api.columns import RAW, Columns, TableColumn
from imucald.core.errors import ImucaldError

VERSION = 1
"""Version of the description of the tables in a file. New keys may be added to it."""
UNFINISHED = ".unfinished"

Tables = Mapping[str, tuple[TableColumn, ...]]
"""The columns of each table, by the table's name."""


class TableWriter(Protocol):
    """Writes tables to one file, or to several in one folder."""

    needs: ClassVar[tuple[str, str]]
    """The required library: name of its module, and name of the extra that installs it."""

    def __init__(self, path: Path, tables: Tables) -> None: ...

    def add_tables(self, part: Mapping[str, Columns]) -> None:
        """Append the rows of one part of the drive to the tables."""
        ...

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Write the description of the tables, rename the files to their final names, and return
        their paths."""
        ...

    def abandon(self) -> None:
        """Close and remove the files that were written so far."""
        ...


def axes_of(table: str) -> str:
    """Return the axes of the vectors in a table."""
    return "sensor" if table.startswith(RAW) else "vehicle: x forward, y left, z up (ISO 8855)"


def about_tables(tables: Tables, drive: Mapping[str, Any]) -> dict[str, Any]:
    """Return the description of the tables that is stored in a file. drive: the data of the
    drive."""
    columns = {name: [[c.name, c.unit, c.kind] for c in cs] for name, cs in tables.items()}
    return {"version": VERSION, "imucald": __version__, "tables": columns, "drive": dict(drive)}


def tables_of(about: Mapping[str, Any]) -> dict[str, tuple[TableColumn, ...]]:
    """Return the tables that a file lists. Raises ImucaldError for a file of a later version."""
    if about["version"] != VERSION:
        raise ImucaldError(f"it was written by a later imucald ({about['imucald']})")
    return {name: tuple(TableColumn(*c) for c in cs) for name, cs in about["tables"].items()}


def unfinished(path: Path) -> Path:
    """Return the temporary name of a file while it is being written."""
    return path.with_name(f".{path.name}{UNFINISHED}")


def named(path: Path) -> Path:
    """Rename a complete file to its final name."""
    os.replace(unfinished(path), path)  # noqa: PTH105 - Path.replace takes the other order
    return path


def given_up(writers: Iterable[Any], files: Iterable[Path]) -> None:
    """Close the writers and remove unfinished files, even if closing fails."""
    for writer in writers:
        with contextlib.suppress(OSError):  # the remaining data do not fit on a full disk
            writer.close()
    for file in files:
        with contextlib.suppress(OSError):
            file.unlink()


def names_beside(path: Path, tables: Tables) -> dict[str, Path]:
    """Return the file of each table: `path` itself for a single table, else names such as
    drive.TABLE.parquet."""
    if len(tables) == 1:
        return dict.fromkeys(tables, path)
    found: dict[str, Path] = {}
    for name in tables:
        safe = word = re.sub(r"[^A-Za-z0-9_-]", "_", name)
        number = 2
        while (file := path.with_name(f"{path.stem}.{safe}{path.suffix}")) in found.values():
            safe, number = f"{word}-{number}", number + 1
        found[name] = file
    return found
