"""Runs the tests of this folder on real vcan interfaces, wherever pytest itself was started.

Outside, the tests are collected like any others, but each one's outcome comes from an inner
pytest process on a kernel with CAN (see can_kernel.py), report by report: an inner failure shows
here with its own trace and output. The inner process starts as soon as the collection is known
and runs beside the other tests, which is why these come last. Inside, the tests simply run.

A test takes the fixture `vcan` (a fresh interface) or `make_vcan` (as many as it likes).
"""

from __future__ import annotations

import fcntl
import itertools
import json
import os
import socket
import struct
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from can_kernel import (
    REPORTS_VARIABLE,
    REQUIRE_VARIABLE,
    Ground,
    InnerRun,
    find_ground,
    start_inner_pytest,
)

HERE = Path(__file__).parent
INSIDE = REPORTS_VARIABLE in os.environ
POLL_S = 0.1
SILENCE_LIMIT_S = 240  # no report for so long: the inner run hangs
CORES_PER_MACHINE = 1  # much of what runs inside waits for time to pass

RUN_KEY = pytest.StashKey["OuterRun"]()


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "vcan: needs a kernel with CAN; runs on a real vcan")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    ours = [item for item in items if HERE in item.path.parents]
    for item in ours:
        item.add_marker("vcan")
    items.sort(key=lambda item: HERE in item.path.parents)  # stable: the others keep their order


if INSIDE:

    def pytest_runtest_logreport(report: pytest.TestReport) -> None:
        """Hand the report out; forced to the disk, as the kernel inside may be gone any time."""
        content = report._to_json()
        with Path(os.environ[REPORTS_VARIABLE]).open("a") as file:
            file.write(json.dumps(content, default=str) + "\n")
            file.flush()
            os.fsync(file.fileno())

else:

    def pytest_collection_finish(session: pytest.Session) -> None:
        ours = [item for item in session.items if HERE in item.path.parents]
        if ours and not session.config.option.collectonly:
            session.config.stash[RUN_KEY] = OuterRun(session.config, ours)

    def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
        """Report what the inner run reported for this test, instead of running it here."""
        if HERE not in item.path.parents:
            return None  # pytest asks us for every test, whatever its folder
        run = item.config.stash[RUN_KEY]
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in run.reports_of(item):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
        run = session.config.stash.get(RUN_KEY, None)
        if run is not None:
            stopped = session.shouldstop or session.shouldfail
            run.finish(at_once=bool(stopped) or exitstatus == pytest.ExitCode.INTERRUPTED)


class OuterRun:
    """The inner runs as one worker sees them: it started them, or another worker did."""

    def __init__(self, config: pytest.Config, items: list[pytest.Item]) -> None:
        self._ground = find_ground()
        self._runs: list[InnerRun] = []
        self._folders: dict[str, Path] = {}
        self._told: dict[str, list[dict[str, Any]]] = {}
        self._read: dict[Path, int] = {}
        if isinstance(self._ground, str):
            return
        base = _folder_of_all_workers(config) / "vcan"
        batches = _batches([item.nodeid for item in items])
        self._folders = {
            nodeid: base / f"machine{number}"
            for number, batch in enumerate(batches)
            for nodeid in batch
        }
        self._start(self._ground, config.rootpath, base, batches)

    def _start(self, ground: Ground, root: Path, base: Path, batches: list[list[str]]) -> None:
        try:
            base.mkdir(parents=True)  # the first worker to get here starts them
        except FileExistsError:
            return
        for number, batch in enumerate(batches):
            self._runs.append(start_inner_pytest(ground, root, base / f"machine{number}", batch))
            (base / f"machine{number}" / "pid").write_text(str(self._runs[-1].process.pid))

    def reports_of(self, item: pytest.Item) -> list[pytest.TestReport]:
        """Wait for what the inner run says of this test; silence is a failure."""
        if isinstance(self._ground, str):
            required = os.environ.get(REQUIRE_VARIABLE) == "1"
            return [_own_report(item, "failed" if required else "skipped", self._ground)]
        folder = self._folders[item.nodeid]
        last_news = time.monotonic()
        while True:
            over = _is_over(folder)  # asked before reading: what is written by then is read
            if self._read_news(folder):
                last_news = time.monotonic()
            told = self._told.get(item.nodeid, [])
            if told and told[-1]["when"] == "teardown":
                return [_report_from(content) for content in told]
            if over or time.monotonic() - last_news > SILENCE_LIMIT_S:
                how = "ended" if over else "is silent"
                reason = f"the inner run on {self._ground.name} {how} without a result of this test"
                return [_own_report(item, "failed", f"{reason}\n{_console_end(folder)}")]
            time.sleep(POLL_S)

    def _read_news(self, folder: Path) -> bool:
        """Take in the whole lines added to the file of reports; whether there were any."""
        start = self._read.get(folder, 0)
        try:
            with (folder / "reports.jsonl").open("rb") as file:
                file.seek(start)
                news = file.read()
        except FileNotFoundError:
            return False
        whole = news[: news.rfind(b"\n") + 1]
        for line in whole.splitlines():
            content = json.loads(line)
            self._told.setdefault(content["nodeid"], []).append(content)
        self._read[folder] = start + len(whole)
        return bool(whole)

    def finish(self, at_once: bool) -> None:
        """End what this worker started, when all of it has been told: others may still read."""
        for run in self._runs:
            if not at_once:
                run.process.wait(SILENCE_LIMIT_S)
            run.process.end()


def _folder_of_all_workers(config: pytest.Config) -> Path:
    """Return a folder of this test run that every worker of it knows."""
    own: Path = config._tmp_path_factory.getbasetemp()  # type: ignore[attr-defined]
    return own.parent if hasattr(config, "workerinput") else own


def _batches(ids: list[str]) -> list[list[str]]:
    """Share the test files among as many machines as there are cores for, whole files each."""
    files = {
        name: list(group) for name, group in itertools.groupby(ids, lambda i: i.split("::")[0])
    }
    count = max(1, min(len(files), (os.cpu_count() or 1) // CORES_PER_MACHINE))
    batches: list[list[str]] = [[] for _ in range(count)]
    for group in sorted(files.values(), key=len, reverse=True):
        min(batches, key=len).extend(group)
    return batches


def _is_over(folder: Path) -> bool:
    """Whether the inner run is no more: it said so, or its process has gone."""
    if (folder / "status").exists():
        return True
    try:
        pid = int((folder / "pid").read_text())
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return (folder / "pid").exists()
    except ValueError:  # the file is being written
        return False


def _console_end(folder: Path) -> str:
    """Return the last lines of what the inner run printed."""
    try:
        text = (folder / "console.txt").read_text(errors="replace")
    except OSError:
        return "(it printed nothing)"
    return "\n".join(text.splitlines()[-40:])


def _report_from(content: dict[str, Any]) -> pytest.TestReport:
    if isinstance(content["longrepr"], list):  # a skip's (path, line, reason); JSON has no tuples
        content["longrepr"] = tuple(content["longrepr"])
    return pytest.TestReport._from_json(content)


def _own_report(item: pytest.Item, outcome: Any, reason: str) -> pytest.TestReport:
    path, line, _ = item.location
    longrepr: Any = (path, line or 0, f"Skipped: {reason}") if outcome == "skipped" else reason
    return pytest.TestReport(
        item.nodeid, item.location, {item.name: 1, "vcan": 1}, outcome, longrepr, "call"
    )


# ---- what the tests use, inside ---------------------------------------------------------------


SIOCSIFFLAGS = 0x8914
IFF_UP = 1


class Vcan:
    """A vcan interface with the verbs of `ip link`."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.create()

    def create(self) -> None:
        """Add the interface and set it up."""
        _ip(f"link add dev {self.name} mtu 72 type vcan", f"link set up dev {self.name}")

    def up(self) -> None:
        """Set it up."""
        self._set_flags(IFF_UP)

    def down(self) -> None:
        """Set it down: open sockets learn of it once, then hear nothing."""
        self._set_flags(0)

    def _set_flags(self, flags: int) -> None:
        """What `ip link set` does, without the time that another program takes to start."""
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as any_socket:
            fcntl.ioctl(any_socket, SIOCSIFFLAGS, struct.pack("16sH14x", self.name.encode(), flags))

    def delete(self) -> None:
        """Take it away: sockets bound to it stay silent for ever."""
        _ip(f"link del dev {self.name}")

    def send(self, frame: str) -> None:
        """Send one frame by cansend, another program on the same bus (`123#0011`)."""
        subprocess.run(["cansend", self.name, frame], check=True, capture_output=True)


def _ip(*commands: str) -> None:
    subprocess.run(
        ["ip", "-batch", "-"], input="\n".join(commands), text=True, check=True, capture_output=True
    )


_numbers = itertools.count()


@pytest.fixture
def make_vcan() -> Iterator[Callable[[], Vcan]]:
    """A function that makes a fresh vcan interface, up; all are taken away after the test."""
    made: list[Vcan] = []

    def make() -> Vcan:
        made.append(Vcan(f"vcan{next(_numbers)}"))
        return made[-1]

    yield make
    for interface in made:
        subprocess.run(
            ["ip", "link", "del", "dev", interface.name], capture_output=True, check=False
        )


@pytest.fixture
def vcan(make_vcan: Callable[[], Vcan]) -> Vcan:
    """A fresh vcan interface, up."""
    return make_vcan()
