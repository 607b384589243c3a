"""CSV: one file per table, units in the column names. `drive.result.json` contains all other
data."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from imucald.api.columns import Columns, no_rows
from imucald.api.files.table_file import (
    Tables,
    given_up,
    named,
    names_beside,
    opened,
    unfinished,
)
from imucald.api.interchange import arrow_schema, from_arrow, library, to_arrow

if TYPE_CHECKING:
    import pyarrow as pa


def result_file(path: Path) -> Path:
    """Return the path of the JSON file with the data that CSV files cannot contain."""
    return path.with_name(f"{path.stem}.result.json")


class CsvTables:
    """Writes CSV. Unknown values are empty fields; times are ISO 8601 in UTC."""

    needs: ClassVar = ("pyarrow.csv", "arrow")

    def __init__(self, path: Path, tables: Tables) -> None:
        csv = library(*self.needs)
        self._files = names_beside(path, tables)
        self._result = result_file(path)
        self._writers = opened(
            self._files,
            lambda name, path: csv.CSVWriter(
                path, _with_time_as_text(no_rows(tables[name])).schema
            ),
        )

    def add_tables(self, part: Mapping[str, Columns]) -> None:
        """Append rows."""
        for name, rows in part.items():
            self._writers[name].write_table(_with_time_as_text(rows))

    def finish(self, about: Mapping[str, Any]) -> list[Path]:
        """Close the tables and write the result file next to them."""
        for writer in self._writers.values():
            writer.close()
        files = {name: file.name for name, file in self._files.items()}
        text = json.dumps({**about, "files": files}, indent=1, allow_nan=False, ensure_ascii=False)
        unfinished(self._result).write_text(text + "\n", encoding="utf-8")
        return [named(file) for file in (*self._files.values(), self._result)]

    def abandon(self) -> None:
        """Close and remove the unfinished files."""
        given_up(self._writers.values(), map(unfinished, (*self._files.values(), self._result)))


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


def read_tables(folder: Path, about: Mapping[str, Any], tables: Tables) -> dict[str, Columns]:
    """Read the tables of all files that were written together."""
    csv = library(*CsvTables.needs)
    found: dict[str, Columns] = {}
    for name, columns in tables.items():
        types = {field.name: field.type for field in arrow_schema(columns, None)}
        options = csv.ConvertOptions(column_types=types, strings_can_be_null=False)
        table = csv.read_csv(folder / about["files"][name], convert_options=options)
        found[name] = from_arrow(table, columns)
    return found
