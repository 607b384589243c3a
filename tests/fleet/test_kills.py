"""Driver and workers killed at any time: after a resume the tables are those of a calm run."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from cluster import Cluster, tls_files
from fleet_files import (
    HERE,
    environment,
    make_fleet,
    on_a_terminal,
    read_until,
    tables_of,
    whole_log,
)

from imucald.fleet.dask_workers import SCHEDULER_GONE

KILLS = 20
LOGS = 24


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Good logs, and one of each kind of poison that ends for itself."""
    folder = tmp_path_factory.mktemp("fleet")
    path = make_fleet(folder, whole_log(folder / "whole.log"), LOGS)
    (folder / "logs" / "car-0" / "crash.log").write_text("POISON segfault\n")
    (folder / "logs" / "car-1" / "large.log").write_text("POISON allocate\n")
    (folder / "logs" / "car-2" / "empty.log").write_text("")
    os.mkfifo(folder / "logs" / "car-2" / "pipe.log")
    return path


@pytest.fixture(scope="module")
def calm(fleet: Path) -> dict[str, bytes]:
    """The tables of an undisturbed run on this machine."""
    out = fleet.parent / "calm"
    finish(fleet, out)
    kinds = sorted(pq.read_table(out / "failures").column("kind").to_pylist())
    assert kinds == ["crashed", "memory", "no_frames", "unreadable"]
    assert pq.read_table(out / "drives").num_rows == LOGS
    return tables_of(out)


def start(fleet: Path, out: Path, *cluster: str) -> subprocess.Popen[str]:
    command = [sys.executable, str(HERE / "fleet_driver.py"), str(fleet), str(out), *cluster]
    return subprocess.Popen(command, env=environment(), stdout=subprocess.PIPE, text=True)


def finish(fleet: Path, out: Path, *cluster: str) -> None:
    driver = start(fleet, out, *cluster)
    driver.communicate(timeout=240)
    assert driver.returncode == 0


@pytest.mark.slow
def test_a_driver_killed_at_random_times_goes_on_where_it_was(
    fleet: Path, calm: dict[str, bytes], tmp_path: Path
) -> None:
    chance = random.Random(18)
    killed = 0
    began = time.monotonic()
    finish(fleet, tmp_path / "undisturbed")
    longest = time.monotonic() - began  # of this machine, with an interpreter's start
    for k in range(KILLS):
        out = tmp_path / f"out{k // 2}"  # killed twice before they are finished
        driver = start(fleet, out)
        assert driver.stdout is not None
        assert driver.stdout.readline().strip() == "leased", "a dead run's lease is taken over"
        time.sleep(chance.uniform(0.05, 0.5 * longest))
        if driver.poll() is None:
            driver.send_signal(signal.SIGKILL)
            killed += 1
        driver.wait()
        driver.stdout.close()
    assert killed > KILLS / 2
    for k in range(KILLS // 2):
        finish(fleet, tmp_path / f"out{k}")
        assert tables_of(tmp_path / f"out{k}") == calm


@pytest.mark.slow
def test_two_runs_into_one_folder_at_once(
    fleet: Path, calm: dict[str, bytes], tmp_path: Path
) -> None:
    first = start(fleet, tmp_path / "out")
    assert first.stdout is not None
    assert first.stdout.readline().strip() == "leased"
    second = subprocess.run(
        [sys.executable, str(HERE / "fleet_driver.py"), str(fleet), str(tmp_path / "out")],
        env=environment(), capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert second.returncode != 0
    assert "another run is writing there" in second.stderr
    first.communicate(timeout=120)
    assert first.returncode == 0
    assert tables_of(tmp_path / "out") == calm


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Scheduler and two workers as processes of their own, over TLS."""
    folder = tmp_path_factory.mktemp("cluster")
    with Cluster(folder, tls_files(folder)) as found:
        yield found


@pytest.mark.slow
def test_a_cluster_over_tls_gives_the_same_tables(
    fleet: Path, calm: dict[str, bytes], cluster: Cluster, tmp_path: Path
) -> None:
    assert cluster.address.startswith("tls://")
    finish(fleet, tmp_path / "out", cluster.address, *cluster.tls)
    assert tables_of(tmp_path / "out") == calm
    hosts = pq.read_table(tmp_path / "out" / "costs").column("worker").to_pylist()
    assert all(hosts)


@pytest.mark.slow
def test_workers_killed_at_random_times_cost_time_only(
    fleet: Path, calm: dict[str, bytes], cluster: Cluster, tmp_path: Path
) -> None:
    chance = random.Random(19)
    killed, k = 0, 0
    while killed < KILLS:
        out = tmp_path / f"out{k // 2}"  # killed twice before they are finished
        driver = start(fleet, out, cluster.address, *cluster.tls)
        while driver.poll() is None and killed < KILLS:
            time.sleep(chance.uniform(0.5, 2.5))
            if driver.poll() is None:
                cluster.kill_a_worker(chance)
                killed += 1
        driver.communicate(timeout=240)
        assert driver.returncode == 0
        assert tables_of(out) == calm
        k += 1


@pytest.mark.slow
def test_a_scheduler_that_dies_ends_the_run_which_goes_on_anywhere(
    fleet: Path, calm: dict[str, bytes], tmp_path: Path
) -> None:
    with Cluster(tmp_path, tls_files(tmp_path)) as short_lived:
        driver = start(fleet, tmp_path / "out", short_lived.address, *short_lived.tls)
        assert driver.stdout is not None
        assert [driver.stdout.readline().strip() for _ in range(2)] == ["leased", "evaluated"]
        short_lived.kill_the_scheduler()
        driver.communicate(timeout=240)
    assert driver.returncode in (0, 1), "done before, or told"
    finish(fleet, tmp_path / "out")
    assert tables_of(tmp_path / "out") == calm


@pytest.mark.slow
def test_a_scheduler_that_dies_is_one_line_and_is_not_waited_for(tmp_path: Path) -> None:
    fleet = make_fleet(tmp_path, whole_log(tmp_path / "whole.log"), 100)
    with Cluster(tmp_path, tls_files(tmp_path)) as short_lived:
        ca, cert, key = short_lived.tls
        command = [sys.executable, "-m", "imucald", "fleet", "run", "--fleet", str(fleet)]
        command += ["--out", str(tmp_path / "out"), "--scheduler", short_lived.address]
        command += ["--tls-ca", ca, "--tls-cert", cert, "--tls-key", key]
        with on_a_terminal(command) as (driver, terminal):
            before = read_until(terminal, rb"[1-9]\d*/100 logs,")
            assert driver.poll() is None, "the run is over: this proves nothing"
            short_lived.kill_the_scheduler()
            began = time.monotonic()
            said = read_until(terminal, None)
            took = time.monotonic() - began
    lines = [line for line in said.splitlines() if line and "logs," not in line]
    assert "to evaluate" in before
    assert lines == [f"imucald: {SCHEDULER_GONE}"]
    assert driver.returncode == 1
    assert took < 10.0


@pytest.mark.slow
def test_a_scheduler_is_not_talked_to_without_its_certificates(
    fleet: Path, cluster: Cluster, tmp_path: Path
) -> None:
    others = tls_files(tmp_path)
    driver = start(fleet, tmp_path / "out", cluster.address, *others)
    driver.communicate(timeout=120)
    assert driver.returncode != 0
    assert not (tmp_path / "out" / "drives").exists()
