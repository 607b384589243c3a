"""Write the tables of a drive. The suffix of the file's name sets the format."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from imucald.api.columns import RAW, Columns
from imucald.api.files.arrow_files import CsvTables, ParquetTables
from imucald.api.files.mcap_log import McapTables
from imucald.api.files.mf4 import Mf4Tables
from imucald.api.files.table_file import Tables, TableWriter, about_tables
from imucald.api.interchange import library
from imucald.core.errors import ImucaldError

FORMATS: Mapping[str, type[TableWriter]] = {
    ".parquet": ParquetTables,
    ".csv": CsvTables,
    ".mf4": Mf4Tables,
    ".mcap": McapTables,
}
"""Writers by the suffix of the file's name."""
_NUMBER = re.compile(r"\[errno (\d+)\]")
ALL_RAW = RAW.rstrip("/")
"""The name that selects all tables of raw samples."""


def format_of(path: Path) -> type[TableWriter]:
    """Return the writer for a file. Raises ImucaldError for an unknown suffix."""
    found = FORMATS.get(path.suffix.lower())
    if found is None:
        raise ImucaldError(f"{path}: the name must end in {', '.join(FORMATS)}")
    return found


def require_format(path: Path) -> None:
    """Raise ImucaldError with a remedy if a file of this name cannot be written."""
    library(*format_of(path).needs)


def chosen(tables: Tables, quantities: Sequence[str] | str | None) -> Tables:
    """Return the selected tables. None selects all tables except the tables of raw samples."""
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
    """Write parts of tables one after the other, and call about_drive at the end.

    Returns the files. If an error occurs, no partial file is left, and an existing file of the
    same name is not changed. Raises ImucaldError if the file cannot be written or a library is
    missing.
    """
    try:
        writer = format_of(path)(path, tables)
        try:
            for part in parts:
                writer.add_tables({name: rows for name, rows in part.items() if name in tables})
            return writer.finish(about_tables(tables, about_drive()))
        except BaseException:
            writer.abandon()
            raise
    except OSError as error:
        number = _NUMBER.search(str(error))  # pyarrow puts the number into its message
        reason = os.strerror(int(number[1])) if number else error.strerror or str(error)
        raise ImucaldError(f"{path}: cannot be written: {reason}") from None
