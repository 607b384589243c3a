"""The recipe of `imucald.fleet.spark` gives the rows that `fleet run` gives."""

from __future__ import annotations

import math
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest
from fleet_files import environment, make_fleet, whole_log

from imucald.cli import main
from imucald.fleet.spark import COLUMNS, SparkFleet

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def spark() -> Iterator[Any]:
    sql = pytest.importorskip("pyspark.sql", reason="pyspark is not installed")
    if shutil.which("java") is None:
        pytest.skip("Spark needs Java")
    os.environ |= {"PYSPARK_PYTHON": sys.executable, "PYTHONPATH": environment()["PYTHONPATH"]}
    session = (
        sql.SparkSession.builder.master("local[2]")
        .config("spark.sql.session.timeZone", "UTC")
        .config("spark.ui.enabled", "false")
        .config("spark.driver.host", "127.0.0.1")
        .config("spark.driver.bindAddress", "127.0.0.1")
        .getOrCreate()
    )
    yield session
    session.stop()


def test_spark_gives_the_rows_of_a_run(spark: Any, tmp_path: Path) -> None:
    path = make_fleet(tmp_path, whole_log(tmp_path / "whole.log"), 5)
    broken = tmp_path / "logs" / "car-0" / "empty.log"
    broken.write_text("")
    assert (
        main(["fleet", "run", "--fleet", str(path), "--out", str(tmp_path / "out"), "--quiet"]) == 3
    )
    fleet = SparkFleet.load(path)
    sources = [(str(p),) for p in sorted((tmp_path / "logs").rglob("*.log"))]
    frame = spark.createDataFrame(sources, "source STRING").repartition(3)
    rows = frame.mapInPandas(fleet.map_frame, schema=fleet.schema).collect()
    assert len(rows) == 6
    (failed,) = [row for row in rows if row["outcome"] != "ok"]
    assert (failed["source"], failed["outcome"]) == (str(broken), "no_frames")
    expected = {r["log_key"]: r for r in pq.read_table(tmp_path / "out" / "drives").to_pylist()}
    assert len(expected) == 5
    for row in rows:
        if row["outcome"] == "ok":
            for name, value in expected[row["log_key"]].items():
                assert _same(row[name], value), name
    assert [c.name for c in COLUMNS] == list(rows[0].asDict())


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, float) and math.isnan(one):
        return other is None
    if hasattr(other, "tzinfo") and other is not None:
        return bool(one == other.replace(tzinfo=None))
    return bool(one == other)
