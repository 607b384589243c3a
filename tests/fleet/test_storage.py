"""Storage that fails for a moment, tables of an older version, and files that appear at once."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from imucald.core.errors import ImucaldError
from imucald.fleet import fetch
from imucald.fleet.columns import TABLES
from imucald.fleet.compaction import read_tables
from imucald.fleet.fetch import StorageError, local_copy
from imucald.fleet.store import WORK, Store
from imucald.fleet.tables import table_of


class Flaky:
    """A file system whose first reads fail."""

    def __init__(self, failures: int, error: Exception) -> None:
        self.left, self.error, self.calls = failures, error, 0

    def open(self, url: str, mode: str) -> io.BytesIO:
        self.calls += 1
        if self.calls <= self.left:
            raise self.error
        return io.BytesIO(b"content of " + url.encode())


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fetch, "WAIT_S", 0.0)


def test_a_storage_that_fails_for_a_moment_is_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    system = Flaky(2, ConnectionError("reset"))
    monkeypatch.setattr(fetch, "file_system", lambda *_: system)
    with local_copy("s3://lake/car/1.log.gz", {}) as (path, key):
        assert path.read_bytes() == b"content of s3://lake/car/1.log.gz"
        assert path.name == "1.log.gz", "its ending says what format it is"
        assert len(key) == 16
    assert not path.exists()
    assert system.calls == 3


@pytest.mark.parametrize(
    ("error", "calls"), [(ConnectionError("reset"), 3), (FileNotFoundError("gone"), 1)]
)
def test_a_storage_that_stays_away_is_reported(
    monkeypatch: pytest.MonkeyPatch, error: Exception, calls: int
) -> None:
    system = Flaky(9, error)
    monkeypatch.setattr(fetch, "file_system", lambda *_: system)
    with (
        pytest.raises(StorageError, match=r"s3://lake/1\.log: cannot be fetched"),
        local_copy("s3://lake/1.log", {}),
    ):
        pass
    assert system.calls == calls


def test_a_protocol_without_its_package_is_reported() -> None:
    with pytest.raises(StorageError, match="nosuch"):
        Store("nosuch://lake")


def rows_of(*sources: str, **values: Any) -> list[dict[str, Any]]:
    return [{"source": s, "log_key": f"key-{s}", "outcome": "ok", **values} for s in sources]


def test_tables_of_an_older_version_have_nulls_for_newer_columns(tmp_path: Path) -> None:
    """Columns are only appended: an old file lacks the last ones, and is read with the new."""
    for name, number, sources in (("old", 1, "ab"), ("new", 2, "c")):
        table = table_of("sources", rows_of(*sources, vehicle="v", bytes=7))
        if name == "old":
            table = table.drop_columns(["bytes", "schema_version"])
        place = tmp_path / "sources" / f"part-{number:08}.parquet"
        place.parent.mkdir(exist_ok=True)
        pq.write_table(table, place)
    found = read_tables(Store(str(tmp_path)), ("sources",))["sources"]
    assert found.schema.names == [column.name for column in TABLES["sources"]]
    assert found.column("source").to_pylist() == ["a", "b", "c"]
    assert found.column("bytes").to_pylist() == [None, None, 7]
    assert found.schema.field("bytes").type == pa.int64()


def test_a_file_that_is_no_parquet_is_reported(tmp_path: Path) -> None:
    (tmp_path / "sources").mkdir()
    (tmp_path / "sources" / "sources.parquet").write_text("no")
    with pytest.raises(ImucaldError, match=r"sources\.parquet: this is not a Parquet file"):
        read_tables(Store(str(tmp_path)))


def test_unfinished_files_lie_outside_the_tables(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(str(tmp_path))
    store.write("drives/drives.parquet", b"old")

    def killed(self: Path, target: Path) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        store.write("drives/drives.parquet", b"new")
    assert [p.name for p in (tmp_path / "drives").iterdir()] == ["drives.parquet"]
    assert store.read("drives/drives.parquet") == b"old"
    assert len(list((tmp_path / WORK).iterdir())) == 1
    store.tidy()
    assert list((tmp_path / WORK).iterdir()) == []
