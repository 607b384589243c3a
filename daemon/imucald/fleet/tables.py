"""Tables as Parquet files: parts during a run, one sorted file after the run.

`drives/drives.parquet` is the finished table. `drives/part-00000007.parquet` contains the rows of
flush 7 of a run. All parts of a flush have the same number. The part of `sources` is written last
and marks the flush as complete. Rows are identified by their keys, and the latest row with a key is
valid, so rows that are written twice cause no error.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from typing import Any, Final

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from imucald.core.errors import ImucaldError
from imucald.core.text import encodable
from imucald.fleet.columns import ORDER, TABLES, VERSION, Column
from imucald.fleet.store import Store

TYPES: Mapping[str, pa.DataType] = {
    "text": pa.string(),
    "time": pa.timestamp("us", "UTC"),
    "float": pa.float64(),
    "integer": pa.int64(),
    "short": pa.int16(),
    "flag": pa.bool_(),
}
ROW_GROUP = 25_000
"""Number of rows in a row group. Readers can skip whole row groups."""
WRITING: Final[dict[str, Any]] = {
    "compression": "zstd",
    "compression_level": 3,
    "write_page_checksum": True,
}
ASIDE = "_damaged"
"""Folder for damaged files. Readers of tables ignore this folder."""
PART = "part-"
REMEDY = "run' renames it and evaluates its logs again"


class DamagedTableError(ImucaldError):
    """A file cannot be read as a table. reason: the reason without the remedy."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"{reason}; 'imucald fleet {remedy}")
        self.reason = reason


def schema_of(table: str, columns: Sequence[Column]) -> pa.Schema:
    """Return the Arrow schema of a table. The units are in the metadata of the fields and in the
    metadata of the file."""
    fields = [
        pa.field(
            c.name,
            TYPES[c.kind],
            metadata={"unit": c.unit, "description": c.meaning}
            if c.unit
            else {"description": c.meaning},
        )
        for c in columns
    ]
    units = {c.name: c.unit for c in columns if c.unit}
    about = {"table": table, "version": VERSION, "units": units}
    keys = {"imucald": json.dumps(about), "PANDAS_ATTRS": json.dumps({"units": units})}
    return pa.schema(fields, metadata=keys)


def table_of(
    name: str, rows: Sequence[Mapping[str, Any]], columns: Sequence[Column] | None = None
) -> pa.Table:
    """Convert rows to a table with all columns. Times in the rows are UNIX times [s]. Names that
    are not UTF-8 are escaped (`encodable`).
    """
    columns = TABLES[name] if columns is None else columns
    schema = schema_of(name, columns)
    arrays = []
    for column, field in zip(columns, schema, strict=True):
        values = [row.get(column.name) for row in rows]
        if column.kind == "time":
            values = [None if v is None else round(v * 1e6) for v in values]
            arrays.append(pa.array(values, pa.int64()).cast(field.type))
        elif column.kind == "text":
            texts = [None if v is None else encodable(v) for v in values]
            arrays.append(pa.array(texts, field.type))
        else:
            arrays.append(pa.array(values, field.type))
    return pa.Table.from_arrays(arrays, schema=schema)


def as_parquet(table: pa.Table) -> bytes:
    """Return the table as bytes of a Parquet file. The same table gives the same bytes."""
    sink = io.BytesIO()
    pq.write_table(table, sink, row_group_size=ROW_GROUP, **WRITING)
    return sink.getvalue()


def main_file(table: str) -> str:
    """Return the file name of the finished table."""
    return f"{table}/{table.rpartition('/')[2]}.parquet"


def parts(store: Store, table: str) -> list[tuple[int, str]]:
    """Return flush number and name of each file of a table, the oldest first. Number 0 is the
    finished table."""
    found = []
    for name in store.names(table, ".parquet"):
        stem = name.rpartition("/")[2].removesuffix(".parquet")
        if name == main_file(table):
            found.append((0, name))
        elif stem.startswith(PART) and stem.removeprefix(PART).isdigit():
            found.append((int(stem.removeprefix(PART)), name))
    return sorted(found)


def write_part(store: Store, table: str, number: int, rows: Sequence[Mapping[str, Any]]) -> None:
    """Write the rows of a flush."""
    if rows:
        data = as_parquet(table_of(table, rows))
        store.write(f"{table}/{PART}{number:08d}.parquet", data)


def read_file(store: Store, name: str, columns: Sequence[Column]) -> pa.Table:
    """Read one file of a table. Columns that an older version did not write are null.

    Raises DamagedTableError if the content is not such a table, and ImucaldError if the file cannot
    be read.
    """
    data = store.read(name)
    schema = schema_of(name.partition("/")[0], columns)
    try:
        found = pq.read_table(pa.BufferReader(data), page_checksum_verification=True)
        arrays = [
            found.column(f.name).cast(f.type)
            if f.name in found.column_names
            else pa.nulls(len(found), f.type)
            for f in schema
        ]
    except (pa.ArrowException, OSError, ValueError) as error:
        remedy = "analyse' writes it again" if name.startswith("analysis/") else REMEDY
        reason = str(error).splitlines()[0]
        text = f"{store.url}/{name}: this is not a Parquet file, or it is damaged: {reason}"
        raise DamagedTableError(text, remedy) from None
    return pa.Table.from_arrays(arrays, schema=schema)


def read_with_parts(
    store: Store, table: str, names: Sequence[str] | None = None
) -> tuple[pa.Table, list[int]]:
    """Read all files of a table in order. Return the table and the flush number of each row.

    names: names of the columns to read; None means all columns.
    """
    columns = [c for c in TABLES[table] if names is None or c.name in names]
    found, numbers = [], []
    for number, name in parts(store, table):
        one = read_file(store, name, columns)
        found.append(one)
        numbers += [number] * len(one)
    empty = schema_of(table, columns).empty_table()
    return pa.concat_tables([empty, *found]), numbers


class FinishedRows:
    """The rows of a finished table: the valid rows, sorted.

    The rows are assembled one row group at a time, so that the table is in memory only once. kept:
    indices of the valid rows; None means all rows. instead: for some columns, texts that replace
    the values of the valid rows.
    """

    def __init__(
        self,
        table: str,
        rows: pa.Table,
        kept: Sequence[int] | None = None,
        instead: Mapping[str, Sequence[str | None]] | None = None,
    ) -> None:
        self._rows = rows
        chosen = pa.array(range(len(rows)) if kept is None else kept, pa.int64())
        texts = {name: pa.array(values, pa.string()) for name, values in (instead or {}).items()}
        keys = {
            key: texts[key] if key in texts else rows.column(key).take(chosen)
            for key in ORDER[table]
        }
        by = [(key, "ascending") for key in ORDER[table]]
        order = pc.sort_indices(pa.table(keys), sort_keys=by)
        self._chosen = chosen.take(order)
        self._texts = {name: values.take(order) for name, values in texts.items()}

    def table(self) -> pa.Table:
        """Return all rows as one table."""
        return self._part(0, len(self._chosen))

    def parquet(self) -> bytes:
        """Return the bytes of the finished file. The same rows give the same bytes."""
        sink = io.BytesIO()
        count = len(self._chosen)
        with pq.ParquetWriter(sink, self._rows.schema, **WRITING) as writer:
            for first in range(0, max(count, 1), ROW_GROUP):
                part = self._part(first, min(first + ROW_GROUP, count))
                writer.write_table(part, row_group_size=ROW_GROUP)
        return sink.getvalue()

    def _part(self, first: int, stop: int) -> pa.Table:
        part = self._rows.take(self._chosen.slice(first, stop - first))
        for name, values in self._texts.items():
            place = part.column_names.index(name)
            part = part.set_column(
                place, part.schema.field(name), values.slice(first, stop - first)
            )
        return part


def set_damaged_aside(store: Store) -> list[str]:
    """Move damaged files of the tables to the folder `ASIDE`. Return one line of text for each
    file. Only the holder of the lease may call this function.

    If a file of `events` is damaged, the rows of `drives` from the same flush are moved too. Then
    `known_sources` does not find the logs of these rows, and the logs are evaluated again.
    """
    said = []
    for table in TABLES:
        for number, name in parts(store, table):
            try:
                read_file(store, name, TABLES[table])
            except DamagedTableError as error:
                said.append(f"{error.reason}; the file is renamed to {_set_aside(store, name)}")
                if table == "events":
                    for _, other in (p for p in parts(store, "drives") if p[0] == number):
                        _set_aside(store, other)
    return said


def _set_aside(store: Store, name: str) -> str:
    number = len(store.names(ASIDE, "")) + 1
    aside = f"{ASIDE}/{number:03}-{name.replace('/', '-')}"
    store.write(aside, store.read(name))
    store.remove(name)
    return aside
