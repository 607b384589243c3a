"""Parquet: a file for each table, zstd, units in the columns' names, the fields and the keys."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from imucald.api.columns import Columns
from imucald.api.files.table_file import Tables, given_up, named, names_beside, unfinished
from imucald.api.interchange import (
    FILE_KEY,
    PANDAS_KEY,
    arrow_schema,
    file_keys,
    from_arrow,
    library,
    to_arrow,
)
from imucald.core.errors import ImucaldError

ROW_GROUP = 100_000
"""Rows: what DuckDB and others advise."""


class ParquetTables:
    """Writes Parquet."""

    def __init__(self, path: Path, tables: Tables) -> None:
        self._tables = dict(tables)
        self._files = names_beside(path, tables)
        parquet = library("pyarrow.parquet", "arrow")
        self._writers: dict[str, Any] = {}
        try:
            for name, columns in tables.items():
                keys = file_keys(columns, {"table": name})
                # The result of the drive is known, and written, at the end.
                schema = arrow_schema(columns, None).with_metadata({PANDAS_KEY: keys[PANDAS_KEY]})
                place = str(unfinished(self._files[name]))
                self._writers[name] = parquet.ParquetWriter(place, schema, compression="zstd")
        except OSError:
            self.abandon()
            raise

    def add(self, name: str, rows: Columns) -> None:
        """Append rows, as row groups."""
        writer = self._writers[name]
        writer.write_table(to_arrow(rows).cast(writer.schema), row_group_size=ROW_GROUP)

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Write the keys and close."""
        files = {name: file.name for name, file in self._files.items()}
        for name, writer in self._writers.items():
            keys = file_keys(self._tables[name], {**about, "table": name, "files": files})
            writer.add_key_value_metadata({FILE_KEY: keys[FILE_KEY]})
            writer.close()
        return [named(file) for file in self._files.values()]

    def abandon(self) -> None:
        """Close and remove."""
        given_up(self._writers.values(), map(unfinished, self._files.values()))


def read_about(path: Path) -> dict[str, Any]:
    """What a file tells of itself. Raises ImucaldError for one that imucald did not write."""
    keys = library("pyarrow.parquet", "arrow").read_metadata(path).metadata or {}
    text = keys.get(FILE_KEY.encode())
    if text is None:
        raise ImucaldError(f"{path}: was not written by imucald")
    found: dict[str, Any] = json.loads(text)
    return found


def read_tables(folder: Path, about: Mapping[str, Any], tables: Tables) -> dict[str, Columns]:
    """The tables of all files that were written together."""
    parquet = library("pyarrow.parquet", "arrow")
    return {
        name: from_arrow(parquet.read_table(folder / about["files"][name]), columns)
        for name, columns in tables.items()
    }
