"""The driver alone writes tables; they depend on the logs, not on order, breaks or repetition."""

from __future__ import annotations

import itertools
import random
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace

import pyarrow.parquet as pq
import pytest
from fleet_files import CONFIG, fleet_file, tables_of

from imucald.cli import main
from imucald.core.errors import ImucaldError
from imucald.fleet import driver
from imucald.fleet.columns import TABLES, VERSION
from imucald.fleet.compaction import read_tables
from imucald.fleet.driver import AllFailedError, FleetRun
from imucald.fleet.fleet_file import Fleet, load_fleet
from imucald.fleet.lease import NAME, Lease
from imucald.fleet.listing import list_logs
from imucald.fleet.plan import SAMPLE, Options, Plan, planned
from imucald.fleet.store import Store
from imucald.fleet.tables import write_part
from imucald.fleet.task import Cost, Outcome, Task
from paths import ROOT

Judge = Callable[[Task, int], Outcome | None]


class FakeWorkers:
    """Gives outcomes in any order; `judge` says which (task, how often it was tried before)."""

    def __init__(self, judge: Judge, seed: int = 0, slots: int = 3) -> None:
        self.slots = slots
        self.tried: list[str] = []
        self.at_once: list[int] = []
        self._judge, self._random = judge, random.Random(seed)
        self._waiting: list[Task] = []

    def submit(self, tasks: Sequence[Task]) -> None:
        self._waiting += tasks
        self.at_once.append(len(self._waiting))

    def finished(self, timeout: float) -> list[tuple[Task, Outcome | None]]:
        self._random.shuffle(self._waiting)
        count = self._random.randint(1, len(self._waiting)) if self._waiting else 0
        done, self._waiting = self._waiting[:count], self._waiting[count:]
        found = []
        for task in done:
            found.append((task, self._judge(task, self.tried.count(task.source))))
            self.tried.append(task.source)
        return found

    def call_back(self) -> None:
        pass

    def close(self) -> None:
        pass


def good(task: Task, tried: int = 0) -> Outcome:
    """What a child would say, by the log's content."""
    text = Path(task.source).read_text()
    if text.startswith("bad"):
        return Outcome(text.split()[1], f"{task.source}: bad", cost=Cost(1.0))
    drive = {"start": 1.7e9 + len(text), "duration_s": 1.5, "state": "fine", "causes": "[]"}
    events = [{"t_s": 1.0, "kind": "state", "text": "fine"}]
    return Outcome(
        "ok", log_key=f"key-{text}", drive=drive, events=events, cost=Cost(0.5, 0.4, 7, "w")
    )


def make_logs(folder: Path, texts: Sequence[str]) -> Path:
    for i, text in enumerate(texts):
        place = folder / "logs" / f"car-{i % 3}" / f"{i:03}.log"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
    return fleet_file(folder)


@pytest.fixture
def fleet(tmp_path: Path) -> Fleet:
    texts = ["x" * (i + 1) for i in range(8)] + ["bad unreadable", "xxx"]  # the last one twice
    return load_fleet(make_logs(tmp_path, texts))


def go(
    fleet: Fleet, out: Path | str, judge: Judge = good, seed: int = 0, **options: object
) -> tuple[FakeWorkers, Plan, FleetRun]:
    store, workers = Store(str(out)), FakeWorkers(judge, seed)
    with Lease(store) as lease:
        plan = planned(fleet, store, list_logs(fleet), Options(**options))  # type: ignore[arg-type]
        run = FleetRun(fleet, store, workers, plan)
        run.go(lease)
    return workers, plan, run


def test_any_order_gives_the_same_bytes(tmp_path: Path, fleet: Fleet) -> None:
    found = []
    for seed in range(6):
        go(fleet, tmp_path / f"out{seed}", seed=seed)
        found.append(tables_of(tmp_path / f"out{seed}"))
    assert all(one == found[0] for one in found)
    drives = pq.read_table(tmp_path / "out0" / "drives").to_pylist()
    assert [
        d["log_key"] for d in drives if len(d["sources"]) > 100 or "009.log" in d["sources"]
    ] == ["key-xxx"], "the drive that is there twice is one row with both addresses"
    assert len(drives) == 8


def test_a_second_run_does_nothing_and_changes_nothing(tmp_path: Path, fleet: Fleet) -> None:
    go(fleet, tmp_path / "out")
    before = tables_of(tmp_path / "out")
    workers, plan, _ = go(fleet, tmp_path / "out")
    assert workers.tried == []
    assert (plan.done, plan.failed_before) == (10, 1)
    assert tables_of(tmp_path / "out") == before


@pytest.mark.parametrize("limits", [(1, 2, 3), (4, 1), (9,)])
def test_piece_by_piece_is_the_same_as_at_once(
    tmp_path: Path, fleet: Fleet, limits: tuple[int, ...]
) -> None:
    go(fleet, tmp_path / "whole")
    for limit in (*limits, None):
        go(fleet, tmp_path / "pieces", limit=limit)
    assert tables_of(tmp_path / "pieces") == tables_of(tmp_path / "whole")


def test_a_replaced_or_late_log_costs_one_log(tmp_path: Path, fleet: Fleet) -> None:
    go(fleet, tmp_path / "out")
    replaced = tmp_path / "logs" / "car-0" / "000.log"
    replaced.write_text("y" * 50)
    workers, _, _ = go(fleet, tmp_path / "out")
    assert workers.tried == [str(replaced)]
    late = tmp_path / "logs" / "car-9" / "1.log"
    late.parent.mkdir()
    late.write_text("z" * 60)
    workers, _, _ = go(fleet, tmp_path / "out")
    assert workers.tried == [str(late)]
    go(fleet, tmp_path / "fresh")
    assert tables_of(tmp_path / "out") == tables_of(tmp_path / "fresh")


def test_a_killed_run_loses_a_tenth_of_its_time_and_at_most_a_minute(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fleet = load_fleet(make_logs(tmp_path, ["x" * (i + 1) for i in range(300)]))
    now, written = [0.0], [0.0]
    clock = SimpleNamespace(monotonic=lambda: now[0], time=time.time)
    monkeypatch.setattr(driver, "time", clock)

    class Steady(FakeWorkers):
        """A log takes 4 s."""

        def finished(self, timeout: float) -> list[tuple[Task, Outcome | None]]:
            now[0] += 4.0
            task = self._waiting.pop(0)
            return [(task, good(task))]

    def noted(store: Store, table: str, number: int, rows: Sequence[dict[str, object]]) -> None:
        written.append(now[0])
        write_part(store, table, number, rows)

    monkeypatch.setattr(driver, "write_part", noted)
    store = Store(str(tmp_path / "out"))
    with Lease(store) as lease:
        plan = planned(fleet, store, list_logs(fleet), Options())
        run = FleetRun(fleet, store, Steady(good), plan)
        run.counts.began = 0.0
        run.go(lease)
    lost = [(after - before, after) for before, after in itertools.pairwise(written)]
    assert now[0] == 1200.0
    assert all(gap <= 4.0 + min(60.0, 0.1 * t) for gap, t in lost)
    assert len(lost) < 5 * 50, "a long run writes no more than once a minute"


def test_drives_of_two_configurations_are_reported_where_they_are_read(
    tmp_path: Path, fleet: Fleet, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "out")
    go(fleet, out)
    for action in ("status", "analyse"):
        assert main(["fleet", action, "--out", out]) == 0
        assert "configurations" not in capsys.readouterr().out
    config = tmp_path / "car.yaml"
    config.write_text(CONFIG.read_text().replace("../../dbc", str(ROOT / "dbc")))
    (tmp_path / "fleet.yaml").write_text(f"logs: 'logs/**/*'\nconfig: {config}\n")
    (tmp_path / "logs" / "car-0" / "000.log").write_text("y" * 50)
    go(load_fleet(tmp_path / "fleet.yaml"), out)
    for action in ("status", "analyse"):
        assert main(["fleet", action, "--out", out]) == 0
        assert "unknown (7 and 1 drives)" in " ".join(capsys.readouterr().out.split())


def test_what_broke_off_in_the_middle_of_a_flush_does_no_harm(tmp_path: Path, fleet: Fleet) -> None:
    """Every prefix of the writes of a run, as a killed driver leaves it, then a resume."""
    go(fleet, tmp_path / "whole")
    for last in itertools.count():
        out = tmp_path / f"broken{last}"
        if not _broken_off(fleet, out, last):
            break
        go(fleet, out)
        assert tables_of(out) == tables_of(tmp_path / "whole"), last
    assert last > 10


def _broken_off(fleet: Fleet, out: Path, last: int) -> bool:
    """Run until write or delete number `last` is due; whether it came to that."""

    class KilledError(Exception):
        pass

    class Mortal(Store):
        left = last

        def _due(self) -> None:
            self.left -= 1
            if self.left < 0:
                raise KilledError

        def write(self, name: str, data: bytes) -> None:
            self._due()
            super().write(name, data)

        def remove(self, name: str) -> None:
            if name != NAME:
                self._due()
            super().remove(name)

    store = Mortal(str(out))
    with Lease(store) as lease:
        plan = planned(fleet, store, list_logs(fleet), Options())
        try:
            FleetRun(fleet, store, FakeWorkers(good, last), plan).go(lease)
        except KilledError:
            return True
    return False


def test_what_crashed_is_tried_again_alone(tmp_path: Path, fleet: Fleet) -> None:
    def once(task: Task, tried: int) -> Outcome | None:
        return Outcome("crashed", "x") if "003" in task.source and not tried else good(task)

    workers, _, run = go(fleet, tmp_path / "out", once)
    assert workers.tried[-1].endswith("003.log"), "after all others"
    assert workers.at_once[-1] == 1
    assert run.counts.failed == {"unreadable": 1}
    go(fleet, tmp_path / "calm")
    assert tables_of(tmp_path / "out") == tables_of(tmp_path / "calm")


def test_what_crashes_twice_is_poison_until_it_is_asked_for(tmp_path: Path, fleet: Fleet) -> None:
    def always(task: Task, tried: int) -> Outcome | None:
        return Outcome("crashed", "x", None, -11) if "003" in task.source else good(task)

    workers, _, _ = go(fleet, tmp_path / "out", always)
    assert sum("003" in source for source in workers.tried) == 2
    failures = pq.read_table(tmp_path / "out" / "failures").to_pylist()
    (row,) = [r for r in failures if r["kind"] == "crashed"]
    assert (row["attempts"], row["exit_code"]) == (2, -11)
    workers, _, _ = go(fleet, tmp_path / "out", always)
    assert workers.tried == []
    workers, _, _ = go(fleet, tmp_path / "out", redo="failed")
    assert sorted(Path(s).name for s in workers.tried) == ["003.log", "008.log"]
    assert "crashed" not in pq.read_table(tmp_path / "out" / "failures").column("kind").to_pylist()


def test_a_run_whose_first_logs_all_fail_the_same_stops(tmp_path: Path) -> None:
    fleet = load_fleet(make_logs(tmp_path, [f"bad no_frames {i}" for i in range(60)]))
    with pytest.raises(AllFailedError, match=f"first {SAMPLE} logs all failed: no_frames"):
        go(fleet, tmp_path / "out")
    failures = read_tables(Store(str(tmp_path / "out")), ("failures",))["failures"]
    assert len(failures) >= SAMPLE, "what is known is written"


def test_tasks_that_were_called_back_are_done_later(tmp_path: Path, fleet: Fleet) -> None:
    workers, _, _ = go(fleet, tmp_path / "out", lambda task, n: good(task) if n else None)
    assert len(workers.tried) == 20
    go(fleet, tmp_path / "whole")
    assert tables_of(tmp_path / "out") == tables_of(tmp_path / "whole")


def test_failures_of_several_kinds_stop_nothing(tmp_path: Path) -> None:
    kinds = ("no_frames", "unreadable")
    fleet = load_fleet(make_logs(tmp_path, [f"bad {kinds[i % 2]} {i}" for i in range(60)]))
    _, _, run = go(fleet, tmp_path / "out")
    assert run.counts.failed == {"no_frames": 30, "unreadable": 30}


def test_stopping_begins_nothing_more_and_can_go_on(tmp_path: Path, fleet: Fleet) -> None:
    store = Store(str(tmp_path / "out"))
    with Lease(store) as lease:
        plan = planned(fleet, store, list_logs(fleet), Options())
        workers = FakeWorkers(good, slots=1)
        run = FleetRun(fleet, store, workers, plan, lambda _: run.stop())
        assert not run.go(lease), "some are left"
    assert 0 < len(workers.tried) < 5
    go(fleet, tmp_path / "out")
    go(fleet, tmp_path / "whole")
    assert tables_of(tmp_path / "out") == tables_of(tmp_path / "whole")


def test_every_file_has_every_column_with_its_type_and_unit(tmp_path: Path, fleet: Fleet) -> None:
    go(fleet, tmp_path / "out")
    for name, columns in TABLES.items():
        schema = pq.read_schema(tmp_path / "out" / name / f"{name}.parquet")
        assert schema.names == [c.name for c in columns]
        assert not any(str(field.type) == "null" for field in schema)
        for column, field in zip(columns, schema, strict=True):
            assert field.metadata.get(b"unit", b"").decode() == column.unit
            suffixes = {"s": "_s", "deg": "_deg", "m": "_m", "Hz": "_hz", "deg^2": "_deg2"}
            assert column.name.endswith(suffixes.get(column.unit, "")), column
    drives = pq.read_table(tmp_path / "out" / "drives")
    assert set(drives.column("schema_version").to_pylist()) == {VERSION}


def test_a_second_run_into_the_same_folder_is_refused(tmp_path: Path, fleet: Fleet) -> None:
    store = Store(str(tmp_path / "out"))
    with Lease(store), pytest.raises(ImucaldError, match="another run is writing there"):
        go(fleet, tmp_path / "out")
    go(fleet, tmp_path / "out")


def test_the_lease_of_a_dead_run_is_taken_over(tmp_path: Path, fleet: Fleet) -> None:
    store = Store(str(tmp_path / "out"))
    lease = Lease(store)
    lease.__enter__()
    text = (tmp_path / "out" / NAME).read_text()
    dead = text.replace(f'"pid":{__import__("os").getpid()}', '"pid":4194999')
    assert dead != text
    (tmp_path / "out" / NAME).write_text(dead)
    go(fleet, tmp_path / "out")


def test_a_run_that_lost_its_lease_writes_no_more(tmp_path: Path, fleet: Fleet) -> None:
    store = Store(str(tmp_path / "out"))
    with Lease(store) as lease:
        (tmp_path / "out" / NAME).write_text("{}")
        lease._owner = __import__("msgspec").structs.replace(lease._owner, beat=0.0)
        with pytest.raises(ImucaldError, match="taken over this folder"):
            lease.beat()


def test_memory_storage_holds_the_same_tables(tmp_path: Path, fleet: Fleet) -> None:
    go(fleet, "memory://lake")
    go(fleet, tmp_path / "out")
    store = Store("memory://lake")
    for name, data in tables_of(tmp_path / "out").items():
        assert store.read(name) == data
    with Lease(store), pytest.raises(ImucaldError, match="another run"), Lease(store):
        pass


def test_vehicles_come_from_path_and_list(tmp_path: Path) -> None:
    make_logs(tmp_path, ["x", "xx", "xxx"])
    (tmp_path / "cars.csv").write_text(
        "vehicle,type,sensor_serial,sensor_batch,firmware,from,to\n"
        "car-0,van,s1,B1,1.0,2020-01-01,2023-11-13\n"
        "car-0,van,s2,B2,1.1,2023-11-14,\n"
        "car-1,coupe,s3,B1,1.0,,\n"
    )
    rule = r"path: 'logs/(?P<vehicle>[^/]+)/'"
    fleet = load_fleet(fleet_file(tmp_path, f"vehicles: cars.csv\n{rule}\n"))
    go(fleet, tmp_path / "out")
    rows = pq.read_table(tmp_path / "out" / "drives").to_pylist()
    facts = [(r["vehicle"], r["vehicle_type"], r["sensor_serial"], r["sensor_batch"]) for r in rows]
    assert facts == [
        ("car-0", "van", "s2", "B2"),  # 1.7e9 is 14 November 2023
        ("car-1", "coupe", "s3", "B1"),
        ("car-2", None, None, None),
    ]


def test_drives_of_a_logger_without_a_clock_are_in_the_order_of_their_addresses(
    tmp_path: Path,
) -> None:
    def no_clock(task: Task, tried: int) -> Outcome | None:
        outcome = good(task)
        assert outcome.drive is not None
        return Outcome("ok", log_key=outcome.log_key, drive=outcome.drive | {"start": None})

    fleet = load_fleet(make_logs(tmp_path, ["d", "x", "x", "cccc", "y", "y", "a", "z", "z"]))
    go(fleet, tmp_path / "out", no_clock)
    rows = pq.read_table(tmp_path / "out" / "drives").to_pylist()
    assert [r["log_key"] for r in rows if r["vehicle"] == "car-0"] == ["key-d", "key-cccc", "key-a"]
