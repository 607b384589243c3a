"""A socket of another program in the place of a daemon's status socket."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from imucald import cli
from imucald.commands import monitor, monitor_web
from imucald.commands.monitor_web import LiveState
from imucald.core.errors import LinkError
from imucald.feeds.daemon_source import DaemonSource
from imucald.service.asking import ask

BARE = b'{"state": "fine", "quality": 9, "mount": {}, "link": {}, "config": "x", "events": [{}]}'
ANSWERS = [BARE, b"{}", b"[]", b"null", b'{"link": {}}', b"[" * 100_000, b"\xff\xfe"]
ANSWERS += [b"HTTP/1.1 400\r\n"]


@pytest.fixture(params=ANSWERS, ids=lambda answer: repr(answer[:12]))
def path(request, tmp_path) -> Iterator[str]:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "other.sock"))
        server.listen()

        def serve() -> None:
            while True:
                try:
                    client, _ = server.accept()
                except OSError:
                    return
                with client:
                    client.recv(100)
                    client.sendall(request.param + b"\n")

        threading.Thread(target=serve, daemon=True).start()
        yield str(tmp_path / "other.sock")
        server.shutdown(socket.SHUT_RDWR)


@pytest.mark.parametrize("command", [["status"], ["status", "--json"], ["status", "--short"],
                                     ["events"], ["wait", "--timeout", "0.1"]])  # fmt: skip
def test_an_answer_of_another_program_is_one_line(path, command, capsys):
    assert cli.main([*command, "--socket", path]) not in (0, None)
    said = "".join(capsys.readouterr())
    assert "Traceback" not in said
    assert "imucald daemon" in said or command[0] == "wait"


def test_the_monitor_shows_nothing_of_another_program(path, tmp_path, monkeypatch):
    monkeypatch.setattr(monitor, "PERIOD_S", 0.0)
    rounds = iter((False, True))
    monitor.watch(Path(path), lambda: next(rounds), None)
    state = LiveState()
    asyncio.run(monitor_web._ask(Path(path), state))
    assert "imucald daemon" in state.page()["trouble"]


def test_an_answer_without_end_is_none(tmp_path):
    """Endless data, and a byte now and then."""
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "other.sock"))
        server.listen()

        def serve(part: bytes, pause: float) -> None:
            client, _ = server.accept()
            with client, contextlib.suppress(OSError):
                while True:
                    client.sendall(part)
                    time.sleep(pause)

        for part, pause, words in (
            (bytes(65536), 0.0, "not from an"),
            (b"x", 0.05, "did not answer"),
        ):
            threading.Thread(target=serve, args=(part, pause), daemon=True).start()
            with pytest.raises(LinkError, match=words):
                ask(tmp_path / "other.sock", "status", 0.5, is_repeatable=False)


def test_a_feed_waits_for_the_daemon(path):
    said: list[str] = []
    source = DaemonSource(path, said.append)
    assert source.read(0.01).status is None
    assert "not from an imucald daemon" in said[0]
