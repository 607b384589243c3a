"""Whoever asks too much gets no answer; root and the daemon's user, and frames, are served."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from imucald.cli import main
from imucald.core.errors import LinkError
from imucald.service import line_server
from imucald.service.asking import BusyError, ask
from imucald.service.line_server import CLIENTS_MAX, CLIENTS_PER_USER, KEPT_FOR_OWNER, LineServer

ALICE, BOB, CAROL = 40001, 40002, 40003


class Desk:
    """A server whose next clients belong to `uid`."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.uid = ALICE
        self.open: list[socket.socket] = []
        monkeypatch.setattr(line_server, "_peer", lambda _: line_server.Peer(1, self.uid, 1))
        self.server = LineServer(folder / "status.sock", 0o666, lambda line, _: line + b"\n")

    def held(self, uid: int, count: int) -> None:
        """Connect so often as a user and say nothing."""
        self.uid = uid
        for _ in range(count):
            connection = socket.socket(socket.AF_UNIX)
            connection.connect(str(self.server.path))
            self.open.append(connection)
        self.server.poll()

    def is_answered(self, uid: int) -> bool:
        self.uid = uid
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(self.server.path))
            self.server.poll()
            try:
                connection.sendall(b"hello\n")
                self.server.poll()
                return connection.recv(100) == b"hello\n"
            except OSError:
                return False


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Desk]:
    made = Desk(tmp_path, monkeypatch)
    yield made
    made.server.close()
    for connection in made.open:
        connection.close()


def test_one_user_cannot_take_the_places_of_another(desk):
    desk.held(ALICE, 30)
    assert len(desk.server._clients) == CLIENTS_PER_USER
    assert not desk.is_answered(ALICE)
    assert desk.is_answered(BOB)


def test_root_and_the_daemons_user_have_places_that_nobody_else_gets(desk):
    for user in (ALICE, BOB, CAROL):
        desk.held(user, 30)
    assert len(desk.server._clients) == CLIENTS_MAX
    assert not desk.is_answered(CAROL)
    assert desk.is_answered(0)
    assert desk.is_answered(os.geteuid())
    desk.held(0, 30)
    assert len(desk.server._clients) == CLIENTS_MAX + KEPT_FOR_OWNER


@contextmanager
def listening(path: Path, backlog: int = 8) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))
        server.listen(backlog)
        yield server


def test_a_daemon_that_does_not_answer_is_busy_and_not_absent(tmp_path, capsys):
    path = tmp_path / "status.sock"
    with listening(path), pytest.raises(BusyError, match="daemon runs but did not answer"):
        ask(path, "status", 0.1)
    with pytest.raises(LinkError, match="Is the daemon running") as found:
        ask(path, "status", 0.1)
    assert not isinstance(found.value, BusyError)
    assert main(["status", "--socket", str(path)]) == 3
    assert "Is the daemon running" in capsys.readouterr().err


def test_a_full_queue_is_busy_too(tmp_path):
    path = tmp_path / "status.sock"
    with listening(path, 0), socket.socket(socket.AF_UNIX) as first:
        first.connect(str(path))
        with pytest.raises(BusyError):
            ask(path, "status", 0.1)


@contextmanager
def turned_away(path: Path, times: int) -> Iterator[list[bytes]]:
    """A server that closes so many connections at once, and answers the next."""
    asked: list[bytes] = []

    def serve() -> None:
        for number in range(times + 1):
            connection, _ = server.accept()
            with connection:
                if number == times:
                    asked.append(connection.recv(100))
                    connection.sendall(b'{"done": "yes"}\n')

    with listening(path) as server:
        thread = threading.Thread(target=serve)
        thread.start()
        yield asked
        server.close()
        thread.join()


def test_who_is_turned_away_asks_again(tmp_path):
    with turned_away(tmp_path / "s", 5) as asked:
        assert ask(tmp_path / "s", "status") == '{"done": "yes"}\n'
    assert asked == [b"status\n"]


def test_an_order_is_given_once_and_busy_has_an_exit_status_of_its_own(tmp_path, capsys):
    with turned_away(tmp_path / "control.sock", 1) as asked:
        order = ["reset", "--socket", str(tmp_path / "status.sock")]
        assert main(order) == 8
        assert asked == []
        assert main(order) == 0
    assert "the daemon runs but did not answer" in capsys.readouterr().err


def test_status_of_a_daemon_that_does_not_answer_has_an_exit_status_of_its_own(tmp_path, capsys):
    with listening(tmp_path / "s"):
        assert main(["status", "--socket", str(tmp_path / "s")]) == 8
    assert "did not answer" in capsys.readouterr().err
