"""Write the corrected signals of one drive: one file for each sensor. The process that evaluates
the drive writes them."""

from __future__ import annotations

from urllib.parse import quote

import pyarrow as pa

from imucald.api.columns import EVENTS, HISTORY, RAW, Columns
from imucald.api.drive import DriveResult
from imucald.api.interchange import to_arrow
from imucald.fleet.drive_row import day_of
from imucald.fleet.store import Store
from imucald.fleet.tables import as_parquet
from imucald.fleet.task import Task


def write_signals(drive: DriveResult, task: Task, key: str, start: float | None) -> None:
    """Write the files signals/NAME/vehicle=V/date=D/KEY.parquet. The same log gives the same
    files."""
    store = Store(task.signals or "", task.storage)
    vehicle = quote(task.vehicle, safe="")
    day = day_of(start) or task.date or "unknown"
    for name, table in drive.tables.items():
        if name not in (EVENTS, HISTORY) and not name.startswith(RAW):
            place = f"signals/{name.replace('/', '_')}/vehicle={vehicle}/date={day}/{key}.parquet"
            about = {"table": f"signals/{name}", "log_key": key}
            store.write(place, as_parquet(_single(to_arrow(table, about), table)))


def _single(table: pa.Table, columns: Columns) -> pa.Table:
    """Convert measured numbers to single precision, because its 24 bits exceed the resolution of
    any sensor."""
    fields = [
        field.with_type(pa.float32()) if column.kind == "float" and column.name != "t_s" else field
        for field, column in zip(table.schema, columns.columns, strict=True)
    ]
    return table.cast(pa.schema(fields, metadata=table.schema.metadata))
