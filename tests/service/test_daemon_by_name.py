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

from imucald.commands.status import find_socket
from imucald.core.errors import LinkError
from imucald.service.status import StatusServer
from paths import ROOT

CHANNEL = "239.74.163.2"


@pytest.fixture
def daemon_of_the_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[StatusServer]:
    """Its channel stands in the configuration: the socket's name does not have it."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    status = {"link": {"channel": CHANNEL}}
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
        [sys.executable, "-m", "imucald", "run", "--config", configuration, *bus],
        env=environment, stderr=subprocess.PIPE, text=True, timeout=60, check=True,
    )  # fmt: skip
    assert ("no status socket" in done.stderr) == (folder is None)
    assert ("--status-socket PATH" in done.stderr) == (folder is None)
    assert ("XDG_RUNTIME_DIR" in done.stderr) == (folder is None)
