"""Each log ends as a row, whatever it does to its process; nobody else is blamed or harmed."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import can
import msgspec
import pytest
from fleet_files import CONFIG, children_find_poison, environment, whole_log
from poison import FUNCTION

from imucald.can.python_can import with_mf4
from imucald.fleet.bundle import bundle_of, unpack
from imucald.fleet.task import LogLimits, Outcome, Task
from imucald.fleet.template_client import Template
from imucald.fleet.workers import run_one_log

__all__ = ["children_find_poison"]
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("children_find_poison")]

LIMITS = LogLimits(memory_bytes=512 * 2**20, time_s=1.5)


@pytest.fixture(scope="module")
def bundle() -> str:
    found = bundle_of(CONFIG)
    unpack({found.name: found})
    return found.name


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return whole_log(tmp_path_factory.mktemp("log") / "whole.log", 1.0)


def run(path: Path, bundle: str, limits: LogLimits = LIMITS) -> Outcome:
    return run_one_log(Task(str(path), bundle, limits=limits, function=FUNCTION))


def poisoned(folder: Path, act: str) -> Path:
    path = folder / f"{act.replace(' ', '-')}.log"
    path.write_text(f"POISON {act}\n")
    return path


@pytest.mark.parametrize(
    ("act", "kind", "exit_code"),
    [
        ("segfault", "crashed", -11),
        ("abort", "crashed", -6),
        ("exit", "crashed", 7),
        ("killed", "memory", -9),
        ("allocate", "memory", None),
        ("loop", "timeout", None),
        ("raise", "bug", None),
    ],
)
def test_whatever_a_log_does_its_end_is_an_outcome(
    tmp_path: Path, bundle: str, act: str, kind: str, exit_code: int | None
) -> None:
    began = time.monotonic()
    outcome = run(poisoned(tmp_path, act), bundle)
    assert (outcome.kind, outcome.exit_code) == (kind, exit_code), outcome
    assert outcome.drive is None
    assert time.monotonic() - began < LIMITS.time_s + 20.0


def test_the_reason_of_a_crash_is_reported_and_the_same_each_time(
    tmp_path: Path, bundle: str
) -> None:
    first, second = (run(poisoned(tmp_path, "segfault"), bundle) for _ in range(2))
    assert "SIGSEGV" in first.message
    assert "_act" in first.traceback, "faulthandler tells the Python function"
    assert (first.message, first.traceback) == (second.message, second.traceback)


def test_an_error_that_nobody_foresaw_is_a_bug_with_its_traceback(
    tmp_path: Path, bundle: str
) -> None:
    outcome = run(poisoned(tmp_path, "raise"), bundle)
    assert "ValueError: not foreseen" in outcome.message
    assert "poison.py" in outcome.traceback


@pytest.mark.parametrize("act", ["killed", "fill and loop"])
def test_a_killed_log_leaves_no_temporary_file(
    tmp_path: Path, bundle: str, act: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    template = Template(FUNCTION)
    outcome = template.run(
        Task(str(poisoned(tmp_path, act)), bundle, limits=LIMITS, function=FUNCTION)
    )
    template.close()
    assert outcome.kind in ("memory", "timeout")
    assert list(temporary.iterdir()) == []


def test_a_worker_process_removes_its_configurations_when_it_ends(
    tmp_path: Path, bundle: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with ProcessPoolExecutor(1, get_context("forkserver")) as pool:
        pool.submit(unpack, {bundle: bundle_of(CONFIG)}).result()
        left = [path.name for path in (tmp_path / "temporary").glob("imucald-*")]
        assert len(left) == 1, "the worker holds its configurations"
    assert list((tmp_path / "temporary").glob("imucald-*")) == []


def test_good_logs_beside_poison_are_not_harmed(tmp_path: Path, bundle: str, log: Path) -> None:
    acts = ("segfault", "allocate", "loop", "killed")
    paths = [log, *(poisoned(tmp_path, act) for act in acts), log, log]
    with ThreadPoolExecutor(4) as pool:
        outcomes = list(pool.map(lambda p: run(p, bundle, LogLimits(2**29, 3.0)), paths))
    kinds = [outcome.kind for outcome in outcomes]
    assert kinds == ["ok", "crashed", "memory", "timeout", "memory", "ok", "ok"]
    assert outcomes[0].drive == outcomes[5].drive == outcomes[6].drive
    assert outcomes[0].log_key == outcomes[5].log_key is not None


def test_a_pipe_is_not_waited_for(tmp_path: Path, bundle: str) -> None:
    path = tmp_path / "pipe.log"
    os.mkfifo(path)
    outcome = run(path, bundle, LogLimits(time_s=30.0))
    assert outcome.kind == "unreadable"
    assert "not a regular file" in outcome.message


def test_a_cut_mf4_is_unreadable(tmp_path: Path, bundle: str) -> None:
    pytest.importorskip("asammdf")
    with_mf4()  # python-can may have been loaded without asammdf before
    from can.io.mf4 import MF4Writer

    path = tmp_path / "whole.mf4"
    with MF4Writer(path) as writer:
        for i in range(200):
            message = can.Message(
                timestamp=1e9 + i, arbitration_id=0x100, data=bytes(8), is_rx=True
            )
            writer.on_message_received(message)
    assert run(path, bundle, LogLimits(time_s=60.0)).kind == "no_frames", (
        "it is a log, of another bus"
    )
    cut = tmp_path / "cut.mf4"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 3])
    outcome = run(cut, bundle, LogLimits(time_s=60.0))
    assert outcome.kind == "unreadable", outcome
    assert str(cut) in outcome.message


def test_a_log_that_is_gone_is_storage(tmp_path: Path, bundle: str) -> None:
    assert run(tmp_path / "gone.log", bundle).kind == "bug", "poison itself looks first"
    task = Task(str(tmp_path / "gone.log"), bundle)
    outcome = run_one_log(task)
    assert outcome.kind == "storage"
    assert "No such file" in outcome.message


def test_children_end_with_their_worker(tmp_path: Path, bundle: str) -> None:
    """A worker that is killed leaves nothing behind that eats a core."""
    log = poisoned(tmp_path, "loop")
    code = (
        "from imucald.fleet.task import LogLimits, Task\n"
        "from imucald.fleet.workers import run_one_log\n"
        f"limits = LogLimits(time_s=300.0)\n"
        f"run_one_log(Task({str(log)!r}, '-', limits=limits, function={FUNCTION!r}))"
    )
    worker = subprocess.Popen([sys.executable, "-c", code], env=environment())
    pid_file = log.with_suffix(".pid")
    try:
        pid = int(_when(lambda: pid_file.read_text() if pid_file.exists() else ""))
        assert _lives(pid)
    finally:
        worker.kill()
        worker.wait()
    assert _when(lambda: "gone" if not _lives(pid) else "") == "gone"


def _when(found: object, within: float = 30.0) -> str:
    until = time.monotonic() + within
    while time.monotonic() < until:
        text = found()  # type: ignore[operator]
        if text:
            return str(text)
        time.sleep(0.05)
    raise AssertionError(f"not within {within} s")


def _lives(pid: int) -> bool:
    try:
        state = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def test_a_template_that_was_killed_is_started_anew(tmp_path: Path, bundle: str, log: Path) -> None:
    template = Template(FUNCTION)
    task = Task(str(log), bundle, limits=LogLimits(time_s=20.0), function=FUNCTION)
    try:
        assert template.run(task).kind == "ok"
        assert template._process is not None
        template._process.kill()
        template._process.wait()
        assert template.run(task).kind == "ok"
    finally:
        template.close()


def test_outcomes_survive_the_way_between_processes() -> None:
    outcome = Outcome("ok", drive={"a": 1.5, "b": None}, events=[{"t_s": 0.0}])
    assert msgspec.json.decode(msgspec.json.encode(outcome), type=Outcome) == outcome
