"""Tables for other libraries: Arrow, pandas, polars, and the keys that state units in files."""

from __future__ import annotations

import importlib
import json
import math
from collections.abc import Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from imucald.api.columns import Columns, TableColumn, columns_from
from imucald.core.errors import ImucaldError
from imucald.core.libraries import how_to_install

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl
    import pyarrow as pa

FILE_KEY, PANDAS_KEY, UNIT_KEY = "imucald", "PANDAS_ATTRS", "unit"
"""Keys of files (what the table is; what pandas shows as `DataFrame.attrs`) and of fields."""


def library(name: str, extra: str) -> ModuleType:
    """Import an optional library. Raises ImucaldError that names the extra that brings it."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != name.partition(".")[0]:
            raise
        text = f"this needs {name}: {how_to_install(extra)}"
        raise ImucaldError(text) from None


def units(columns: tuple[TableColumn, ...]) -> dict[str, str]:
    """Unit by column, of those that have one."""
    return {c.name: c.unit for c in columns if c.unit}


def file_keys(columns: tuple[TableColumn, ...], about: Mapping[str, Any]) -> dict[str, str]:
    """Keys for a file or a schema; about: what the table is."""
    stated = {**about, "units": units(columns)}
    text = json.dumps(stated, allow_nan=False, ensure_ascii=False)
    attributes = json.dumps({"units": stated["units"], "table": about.get("table", "")})
    return {FILE_KEY: text, PANDAS_KEY: attributes}


def arrow_schema(columns: tuple[TableColumn, ...], about: Mapping[str, Any] | None) -> pa.Schema:
    """The Arrow schema of a table; every column may be null."""
    arrow = library("pyarrow", "arrow")
    types = {
        "float": arrow.float64(),
        "int8": arrow.int8(),
        "bool": arrow.bool_(),
        "text": arrow.string(),
        "time": arrow.timestamp("us", tz="UTC"),
    }
    fields = [
        arrow.field(c.name, types[c.kind], metadata={UNIT_KEY: c.unit} if c.unit else None)
        for c in columns
    ]
    return arrow.schema(fields, metadata=None if about is None else file_keys(columns, about))


def to_arrow(table: Columns, about: Mapping[str, Any] | None = None) -> pa.Table:
    """An Arrow table; a number that is not known is null."""
    arrow = library("pyarrow", "arrow")
    schema = arrow_schema(table.columns, about)
    arrays = [
        arrow.array(array, type=field.type, from_pandas=True)
        for array, field in zip(table.arrays, schema, strict=True)
    ]
    return arrow.Table.from_arrays(arrays, schema=schema)


def from_arrow(table: pa.Table, columns: tuple[TableColumn, ...]) -> Columns:
    """The same table again."""
    arrays: list[Any] = []
    for column in columns:
        values = table.column(column.name).combine_chunks()
        if column.kind == "float":
            arrays.append(values.fill_null(math.nan).to_numpy(zero_copy_only=False))
        elif column.kind == "time":
            arrays.append(values.cast("int64").to_numpy(zero_copy_only=False))
        elif column.kind == "text":
            arrays.append(values.to_pylist())
        else:
            arrays.append(values.to_numpy(zero_copy_only=False))
    return columns_from(columns, arrays)


def to_pandas(table: Columns, name: str) -> pd.DataFrame:
    """A pandas frame; `attrs` has the units."""
    pandas = library("pandas", "pandas")
    arrays: dict[str, Any] = table.as_dict()
    if "time" in arrays:
        arrays["time"] = pandas.to_datetime(arrays["time"], unit="us", utc=True)
    frame: pd.DataFrame = pandas.DataFrame(arrays)
    frame.attrs.update({"units": units(table.columns), "table": name})
    return frame


def to_polars(table: Columns) -> pl.DataFrame:
    """A polars frame; a number that is not known is null."""
    polars = library("polars", "polars")
    series = []
    for column, array in zip(table.columns, table.arrays, strict=True):
        if column.kind == "text":
            one = polars.Series(column.name, array.tolist(), dtype=polars.String)
        else:
            one = polars.Series(column.name, array)
        if column.kind == "float" and np.isnan(array).any():
            one = one.fill_nan(None)
        elif column.kind == "time":
            one = one.cast(polars.Datetime("us", "UTC"))
        series.append(one)
    frame: pl.DataFrame = polars.DataFrame(series)
    return frame
