"""Writes the tables of a drive, in whichever format the file's name asks for."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from imucald.api.columns import RAW, Columns
from imucald.api.files.csv_text import CsvTables
from imucald.api.files.mcap_log import McapTables
from imucald.api.files.mf4 import Mf4Tables
from imucald.api.files.parquet import ParquetTables
from imucald.api.files.table_file import Tables, TableWriter, about_tables
from imucald.api.interchange import library
from imucald.core.errors import ImucaldError

FORMATS: Mapping[str, type[TableWriter]] = {
    ".parquet": ParquetTables,
    ".csv": CsvTables,
    ".mf4": Mf4Tables,
    ".mcap": McapTables,
}
"""Writers by the ending of the file's name."""
_NUMBER = re.compile(r"\[errno (\d+)\]")
ALL_RAW = RAW.rstrip("/")
"""Stands for all tables of samples as they came."""


def format_of(path: Path) -> type[TableWriter]:
    """The writer for a file. Raises ImucaldError for an ending that is none of ours."""
    found = FORMATS.get(path.suffix.lower())
    if found is None:
        raise ImucaldError(f"{path}: the name must end in {', '.join(FORMATS)}")
    return found


def require_format(path: Path) -> None:
    """Raise ImucaldError, with the remedy, where a file of this name could not be written."""
    library(*format_of(path).needs)


def chosen(tables: Tables, quantities: Sequence[str] | str | None) -> Tables:
    """The tables that are asked for; None: all but the samples as they came."""
    if quantities is None:
        return {name: cs for name, cs in tables.items() if not name.startswith(RAW)}
    asked = [quantities] if isinstance(quantities, str) else list(quantities)
    for name in asked:
        if name not in tables and name != ALL_RAW:
            there = ", ".join((*tables, ALL_RAW))
            raise ImucaldError(f"there is no table {name!r}; there are: {there}")
    is_raw = ALL_RAW in asked
    return {
        name: cs
        for name, cs in tables.items()
        if name in asked or (is_raw and name.startswith(RAW))
    }


def write_parts(
    path: Path,
    tables: Tables,
    parts: Iterable[Mapping[str, Columns]],
    about_drive: Callable[[], Mapping[str, Any]],
) -> list[Path]:
    """Write parts of tables as they come; about_drive is asked at the end.

    Returns the files. Where anything fails nothing is left behind, and a file of that name stays
    as it was. Raises ImucaldError where the file cannot be written or a library is missing.
    """
    try:
        writer = format_of(path)(path, tables)
        try:
            for part in parts:
                writer.add({name: rows for name, rows in part.items() if name in tables})
            return writer.finish(about_tables(tables, about_drive()))
        except BaseException:
            writer.abandon()
            raise
    except OSError as error:
        number = _NUMBER.search(str(error))  # pyarrow puts it into a sentence of its own
        reason = os.strerror(int(number[1])) if number else error.strerror or str(error)
        raise ImucaldError(f"{path}: cannot be written: {reason}") from None
