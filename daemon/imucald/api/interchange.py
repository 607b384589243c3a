"""Convert tables for Arrow, pandas and polars; define the metadata keys for units in files."""

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
"""Metadata keys. FILE_KEY: key of the description of the table. PANDAS_KEY: key whose content
pandas shows as `DataFrame.attrs`. UNIT_KEY: key of the unit of a field."""


def library(name: str, extra: str) -> ModuleType:
    """Import an optional library. Raises ImucaldError that names the extra to install."""
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] != name.partition(".")[0]:
            raise
        text = f"this needs {name}: {how_to_install(extra)}"
        raise ImucaldError(text) from None


def units(columns: tuple[TableColumn, ...]) -> dict[str, str]:
    """Return the unit of each column with a unit, by the name of the column."""
    return {c.name: c.unit for c in columns if c.unit}


def file_keys(columns: tuple[TableColumn, ...], about: Mapping[str, Any]) -> dict[str, str]:
    """Return the metadata keys for a file or a schema; about: the description of the table."""
    stated = {**about, "units": units(columns)}
    text = json.dumps(stated, allow_nan=False, ensure_ascii=False)
    attributes = json.dumps({"units": stated["units"], "table": about.get("table", "")})
    return {FILE_KEY: text, PANDAS_KEY: attributes}


def arrow_schema(columns: tuple[TableColumn, ...], about: Mapping[str, Any] | None) -> pa.Schema:
    """Return the Arrow schema of a table. Every column may be null."""
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
    """Convert a table to an Arrow table. An unknown number becomes null."""
    arrow = library("pyarrow", "arrow")
    schema = arrow_schema(table.columns, about)
    arrays = [
        arrow.array(array, type=field.type, from_pandas=True)
        for array, field in zip(table.arrays, schema, strict=True)
    ]
    return arrow.Table.from_arrays(arrays, schema=schema)


def from_arrow(table: pa.Table, columns: tuple[TableColumn, ...]) -> Columns:
    """Convert an Arrow table that `to_arrow` made back to a table."""
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
    """Convert a table to a pandas frame. `attrs` of the frame contains the units."""
    pandas = library("pandas", "pandas")
    arrays: dict[str, Any] = table.as_dict()
    if "time" in arrays:
        arrays["time"] = pandas.to_datetime(arrays["time"], unit="us", utc=True)
    frame: pd.DataFrame = pandas.DataFrame(arrays)
    frame.attrs.update({"units": units(table.columns), "table": name})
    return frame


def to_polars(table: Columns) -> pl.DataFrame:
    """Convert a table to a polars frame. An unknown number becomes null."""
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
