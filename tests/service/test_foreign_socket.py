"""A socket of another program in the place of a daemon's status socket."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator

import pytest

from imucald import cli
from imucald.feeds.daemon_source import DaemonSource

ANSWERS = [b"{}", b"[]", b"null", b'{"link": {}}', b"[" * 100_000, b"\xff\xfe", b"HTTP/1.1 400\r\n"]


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


def test_a_feed_waits_for_the_daemon(path):
    said: list[str] = []
    source = DaemonSource(path, said.append)
    assert source.read(0.01).status is None
    assert "not that of an imucald daemon" in said[0]
