"""A Unix socket server without threads, called by the main loop. A client sends one line and gets
one answer.

The loop never waits for a client, and its work is bounded: the number of clients, the bytes read
from each, and the time for each. Answers are small and fit the socket's buffer.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from imucald.core.errors import LinkError
from imucald.service.background_writer import Say
from imucald.service.journal import WARNING

CLIENTS_MAX = 8
"""Largest number of clients at the same time; further clients are refused."""
CLIENTS_PER_USER = 4
"""Largest number of clients of one user, so that one user cannot take all places."""
KEPT_FOR_OWNER = 4
"""Number of additional clients that are reserved for root and the daemon's own user."""
ROOT = 0
BACKLOG = 128
"""Largest number of clients that wait until the loop accepts them, in one turn."""
CLIENT_S = 1.0
"""Longest time in which a client must send its request and read the answer [s]."""
REQUEST_MAX = 4096
"""Longest request [bytes]."""
_CREDENTIALS = struct.Struct("3i")


def nobody_listens(_text: str, _priority: int) -> None:
    """Ignore a log line. This function is the argument `say` of a server whose errors are not
    logged."""


class Peer(NamedTuple):
    """Process, user and group of a client, as stated by the kernel."""

    pid: int
    uid: int
    gid: int


class _Client:
    def __init__(self, connection: socket.socket, peer: Peer, end: float) -> None:
        self.connection = connection
        self.peer = peer
        self.end = end
        self.request = b""
        self.answer: bytes | None = None


class LineServer:
    """Answers requests on a Unix socket. `poll` serves the clients without waiting.

    mode: permissions of the socket file. answer: function that returns the answer to a client's
    line. If this function raises an error, the client gets no answer, and each kind of error is
    logged once with `say` (a function that takes a log line). Raises LinkError when the socket
    cannot be made.
    """

    def __init__(
        self,
        path: Path,
        mode: int,
        answer: Callable[[bytes, Peer], bytes],
        clock: Callable[[], float] = time.monotonic,
        say: Say = nobody_listens,
    ) -> None:
        self.path = path
        self._answer_to = answer
        self._clock = clock
        self._say = say
        self._said: set[str] = set()
        self._clients: list[_Client] = []
        self._owners = {ROOT, os.geteuid()}
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _remove_stale(path)
            os.fchmod(self._socket.fileno(), mode)  # Linux: the file never has more than this
            self._socket.bind(str(path))
            path.chmod(mode)
            self._socket.listen(BACKLOG)
        except OSError as error:
            self._socket.close()
            reason = error.strerror or str(error)
            text = f"socket {path}: {reason}; name another socket with --status-socket"
            raise LinkError(text) from None
        self._socket.setblocking(False)

    def poll(self) -> None:
        """Serve the clients that wait.

        The call never blocks and never raises an error. The behaviour of clients does not change
        this property.
        """
        with contextlib.suppress(OSError):
            for _ in range(BACKLOG):
                connection, _address = self._socket.accept()
                self._take(connection)
        if self._clients:
            self._clients = [client for client in self._clients if self._served(client)]

    def _take(self, connection: socket.socket) -> None:
        peer = _peer(connection)
        if not self._has_place(peer.uid):
            connection.close()
            return
        connection.setblocking(False)
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 18)
        self._clients.append(_Client(connection, peer, self._clock() + CLIENT_S))

    def _has_place(self, uid: int) -> bool:
        if uid in self._owners:
            return len(self._clients) < CLIENTS_MAX + KEPT_FOR_OWNER
        users = [client.peer.uid for client in self._clients]
        others = [user for user in users if user not in self._owners]
        return len(others) < CLIENTS_MAX and others.count(uid) < CLIENTS_PER_USER

    def _served(self, client: _Client) -> bool:
        """Continue to serve one client. Return whether the client stays connected."""
        try:
            if client.answer is None:
                part = client.connection.recv(REQUEST_MAX)
                client.request += part
                line, end, _ = client.request.partition(b"\n")
                if end:
                    client.answer = self._answer_to(line, client.peer)
                elif not part or len(client.request) > REQUEST_MAX:
                    client.connection.close()
                    return False
            if client.answer is not None:
                sent = client.connection.send(client.answer)
                client.answer = client.answer[sent:]
        except BlockingIOError:
            pass
        except OSError:
            client.connection.close()
            return False
        except Exception as error:  # of what makes the answer: frames go on
            client.connection.close()
            self._failed(error)
            return False
        if client.answer == b"" or self._clock() > client.end:
            client.connection.close()
            return False
        return True

    def _failed(self, error: Exception) -> None:
        """Log an error that prevented an answer. Each kind of error is logged once, because a
        client may repeat its request without end.
        """
        kind = type(error).__name__
        if kind not in self._said:
            self._said.add(kind)
            self._say(f"{self.path}: a request could not be answered ({kind}: {error})", WARNING)

    def close(self) -> None:
        """Remove the socket."""
        for client in self._clients:
            client.connection.close()
        self._socket.close()
        with contextlib.suppress(OSError):
            self.path.unlink()


def _peer(connection: socket.socket) -> Peer:
    data = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return Peer(*_CREDENTIALS.unpack(data))


def _remove_stale(path: Path) -> None:
    """Remove the socket of a killed daemon. A socket that accepts a connection is not removed, so
    that bind fails."""
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()
