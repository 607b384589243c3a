"""`imucald fleet` as a person uses it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from fleet_files import (
    CONFIG,
    environment,
    make_fleet,
    on_a_terminal,
    read_until,
    tables_of,
    whole_log,
)

import imucald
from imucald.cli import main
from imucald.fleet import page


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return whole_log(tmp_path_factory.mktemp("log") / "whole.log")


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory, log: Path) -> Path:
    """A fleet that was evaluated and analysed, one log of which failed."""
    folder = tmp_path_factory.mktemp("fleet")
    path = make_fleet(folder, log, 6, seconds=100.0)
    (folder / "logs" / "car-0" / "empty.log").write_text("")
    out = str(folder / "out")
    command = ["fleet", "run", "--fleet", str(path), "--out", out, "--signals", "corrected"]
    assert main([*command, "--workers", "2"]) == 3, "some logs failed"
    assert main(["fleet", "analyse", "--out", out]) == 0
    return folder / "out"


def evaluated(fleet: Path, out: Path) -> int:
    return main(["fleet", "run", "--fleet", str(fleet), "--out", str(out), "--quiet"])


@pytest.mark.slow
def test_every_reader_sees_the_same_table(done: Path) -> None:
    duckdb, pl, pd = (pytest.importorskip(n) for n in ("duckdb", "polars", "pandas"))
    for table in ("drives", "events", "failures", "analysis/vehicles", "analysis/types"):
        folder = done / table
        rows = pq.read_table(folder).to_pylist()
        name = str(next(folder.iterdir()))
        of_duckdb = duckdb.sql(
            f"SET TimeZone='UTC'; SELECT * FROM '{folder}/*.parquet'"
        ).to_arrow_table()
        assert _plain(of_duckdb.to_pylist()) == _plain(rows)
        assert _plain(pl.read_parquet(name).to_dicts()) == _plain(rows)
        frame = pd.read_parquet(name)
        assert list(frame.columns) == list(rows[0])
        assert len(frame) == len(rows)
        assert frame.attrs["units"] == {
            c: u for c, u in frame.attrs["units"].items() if c in frame.columns
        }


def _plain(rows: list[dict[str, object]]) -> list[dict[str, object]]:
    """Values that libraries give as their own kinds of the same."""
    return [{k: str(v)[:19] if hasattr(v, "year") else v for k, v in row.items()} for row in rows]


def test_signals_are_found_by_vehicle_and_day(done: Path) -> None:
    duckdb = pytest.importorskip("duckdb")
    query = (
        f"SELECT vehicle, count(*) n, max(abs(accel_z_mps2)) z FROM "
        f"read_parquet('{done}/signals/accel/**/*.parquet', hive_partitioning=true) "
        "WHERE quality > 0 GROUP BY vehicle ORDER BY vehicle"
    )
    rows = duckdb.sql(query).fetchall()
    assert rows, "100 s of a city are enough for some to become usable"
    assert all(vehicle.startswith("car-") and n > 100 and 8.0 < z < 25.0 for vehicle, n, z in rows)
    files = list((done / "signals").rglob("*.parquet"))
    assert len(files) == 12
    keys = set(pq.read_table(done / "drives").column("log_key").to_pylist())
    assert {file.stem for file in files} == keys
    assert not any("_work" in str(p) for p in (done / "signals").rglob("*"))


def test_status_and_why_tell_what_the_tables_hold(
    done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["fleet", "status", "--out", str(done)]) == 0
    text = capsys.readouterr().out
    assert "7 logs" in text
    assert "6 drives of 3 vehicles" in text
    assert "no_frames" in text
    assert main(["fleet", "why", "--out", str(done), "empty"]) == 0
    assert "holds no CAN frame" in capsys.readouterr().out
    key = pq.read_table(done / "drives").column("log_key").to_pylist()[0]
    assert main(["fleet", "why", "--out", str(done), key]) == 0
    assert key in capsys.readouterr().out
    assert main(["fleet", "why", "--out", str(done), "car"]) == 1
    assert "7 logs match" in capsys.readouterr().err


def test_a_fleet_is_read_from_python_as_the_files_have_it(done: Path) -> None:
    fleet = imucald.Fleet.open(str(done))
    assert fleet.drives.equals(pq.read_table(done / "drives"))
    assert fleet.failures.column("kind").to_pylist() == ["no_frames"]
    assert set(fleet.events.column("log_key").to_pylist()) <= set(
        fleet.drives.column("log_key").to_pylist()
    )
    assert fleet.vehicles.equals(pq.read_table(done / "analysis" / "vehicles"))
    again = fleet.analyse(groups=("vehicle_type",))
    assert fleet.table("analysis/groups").equals(again["analysis/groups"])
    assert repr(fleet) == f"Fleet at {done}: 6 drives, 1 failed"
    with pytest.raises(imucald.ImucaldError, match="there are: drives"):
        fleet.table("motors")
    with pytest.raises(imucald.ImucaldError, match="no results here yet"):
        imucald.Fleet.open(str(done / "nowhere"))


@pytest.mark.slow
def test_a_diagnosis_of_each_drive_is_a_column_where_it_is_asked_for(
    tmp_path: Path, log: Path
) -> None:
    fleet = make_fleet(tmp_path, log, 1, seconds=180.0)
    command = ["fleet", "run", "--fleet", str(fleet), "--out", str(tmp_path / "out"), "--quiet"]
    assert main([*command, "--workers", "1"]) == 0
    (text,) = pq.read_table(tmp_path / "out" / "drives").column("diagnosed").to_pylist()
    assert text is None
    assert main([*command, "--workers", "1", "--redo", "all", "--diagnose"]) == 0
    (text,) = pq.read_table(tmp_path / "out" / "drives").column("diagnosed").to_pylist()
    found = imucald.diagnose(imucald.Config.load(CONFIG), log)
    assert json.loads(text) == sorted(found.causes)


def test_the_report_is_one_page_that_loads_nothing(done: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    page = tmp_path / "page.html"
    assert main(["fleet", "report", "--out", str(done), "--html", str(page)]) == 0
    text = page.read_text()
    assert not re.search(r"""(src|href)=["'](?!data:|\#)""", text)
    assert not re.search(r"url\((?!data:)|@import|<script", text)
    assert text.count("data:image/svg+xml") >= 2
    assert "holds no CAN frame" in text
    counts = pq.read_table(done / "analysis" / "vehicles").column("drives").to_pylist()
    assert sum(counts) - len(counts) < 3, "the drives of these seconds are too few"
    assert "Between drives: not known, too few drives" in text
    head = text.partition(">Vehicles and their mounts</h2>")[2].partition("<h2")[0]
    segments = pq.read_table(done / "analysis" / "segments").to_pylist()
    rows = re.findall(r'<tr(?: class="marked")?><td class="name">([^<]+)</td>', head)
    assert rows == sorted({s["vehicle"] for s in segments})


def test_a_folder_without_a_run_or_analysis_says_what_to_do(
    tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for action in ("status", "analyse"):
        assert main(["fleet", action, "--out", str(tmp_path)]) == 1
        assert "imucald fleet run" in capsys.readouterr().err
    path = make_fleet(tmp_path, log, 1)
    assert evaluated(path, tmp_path / "out") == 0
    assert (
        main(["fleet", "report", "--out", str(tmp_path / "out"), "--html", str(tmp_path / "x")])
        == 1
    )
    assert "imucald fleet analyse" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("config: car.yaml\n", "logs"),
        ("logs: x\nconfig: nothing.yaml\n", "nothing.yaml"),
        (f"logs: x\nconfig: {CONFIG}\n", "there is no log at x"),
        (
            f"logs: x\nconfig: {CONFIG}\npath: '(x'\n",
            "fleet.yaml:3: path: is no",
        ),
        (f"logs: x\nconfig: {CONFIG}\npath: x\n", "(?P<vehicle>"),
        (f"logs: x\nconfig: {CONFIG}\nvehicles: no.csv\n", "fleet.yaml:3: vehicles"),
        (f"logs: x\nconfig: {CONFIG}\nfrobnicate: 1\n", "frobnicate"),
        (f"logs: memory://x/*\nconfig: {CONFIG}\n", "logs cannot be read from memory"),
    ],
)
def test_a_wrong_fleet_file_is_reported_before_any_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, words: str
) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(text)
    assert main(["fleet", "run", "--fleet", str(path), "--out", str(tmp_path / "out")]) == 1
    assert words in capsys.readouterr().err
    assert not (tmp_path / "out" / "sources").exists()


def test_logs_come_from_any_file_system_that_fsspec_knows(tmp_path: Path, log: Path) -> None:
    """A zip archive stands for object stores: nothing there is a path of this machine."""
    path = make_fleet(tmp_path, log, 3)
    assert evaluated(path, tmp_path / "a") == 0
    with zipfile.ZipFile(tmp_path / "logs.zip", "w") as archive:
        for file in sorted((tmp_path / "logs").rglob("*.log")):
            archive.write(file, file.relative_to(tmp_path))
    path.write_text(
        f"logs: 'zip://logs/**/*.log'\nconfig: {CONFIG}\n"
        f"storage: {{zip: {{fo: {tmp_path}/logs.zip}}}}\n"
    )
    assert evaluated(path, tmp_path / "b") == 0
    a, b = (pq.read_table(tmp_path / name / "drives").to_pylist() for name in "ab")
    for one, other in zip(a, b, strict=True):
        assert other.pop("sources").startswith('["zip://logs/car-')
        one.pop("sources")
        assert one == other


def test_a_list_of_logs_and_a_dry_run(
    tmp_path: Path, log: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = make_fleet(tmp_path, log, 4)
    names = sorted(str(p) for p in (tmp_path / "logs").rglob("*.log"))
    (tmp_path / "some.txt").write_text("\n".join(names[:2]))
    command = ["fleet", "run", "--fleet", str(path), "--out", str(tmp_path / "out")]
    assert main([*command, "--logs", "some.txt", "--dry-run"]) == 0
    assert "2 logs, 0 known, 2 to evaluate" in capsys.readouterr().out
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_ctrl_c_finishes_what_runs_and_says_how_to_go_on(tmp_path: Path, log: Path) -> None:
    path = make_fleet(tmp_path, log, 24)
    command = [sys.executable, "-m", "imucald", "fleet", "run", "--fleet", str(path)]
    whole, out = tmp_path / "whole", tmp_path / "out"
    subprocess.run([*command, "--out", str(whole)], env=environment(), check=True, timeout=300)
    with on_a_terminal([*command, "--out", str(out)]) as (run, terminal):
        text = read_until(terminal, rb"[1-9]\d*/24 logs,")
        os.kill(run.pid, signal.SIGINT)
        text += read_until(terminal, None)
    assert run.returncode == 130
    assert "finishing the logs that are being evaluated" in text
    assert "Run the same command to continue" in text
    rows = pq.read_table(out / "drives").num_rows
    assert 0 < rows < 24
    assert not (out / "_lease.json").exists()
    assert pq.read_table(out / "failures").num_rows == 0, "no log is blamed for the end"
    subprocess.run([*command, "--out", str(out)], env=environment(), check=True, timeout=300)
    assert tables_of(out) == tables_of(whole)


SIGNALLED_WHILE_IT_STARTS = """
import os, signal, sys
from imucald import cli
from imucald.fleet.template_client import Template

begin = Template.begin


def begin_and_signal(self):
    begin(self)
    os.killpg(0, signal.{name})


Template.begin = begin_and_signal
sys.exit(cli.main())
"""


@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 130), ("SIGINT", 130), ("SIGKILL", -9)])
def test_a_run_that_is_stopped_while_it_starts_ends_without_a_traceback(
    tmp_path: Path, log: Path, name: str, status: int
) -> None:
    path = make_fleet(tmp_path, log, 1)
    run = subprocess.run(
        [sys.executable, "-c", SIGNALLED_WHILE_IT_STARTS.format(name=name),
         "fleet", "run", "--fleet", str(path), "--out", str(tmp_path / "out")],
        env=environment(), capture_output=True, text=True, start_new_session=True, timeout=60.0,
        check=False,
    )  # fmt: skip
    text = "" if name == "SIGKILL" else "imucald: interrupted. Run the same command to continue\n"
    assert (run.returncode, run.stderr) == (status, text)


def test_the_page_draws_nothing_of_a_vehicle_whose_only_drive_moved_and_ended_suspect() -> None:
    types = pa.schema([("vehicle", pa.string()), ("state", pa.string()), ("q_w", pa.float64())])
    drives = pa.Table.from_pylist([{"vehicle": "a", "state": "suspect", "q_w": 1.0}], types)
    moved = {"vehicle": "a", "size_deg": None, "after_log_key": "a/1.log"}
    assert page._histories([moved], drives) == []
