"""Compute the rows of `drives` in Spark, for users with a Spark cluster and without Dask.

    fleet = imucald.fleet.spark.SparkFleet.load("fleet.yaml")
    paths = spark.createDataFrame([("/lake/raw/car-1/1.mf4",)], "source STRING")
    rows = paths.repartition(200).mapInPandas(fleet.map_frame, schema=fleet.schema)
    rows.write.parquet("/lake/drives")

The rows have the columns of `drives`, and the additional columns source, outcome and message. Set
the option `spark.sql.session.timeZone` to `UTC`. Spark uses the same function and the same kind of
child process as `imucald fleet run`, so the rows are the same. Spark writes the rows itself, so
Spark determines resuming, keys and the order of rows.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucald.fleet.bundle import unpack
from imucald.fleet.columns import TABLES, row_of, texts
from imucald.fleet.drive_row import drive_values
from imucald.fleet.fleet_file import Fleet, load_fleet
from imucald.fleet.plan import Options, task_of
from imucald.fleet.tables import table_of
from imucald.fleet.task import LogLimits
from imucald.fleet.workers import run_one_log

if TYPE_CHECKING:
    import pandas as pd

DDL = {
    "text": "STRING",
    "time": "TIMESTAMP",
    "float": "DOUBLE",
    "integer": "BIGINT",
    "short": "SMALLINT",
}
COLUMNS = (
    *TABLES["drives"],
    *texts(
        source="address of the log",
        outcome="ok, or the kind of failure",
        message="reason of a failure, in words",
    ),
)
"""Columns of the result. Every log has a row, even if its evaluation failed."""


@dataclass(frozen=True)
class SparkFleet:
    """A fleet file in the form that is sent to Spark's workers."""

    fleet: Fleet
    options: Options

    @classmethod
    def load(cls, path: str | os.PathLike[str], limits: LogLimits | None = None) -> SparkFleet:
        """Read fleet.yaml. The key `logs` is ignored. Raises ConfigError."""
        return cls(load_fleet(Path(path)), Options(limits=limits or LogLimits()))

    @property
    def schema(self) -> str:
        """Schema of the result of `map_frame`, in the DDL of Spark."""
        return ", ".join(f"`{column.name}` {DDL[column.kind]}" for column in COLUMNS)

    def map_frame(self, frames: Iterator[pd.DataFrame]) -> Iterator[pd.DataFrame]:
        """Function for `mapInPandas`: frames with a column `source` are the input; a row for each
        log is the output."""
        unpack(self.fleet.bundles)
        for frame in frames:
            rows = [self._row(str(source)) for source in frame["source"]]
            yield table_of("drives", rows, COLUMNS).to_pandas(integer_object_nulls=True)

    def _row(self, source: str) -> dict[str, Any]:
        task = task_of(self.fleet, source, 0, self.options)
        outcome = run_one_log(task)
        values: dict[str, Any] = {"vehicle": task.vehicle}
        if outcome.drive is not None:
            values = drive_values(self.fleet, task, outcome.log_key, outcome.drive)
        row = row_of("drives", {**values, "run_key": task.bundle, "log_key": outcome.log_key})
        return {**row, "source": source, "outcome": outcome.kind, "message": outcome.message}
