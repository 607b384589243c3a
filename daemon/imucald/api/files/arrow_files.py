"""Parquet and CSV: one file per table, written by pyarrow.

Parquet is compressed with zstd. Its units are in the column names and in the metadata of fields and
file. CSV has its units in the column names; `drive.result.json` contains all
other data.
"""

from __future__ import annotations

import json
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from imucald.api.columns import Columns, no_rows
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

if TYPE_CHECKING:
    import pyarrow as pa


class _ArrowTables:
    """Writes a file per table. If a file cannot be opened, all of them are removed."""

    def __init__(self, path: Path, tables: Tables) -> None:
        self._tables, self._files = dict(tables), names_beside(path, tables)
        self._finished = [*self._files.values()]
        self._writers: dict[str, Any] = {}
        try:
            for name, file in self._files.items():
                self._writers[name] = self._writer(name, str(unfinished(file)))
        except OSError:
            self.abandon()
            raise

    @abstractmethod
    def _writer(self, name: str, path: str) -> Any: ...

    @property
    def _names(self) -> dict[str, str]:
        return {name: file.name for name, file in self._files.items()}

    def abandon(self) -> None:
        """Close and remove the unfinished files."""
        given_up(self._writers.values(), map(unfinished, self._finished))


class ParquetTables(_ArrowTables):
    """Writes Parquet."""

    needs: ClassVar = ("pyarrow.parquet", "arrow")

    def _writer(self, name: str, path: str) -> Any:
        columns = self._tables[name]
        keys = file_keys(columns, {"table": name})
        # The result of the drive is known only at the end, so it is written there.
        schema = arrow_schema(columns, None).with_metadata({PANDAS_KEY: keys[PANDAS_KEY]})
        return library(*self.needs).ParquetWriter(path, schema, compression="zstd")

    def add_tables(self, part: Mapping[str, Columns]) -> None:
        """Append rows, as row groups of the size that DuckDB and others recommend."""
        for name, rows in part.items():
            writer = self._writers[name]
            writer.write_table(to_arrow(rows).cast(writer.schema), row_group_size=100_000)

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Write the metadata keys and close the files."""
        for name, writer in self._writers.items():
            keys = file_keys(self._tables[name], {**about, "table": name, "files": self._names})
            writer.add_key_value_metadata({FILE_KEY: keys[FILE_KEY]})
            writer.close()
        return list(map(named, self._finished))


class CsvTables(_ArrowTables):
    """Writes CSV. Unknown values are empty fields; times are ISO 8601 in UTC."""

    needs: ClassVar = ("pyarrow.csv", "arrow")

    def __init__(self, path: Path, tables: Tables) -> None:
        super().__init__(path, tables)
        self._finished.append(path.with_name(f"{path.stem}.result.json"))

    def _writer(self, name: str, path: str) -> Any:
        schema = _with_time_as_text(no_rows(self._tables[name])).schema
        return library(*self.needs).CSVWriter(path, schema)

    def add_tables(self, part: Mapping[str, Columns]) -> None:
        """Append rows."""
        for name, rows in part.items():
            self._writers[name].write_table(_with_time_as_text(rows))

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Close the tables and write the result file next to them."""
        for writer in self._writers.values():
            writer.close()
        whole = {**about, "files": self._names}
        text = json.dumps(whole, indent=1, allow_nan=False, ensure_ascii=False)
        unfinished(self._finished[-1]).write_text(text + "\n", encoding="utf-8")
        return list(map(named, self._finished))


def _with_time_as_text(rows: Columns) -> pa.Table:
    """Return rows as an Arrow table whose column `time` is text: ISO 8601, UTC.

    Arrow itself can write times with a time zone only if the system has a time zone database. A
    container or a minimal Debian has none.
    """
    arrow, compute = library("pyarrow", "arrow"), library("pyarrow.compute", "arrow")
    table = to_arrow(rows)
    place = table.schema.get_field_index("time")
    if place < 0:
        return table
    text = table.column(place).cast(arrow.timestamp("us")).cast(arrow.string())
    return table.set_column(place, "time", compute.binary_join_element_wise(text, "Z", ""))


def parquet_about(path: Path) -> dict[str, Any]:
    """Read the description of the tables from a file. Raises ImucaldError if imucald did not write
    it."""
    keys = library(*ParquetTables.needs).read_metadata(path).metadata or {}
    text = keys.get(FILE_KEY.encode())
    if text is None:
        raise ImucaldError(f"{path}: was not written by imucald")
    found: dict[str, Any] = json.loads(text)
    return found


def parquet_tables(folder: Path, about: Mapping[str, Any], tables: Tables) -> dict[str, Columns]:
    """Read the tables of all files that were written together."""
    parquet = library(*ParquetTables.needs)
    return {
        name: from_arrow(parquet.read_table(folder / about["files"][name]), columns)
        for name, columns in tables.items()
    }


def csv_tables(folder: Path, about: Mapping[str, Any], tables: Tables) -> dict[str, Columns]:
    """Read the tables of all files that were written together."""
    csv = library(*CsvTables.needs)
    found: dict[str, Columns] = {}
    for name, columns in tables.items():
        types = {field.name: field.type for field in arrow_schema(columns, None)}
        options = csv.ConvertOptions(column_types=types, strings_can_be_null=False)
        table = csv.read_csv(folder / about["files"][name], convert_options=options)
        found[name] = from_arrow(table, columns)
    return found
