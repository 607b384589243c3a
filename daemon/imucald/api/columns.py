"""Define the columns of each table: name, unit, kind. The name contains the unit too.

New columns may be added later. A column never changes its name or its meaning.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.samples import QUANTITIES

RAW = "raw/"
"""Prefix of the names of tables with raw samples (as the sensors sent them)."""
HISTORY, EVENTS = "history", "events"


class TableColumn(Struct, frozen=True):
    """One column.

    unit: "1" for a pure number, "" for a column to which no unit applies (texts, times of day).
    kind: "float", "int8", "bool", "text" or "time" (whole microseconds since 1970, UTC).
    """

    name: str
    unit: str
    kind: str = "float"


TIMES = (TableColumn("t_s", "s"), TableColumn("time", "", "time"))
"""The first two columns of every table. `t_s`: seconds since the log's first frame; it never
decreases. `time`: the time that the log states."""

_DTYPES: Mapping[str, Any] = {
    "float": np.float64,
    "int8": np.int8,
    "bool": np.bool_,
    "text": object,
    "time": np.int64,
}


HISTORY_COLUMNS = (
    *TIMES,
    TableColumn("state", "", "text"),
    TableColumn("usable", "", "bool"),
    *(TableColumn(f"{angle}_deg", "deg") for angle in ("roll", "pitch", "yaw")),
    *(TableColumn(f"q_{part}", "1") for part in "wxyz"),
    *(TableColumn(f"cov_{pair}_deg2", "deg^2") for pair in ("xx", "xy", "xz", "yy", "yz", "zz")),
    *(TableColumn(f"{angle}_std_deg", "deg") for angle in ("roll", "pitch", "yaw")),
)
EVENT_COLUMNS = (
    *TIMES,
    TableColumn("kind", "", "text"),
    TableColumn("text", "", "text"),
    *(TableColumn(f"d_{axis}_deg", "deg") for axis in "xyz"),
)


def corrected_columns(kind: str) -> tuple[TableColumn, ...]:
    """Columns for the corrected samples of a sensor; kind: "accel", "gyro" or "mag"."""
    return (*TIMES, *_triad(kind, ""), TableColumn("quality", "1", "int8"))


def raw_columns(channel: str, kind: str | None = None) -> tuple[TableColumn, ...]:
    """Columns for a channel's raw samples (see `core.samples`).

    kind: the kind of sensor, for the channel of a parallel sensor; None for other channels.
    """
    sensor = kind or channel
    quantity = QUANTITIES[sensor]
    if quantity.width == 3:
        return (*TIMES, *_triad(sensor, "raw_"))
    if sensor == "wheel_speeds":
        return (
            *TIMES,
            *(TableColumn(f"raw_wheel_speed_{w}_mps", "m/s") for w in ("fl", "fr", "rl", "rr")),
        )
    if not quantity.unit:
        return (*TIMES, TableColumn(f"raw_{sensor}", "1"))
    return (*TIMES, TableColumn(f"raw_{sensor}_{quantity.suffix}", quantity.unit))


def _triad(kind: str, before: str) -> tuple[TableColumn, ...]:
    of = QUANTITIES[kind]
    return tuple(TableColumn(f"{before}{kind}_{axis}_{of.suffix}", of.unit) for axis in "xyz")


class Columns(Struct, frozen=True, eq=False):
    """A table: its columns and one array (N,) per column. NaN (None in texts) means unknown."""

    columns: tuple[TableColumn, ...]
    arrays: tuple[NDArray[Any], ...]

    def __len__(self) -> int:
        return len(self.arrays[0])

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the array of the column with this name."""
        return self.as_dict()[name]

    def from_row(self, first: int) -> Columns:
        """Return the rows from index `first` to the end."""
        return Columns(self.columns, tuple(array[first:] for array in self.arrays))

    def as_dict(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by column name."""
        return {c.name: a for c, a in zip(self.columns, self.arrays, strict=True)}

    def sorted_by_time(self) -> Columns:
        """Return the table with its rows sorted by `t_s`."""
        order = np.argsort(self.arrays[0], kind="stable")
        return Columns(self.columns, tuple(array[order] for array in self.arrays))


def columns_from(columns: tuple[TableColumn, ...], arrays: list[Any]) -> Columns:
    """Make a table from arrays or lists; each is converted to the type of its column."""
    typed = (np.asarray(a, dtype=_DTYPES[c.kind]) for c, a in zip(columns, arrays, strict=True))
    return Columns(columns, tuple(typed))


def no_rows(columns: tuple[TableColumn, ...]) -> Columns:
    """Make a table with these columns and no rows."""
    return columns_from(columns, [[] for _ in columns])
