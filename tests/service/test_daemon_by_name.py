"""A daemon that was started by hand: where its socket is, and by which names it is found."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from imucald.commands.status import FAULT, NOT_YET, find_socket
from imucald.core.errors import LinkError
from imucald.service.asking import NotRunningError
from imucald.service.status import StatusServer
from paths import ROOT

AS_USER = (
    "import os, sys; os.geteuid = lambda: 1000; from imucald.cli import main; sys.exit(main())"
)
AS_ROOT = """
import os, pathlib, sys
import imucald.service.asking

os.geteuid = lambda: 0
imucald.service.asking.RUNNING = pathlib.Path(sys.argv.pop(1))
from imucald.cli import main
sys.exit(main())
"""
CHANNEL = "239.74.163.2"


@pytest.fixture
def daemon_of_the_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[StatusServer]:
    """Its channel stands in the configuration: the socket's name does not have it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    status = {
        "state": "fine",
        "quality": 3,
        "mount": {},
        "link": {"channel": CHANNEL},
        "config": "",
    }
    server = StatusServer(tmp_path / "imucald-bus.sock", lambda: status)
    ended = threading.Event()

    def serve() -> None:
        while not ended.is_set():
            server.poll()
            time.sleep(0.005)

    thread = threading.Thread(target=serve)
    thread.start()
    yield server
    ended.set()
    thread.join()
    server.close()


def test_a_daemon_is_found_by_the_channel_that_its_status_shows(daemon_of_the_configuration):
    assert find_socket(None, CHANNEL) == daemon_of_the_configuration.path
    with pytest.raises(LinkError, match="no running daemon found for can0; start one"):
        find_socket(None, "can0")


def test_the_socket_of_a_killed_daemon_is_none_of_a_channel(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    (tmp_path / "imucald-bus.sock").touch()
    with pytest.raises(LinkError, match="no running daemon found"):
        find_socket(None, CHANNEL)


@pytest.mark.parametrize("folder", [None, "here"])
def test_a_daemon_without_a_status_socket_reports_it_with_the_remedy(folder, tmp_path):
    environment = {k: v for k, v in os.environ.items() if k != "RUNTIME_DIRECTORY"}
    environment.pop("XDG_RUNTIME_DIR", None)
    if folder is not None:
        environment["XDG_RUNTIME_DIR"] = str(tmp_path)
    configuration = str(ROOT / "config" / "imucald.yaml")
    bus = ["--interface", "virtual", "--channel", "by-name", "--seconds", "0.01"]
    done = subprocess.run(
        [sys.executable, "-c", AS_USER, "run", "--config", configuration, *bus],
        env=environment, stderr=subprocess.PIPE, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert ("no status socket" in done.stderr) == (folder is None)
    assert ("--status-socket PATH" in done.stderr) == (folder is None)
    assert ("XDG_RUNTIME_DIR" in done.stderr) == (folder is None)


@pytest.mark.parametrize("named", ["--state-dir", "STATE_DIRECTORY", None])
def test_a_daemon_that_saves_nothing_says_so_with_the_remedy(named, tmp_path):
    environment = {k: v for k, v in os.environ.items() if k != "STATE_DIRECTORY"}
    bus = ["--interface", "virtual", "--channel", "by-name", "--seconds", "0.01"]
    configuration = str(ROOT / "config" / "imucald.yaml")
    folder = ["--state-dir", str(tmp_path)] if named == "--state-dir" else []
    if named == "STATE_DIRECTORY":
        environment[named] = str(tmp_path)
    done = subprocess.run(
        [sys.executable, "-m", "imucald", "run", "--config", configuration, *bus, *folder],
        env=environment, stderr=subprocess.PIPE, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert ("the mount is not saved" in done.stderr) == (named is None)
    assert ("--state-dir DIR" in done.stderr) == (named is None)


@pytest.mark.parametrize("channel", [[], ["--channel", "by-root"]])
def test_root_needs_no_folder_for_run_and_status_to_find_each_other(channel, tmp_path):
    environment = {
        k: v for k, v in os.environ.items() if k not in ("RUNTIME_DIRECTORY", "XDG_RUNTIME_DIR")
    }
    command = [sys.executable, "-c", AS_ROOT, str(tmp_path)]
    configuration = str(ROOT / "config" / "imucald.yaml")
    bus = ["--interface", "virtual", *channel]
    daemon = subprocess.Popen(
        [*command, "run", "--config", configuration, *bus],
        env=environment, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        answer, end = NotRunningError.exit_status, time.monotonic() + 30.0
        while answer == NotRunningError.exit_status and time.monotonic() < end:
            asked = [*command, "status", "--quiet"]
            answer = subprocess.run(
                asked, env=environment, stderr=subprocess.DEVNULL, check=False
            ).returncode
        assert answer in (NOT_YET, FAULT), "it starts, or has no sensor"
        control = list(tmp_path.glob("*/control.sock"))
        assert len(control) == 1, "orders find it, too"
    finally:
        daemon.terminate()
        output = daemon.communicate()[1]
    assert "no status socket" not in output
