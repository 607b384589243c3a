"""Names, links and damaged tables in a fleet's folders cost their own logs, and are named."""

from __future__ import annotations

import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from fleet_files import fleet_file, tables_of
from test_driver import go, good, make_logs

from imucald.cli import main
from imucald.core.errors import ImucaldError
from imucald.fleet.columns import TABLES
from imucald.fleet.compaction import read_tables
from imucald.fleet.fetch import local_copy
from imucald.fleet.fleet_file import Fleet, load_fleet
from imucald.fleet.listing import list_logs
from imucald.fleet.store import Store
from imucald.fleet.tables import ASIDE, set_damaged_aside
from imucald.fleet.task import Outcome, Task
from imucald.fleet.workers import run_one_log

SECRET = "root:$6$secret"


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    return load_fleet(make_logs(tmp_path, ["x", "xx", "xxx", "bad unreadable"]))


def messages(out: Path) -> dict[str, str]:
    rows = read_tables(Store(str(out)), ("failures",))["failures"].to_pylist()
    return {Path(row["source"]).name: row["message"] for row in rows}


@pytest.mark.parametrize("name", [b"car-1/\xff.log", b"car-\xff/1.log"])
def test_a_name_that_is_no_utf_8_is_a_row_and_is_not_tried_again(
    tmp_path: Path, name: bytes
) -> None:
    def judge(task: Task, tried: int) -> Outcome:
        return good(task) if task.source.isascii() else run_one_log(task)

    fleet = load_fleet(make_logs(tmp_path, ["x", "xx"]))
    odd = bytes(tmp_path / "logs") + b"/" + name
    Path(odd.decode("utf-8", "surrogateescape")).parent.mkdir(exist_ok=True)
    Path(odd.decode("utf-8", "surrogateescape")).write_text("x")
    go(fleet, tmp_path / "out", judge)
    [row] = read_tables(Store(str(tmp_path / "out")), ("failures",))["failures"].to_pylist()
    assert r"\udcff" in row["source"]
    assert "is not UTF-8; rename it" in row["message"]
    assert pq.read_table(tmp_path / "out" / "drives").num_rows == 2
    assert go(fleet, tmp_path / "out", judge)[0].tried == []


def test_a_row_that_fits_no_table_is_a_failure_of_its_log(tmp_path: Path, fleet: Fleet) -> None:
    def judge(task: Task, tried: int) -> Outcome:
        outcome = good(task)
        if outcome.log_key == "key-xx":
            outcome.drive["frames_read"] = 2**70
        return outcome

    go(fleet, tmp_path / "out", judge)
    assert "does not fit the table" in messages(tmp_path / "out")["001.log"]
    assert pq.read_table(tmp_path / "out" / "drives").num_rows == 2


@pytest.mark.parametrize("table", ["drives", "events", "failures", "sources", "costs"])
@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_a_damaged_table_is_set_aside_and_its_logs_are_evaluated_again(
    tmp_path: Path, fleet: Fleet, table: str, damage: str
) -> None:
    out = tmp_path / "out"
    go(fleet, out)
    before = tables_of(out)
    path = out / table / f"{table}.parquet"
    data = bytearray(path.read_bytes())
    if damage == "flipped":
        data[40] ^= 1  # of a page's content: no reader without checksums sees it
    path.write_bytes(data[:-100] if damage == "cut" else data)
    with pytest.raises(ImucaldError, match=r"fleet run' renames it"):
        read_tables(Store(str(out)))
    said = set_damaged_aside(Store(str(out)))
    assert f"{table}.parquet" in said[0]
    assert (out / ASIDE).is_dir()
    assert set_damaged_aside(Store(str(out))) == []
    tried = go(fleet, out)[0].tried
    again = {"drives": 3, "events": 3, "failures": 1, "sources": 4, "costs": 0}
    assert len(tried) == again[table]
    if table != "costs":
        assert tables_of(out) == before


def test_what_is_set_aside_is_kept_apart(tmp_path: Path, fleet: Fleet) -> None:
    out = tmp_path / "out"
    for _ in range(2):
        go(fleet, out)
        for table in TABLES:
            (out / table / f"{table}.parquet").write_bytes(b"PAR1 damaged PAR1")
        set_damaged_aside(Store(str(out)))
    assert len(list((out / ASIDE).iterdir())) == 2 * len(TABLES)


def test_run_says_what_is_damaged(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    place = tmp_path / "logs" / "car-1"
    place.mkdir(parents=True)
    (place / "1.log").write_text("(1.0) can0 123#00\n")
    out = str(tmp_path / "out")
    command = ["fleet", "run", "--fleet", str(fleet_file(tmp_path)), "--out", out, "--quiet"]
    main(command)
    table = tmp_path / "out" / "failures" / "failures.parquet"
    table.write_bytes(table.read_bytes()[:-100])
    main(["fleet", "status", "--out", out])
    assert "'imucald fleet run' renames it" in capsys.readouterr().err
    main(command)
    said = capsys.readouterr().err
    assert "failures.parquet: this is not a Parquet file, or it is damaged" in said
    assert "0 known, 1 to evaluate" in said
    assert main(["fleet", "status", "--out", out]) == 0


def test_a_link_out_of_the_listed_folder_is_refused_without_its_content(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text(f"{SECRET}\n")
    place = tmp_path / "logs" / "car-1"
    place.mkdir(parents=True)
    (place / "1.log").write_text("words of the log's own\n")
    (place / "inner.log").symlink_to(place / "1.log")
    (place / "shadow.log").symlink_to(tmp_path / "secret")
    out = tmp_path / "out"
    main(["fleet", "run", "--fleet", str(fleet_file(tmp_path)), "--out", str(out), "--quiet"])
    found = messages(out)
    assert "this link points outside" in found["shadow.log"]
    assert SECRET not in found["shadow.log"]
    assert "words of the log" in found["inner.log"]


def test_a_link_that_is_named_itself_is_followed(tmp_path: Path) -> None:
    (tmp_path / "store").write_text("words of the log's own\n")
    (tmp_path / "1.log").symlink_to(tmp_path / "store")
    out = tmp_path / "out"
    fleet = str(fleet_file(tmp_path))
    main(["fleet", "run", "--fleet", fleet, "--out", str(out), "--logs", "1.log", "--quiet"])
    assert "words of the log" in messages(out)["1.log"]


def test_a_log_stays_the_one_that_was_judged_when_a_link_takes_its_name(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text(f"{SECRET}\n")
    log = tmp_path / "logs" / "1.log"
    log.parent.mkdir()
    log.write_text("words of the log's own\n")
    with local_copy(str(log), {}, str(log.parent)) as (path, _):
        log.unlink()
        log.symlink_to(tmp_path / "secret")
        assert path.read_text() == "words of the log's own\n"
        assert path.name == "1.log"


@pytest.mark.parametrize(
    ("content", "why"),
    [
        ("list.csv\n", "contains itself"),
        ('"' + "x" * 200_000, "cannot be read"),
        ("ftp://a/b.log\n", "ftp://a/b.log"),
        ("filecache::file:///1.log\n", "filecache"),
    ],
)
def test_a_list_that_makes_no_sense_is_refused(tmp_path: Path, content: str, why: str) -> None:
    (tmp_path / "list.csv").write_text(content)
    path = fleet_file(tmp_path)
    path.write_text(re.sub(r"(?m)^logs:.*", "logs: list.csv", path.read_text()))
    with pytest.raises(ImucaldError, match=why):
        list_logs(load_fleet(path))
