"""What all file formats share: tables are written in pieces, and the file describes them."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, ClassVar, Protocol

from imucald import __version__
from imucald.api.columns import RAW, Columns, TableColumn
from imucald.core.errors import ImucaldError

VERSION = 1
"""Of what a file states about its tables; keys are only added."""
UNFINISHED = ".unfinished"
VEHICLE_AXES = "vehicle: x forward, y left, z up (ISO 8855)"
SENSOR_AXES = "sensor"

Tables = Mapping[str, tuple[TableColumn, ...]]
"""Columns of each table, by its name."""


class TableWriter(Protocol):
    """Writes tables to one file, or to several in one folder."""

    needs: ClassVar[tuple[str, str]]
    """The library that it writes with: module, and the extra that brings it."""

    def __init__(self, path: Path, tables: Tables) -> None: ...

    def add(self, part: Mapping[str, Columns]) -> None:
        """Append the rows of a part of the drive to their tables."""
        ...

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Write what the file states about its tables; name the files, and return them."""
        ...

    def abandon(self) -> None:
        """Close and remove what was written so far."""
        ...


def axes_of(table: str) -> str:
    """Which axes a table's vectors are in."""
    return SENSOR_AXES if table.startswith(RAW) else VEHICLE_AXES


def about_tables(tables: Tables, drive: Mapping[str, Any]) -> dict[str, Any]:
    """What a file states about its tables; drive: of the drive that they are of."""
    columns = {name: [[c.name, c.unit, c.kind] for c in cs] for name, cs in tables.items()}
    return {"version": VERSION, "imucald": __version__, "tables": columns, "drive": dict(drive)}


def tables_of(about: Mapping[str, Any]) -> dict[str, tuple[TableColumn, ...]]:
    """The tables that a file states. Raises ImucaldError for a file of a later version."""
    if about["version"] != VERSION:
        raise ImucaldError(f"it was written by a later imucald ({about['imucald']})")
    return {name: tuple(TableColumn(*c) for c in cs) for name, cs in about["tables"].items()}


def unfinished(path: Path) -> Path:
    """The name of a file while it is being written."""
    return path.with_name(f".{path.name}{UNFINISHED}")


def named(path: Path) -> Path:
    """Give a file its name, now that it is whole."""
    os.replace(unfinished(path), path)  # noqa: PTH105 - Path.replace takes the other order
    return path


def given_up(writers: Iterable[Any], files: Iterable[Path]) -> None:
    """Close what writes, and remove unfinished files: one that cannot be closed well, too."""
    for writer in writers:
        with contextlib.suppress(OSError):  # what is left to write does not fit on a full disk
            writer.close()
    for file in files:
        with contextlib.suppress(OSError):
            file.unlink()


def opened(files: Mapping[str, Path], open_one: Callable[[str, str], Any]) -> dict[str, Any]:
    """A writer for each table's unfinished file; where one cannot be opened none is left behind.

    files: of each table, as it is named in the end. open_one: takes a table's name and a path.
    """
    writers: dict[str, Any] = {}
    try:
        for name, file in files.items():
            writers[name] = open_one(name, str(unfinished(file)))
    except OSError:
        given_up(writers.values(), map(unfinished, files.values()))
        raise
    return writers


def names_beside(path: Path, tables: Tables) -> dict[str, Path]:
    """The file of each table: `path` itself for one, drive.TABLE.parquet and so on for several."""
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
