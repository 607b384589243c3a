"""`imucald wait` on a status socket: what it returns, and when."""

from __future__ import annotations

import copy
import io
import json
import threading
import time
from pathlib import Path

import pytest

from imucald.cli import main
from imucald.service.journal import Journal
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service
from imucald.service.status import StatusServer
from simulated_bus import CONFIG


@pytest.fixture(scope="module")
def good():
    """The status of a daemon whose frames flow, marked usable."""
    options = ServiceOptions(config=CONFIG, interface="virtual", channel="wait-0")
    service = Service(options, Journal(io.StringIO()))
    try:
        found = json.loads(json.dumps(service.status()))
    finally:
        service.close()
    found |= {"state": "usable", "quality": 2, "silent_s": 0.0, "uptime_s": 100.0}
    found["link"] |= {"state": "up"}
    found["health"] = dict.fromkeys(found["health"], False)
    return found


class Answering:
    """A status socket that answers with `now`."""

    def __init__(self, path: Path, now: dict) -> None:
        self.now, self._ends = now, threading.Event()
        self._server = StatusServer(path, lambda: self.now)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._ends.is_set():
            self._server.poll()
            time.sleep(0.01)

    def close(self) -> None:
        self._ends.set()
        self._thread.join(5.0)
        self._server.close()


@pytest.fixture
def daemon(tmp_path, good):
    made = Answering(tmp_path / "s.sock", copy.deepcopy(good))
    yield made
    made.close()


def waited(tmp_path, *more: str) -> int:
    return main(["wait", "--socket", str(tmp_path / "s.sock"), *more])


def test_a_state_that_is_reached_ends_it_at_once(daemon, tmp_path, capsys):
    assert waited(tmp_path) == 0
    assert capsys.readouterr().out.startswith("corrected frames flow, marked usable")


def test_it_ends_when_the_state_comes(daemon, tmp_path, capsys):
    usable = daemon.now
    daemon.now = usable | {"state": "levelled", "quality": 0}
    threading.Timer(0.7, lambda: setattr(daemon, "now", usable)).start()
    assert waited(tmp_path, "--timeout", "20") == 0
    first, last = capsys.readouterr().out.splitlines()
    assert first.startswith("not yet: ")
    assert last.startswith("corrected frames flow")


def test_a_line_in_which_only_numbers_change_is_not_repeated_each_second(daemon, tmp_path, capsys):
    usable = daemon.now
    for k in range(4):
        text = {"roll": f"more turns ({k} left, 1 right seen)"}
        waits = usable | {"state": "levelled", "quality": 0, "waiting_for": text}
        threading.Timer(0.6 * k, lambda waits=waits: setattr(daemon, "now", waits)).start()
    threading.Timer(2.4, lambda: setattr(daemon, "now", usable)).start()
    daemon.now = usable | {"state": "levelled", "quality": 0}
    assert waited(tmp_path, "--timeout", "20") == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum("more turns" in line for line in lines) == 1


@pytest.mark.parametrize(
    ("state", "quality", "wanted", "status"),
    [
        ("usable", 2, "fine", 4),
        ("restored", 1, "usable", 4),
        ("levelled", 0, "usable", 5),
        ("suspect", 4, "usable", 6),
    ],
)
def test_after_the_timeout_the_exit_status_is_that_of_status(
    daemon, tmp_path, state, quality, wanted, status
):
    daemon.now = daemon.now | {"state": state, "quality": quality}
    assert waited(tmp_path, "--state", wanted, "--timeout", "0", "-q") == status


def test_the_help_says_that_a_restored_mount_ends_the_timeout_like_a_usable_one(capsys):
    with pytest.raises(SystemExit):
        main(["wait", "--help"])
    said = " ".join(capsys.readouterr().out.split())
    assert "0 the quality is reached; no other exit status means this" in said
    assert "4 usable or restored" in said


def test_a_known_mount_without_input_is_not_reached(daemon, tmp_path, capsys):
    silent = daemon.now["health"] | {"accelerometer_missing": True}
    daemon.now = daemon.now | {"health": silent, "silent_s": 25.0}
    assert waited(tmp_path, "--timeout", "0") == 7
    assert capsys.readouterr().out.startswith("NO INPUT for 25 s")


def test_a_daemon_that_does_not_run_yet_is_waited_for(tmp_path, good, capsys):
    begun = []
    threading.Timer(0.7, lambda: begun.append(Answering(tmp_path / "s.sock", good))).start()
    assert waited(tmp_path, "--timeout", "20") == 0
    begun[0].close()
    assert capsys.readouterr().out.splitlines()[0] == "no daemon runs"


def test_without_a_daemon_the_timeout_ends_it(tmp_path):
    assert waited(tmp_path, "--timeout", "0.1", "-q") == 3


@pytest.mark.parametrize("command", ["status", "monitor", "events", "wait"])
def test_without_a_daemon_all_that_ask_it_end_alike(command, tmp_path):
    more = ("--timeout", "0") if command == "wait" else ()
    assert main([command, "--socket", str(tmp_path / "none.sock"), *more]) == 3


def test_a_timeout_that_is_no_time_is_an_error(tmp_path, capsys):
    assert waited(tmp_path, "--timeout", "nan") == 1
    assert "--timeout" in capsys.readouterr().err
