"""Parquet: one file per table, compressed with zstd. The units are in the column names, in the
metadata of the fields and in the metadata of the file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from imucald.api.columns import Columns
from imucald.api.files.table_file import (
    Tables,
    given_up,
    named,
    names_beside,
    opened,
    unfinished,
)
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
"""Number of rows per row group, as recommended by DuckDB and others."""


class ParquetTables:
    """Writes Parquet."""

    needs: ClassVar = ("pyarrow.parquet", "arrow")

    def __init__(self, path: Path, tables: Tables) -> None:
        self._tables = dict(tables)
        self._files = names_beside(path, tables)
        parquet = library(*self.needs)

        def writer(name: str, path: str) -> Any:
            keys = file_keys(tables[name], {"table": name})
            # The result of the drive is known only at the end, so it is written there.
            schema = arrow_schema(tables[name], None).with_metadata({PANDAS_KEY: keys[PANDAS_KEY]})
            return parquet.ParquetWriter(path, schema, compression="zstd")

        self._writers = opened(self._files, writer)

    def add_tables(self, part: Mapping[str, Columns]) -> None:
        """Append rows, as row groups."""
        for name, rows in part.items():
            writer = self._writers[name]
            writer.write_table(to_arrow(rows).cast(writer.schema), row_group_size=ROW_GROUP)

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Write the metadata keys and close the files."""
        files = {name: file.name for name, file in self._files.items()}
        for name, writer in self._writers.items():
            keys = file_keys(self._tables[name], {**about, "table": name, "files": files})
            writer.add_key_value_metadata({FILE_KEY: keys[FILE_KEY]})
            writer.close()
        return [named(file) for file in self._files.values()]

    def abandon(self) -> None:
        """Close and remove the unfinished files."""
        given_up(self._writers.values(), map(unfinished, self._files.values()))


def read_about(path: Path) -> dict[str, Any]:
    """Read the description of the tables from a file. Raises ImucaldError if imucald did not write
    it."""
    keys = library(*ParquetTables.needs).read_metadata(path).metadata or {}
    text = keys.get(FILE_KEY.encode())
    if text is None:
        raise ImucaldError(f"{path}: was not written by imucald")
    found: dict[str, Any] = json.loads(text)
    return found


def read_tables(folder: Path, about: Mapping[str, Any], tables: Tables) -> dict[str, Columns]:
    """Read the tables of all files that were written together."""
    parquet = library(*ParquetTables.needs)
    return {
        name: from_arrow(parquet.read_table(folder / about["files"][name]), columns)
        for name, columns in tables.items()
    }
