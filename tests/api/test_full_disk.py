"""A full disk: the tables of a drive leave no unfinished file that would keep it full."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from full_disk import full_after
from imucald.api.columns import TIMES, Columns, TableColumn
from imucald.api.files.written import write_parts
from imucald.core.errors import ImucaldError

TABLES = {
    name: (*TIMES, *(TableColumn(f"{name}_{axis}_{unit}", unit) for axis in "xyz"))
    for name, unit in (("accel", "mps2"), ("gyro", "radps"))
}


def rows(name: str) -> Columns:
    count = 20_000
    random = np.random.default_rng(5)
    t = np.arange(count) * 0.01
    arrays = (t, (t * 1e6).astype(np.int64), *random.normal(size=(3, count)))
    return Columns(TABLES[name], tuple(arrays))


@pytest.mark.parametrize(
    ("when", "size"),
    [*(("at the start", n) for n in (0, 2, 20_000)), *(("at the end", n) for n in (0, 2))],
)
@pytest.mark.parametrize("ending", ["parquet", "csv", "mf4", "mcap"])
def test_tables_that_do_not_fit_leave_no_file(
    tmp_path: Path, ending: str, size: int, when: str
) -> None:
    pytest.importorskip({"mf4": "asammdf", "mcap": "mcap"}.get(ending, "pyarrow"))
    out = tmp_path / f"out.{ending}"
    out.write_text("before")
    parts = [{name: rows(name) for name in TABLES}]

    def about() -> dict[str, object]:
        if when == "at the end":
            filled.enter_context(full_after(size))
        return {"start_us": None}

    with ExitStack() as filled:
        if when == "at the start":
            filled.enter_context(full_after(size))
        with pytest.raises(ImucaldError, match=r"out\.\w+: cannot be written: .*[Tt]oo large"):
            write_parts(out, TABLES, parts, about)
    assert [p.name for p in tmp_path.iterdir()] == [out.name]
    assert out.read_text() == "before"
