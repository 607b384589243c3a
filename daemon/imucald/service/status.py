"""Status for people and programs: asked for over a Unix socket, answered by the loop itself.

A client connects, sends one line and reads until the end: ``status`` gives JSON, ``metrics`` gives
Prometheus text, and ``GET /metrics HTTP/1.1`` the same as a web server would. Answers are small
and fit the socket's buffer, so the loop never waits for a client; clients that dawdle are dropped.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from imucald.core.errors import LinkError
from imucald.service.metrics import metrics_text

CLIENTS_MAX = 8
"""More are turned away."""
CLIENT_S = 1.0
"""A client has so long to ask and to take its answer [s]."""
REQUEST_MAX = 4096
"""Longest request [bytes]."""
RETRY_S = 0.02
"""A full queue of clients is tried again after so long [s]; the daemon looks every 0.1 s."""
SEND_BUFFER = 1 << 18
"""Asked of the kernel for an answer [bytes]."""


def default_socket(channel: str, environment: Mapping[str, str] | None = None) -> Path | None:
    """Where the status socket is, or None where there is no folder for it."""
    environment = os.environ if environment is None else environment
    if folder := environment.get("RUNTIME_DIRECTORY", "").partition(":")[0]:
        return Path(folder) / "status.sock"
    if folder := environment.get("XDG_RUNTIME_DIR", ""):
        return Path(folder) / f"imucald-{channel}.sock"
    return None


class _Client:
    def __init__(self, connection: socket.socket, end: float) -> None:
        self.connection = connection
        self.end = end
        self.request = b""
        self.answer: bytes | None = None


class StatusServer:
    """Answers on a Unix socket, without threads: `poll` does what can be done at once.

    status: makes the status when somebody asks. Raises LinkError when the socket cannot be made.
    """

    def __init__(
        self,
        path: Path,
        status: Callable[[], Mapping[str, Any]],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.path = path
        self._status = status
        self._clock = clock
        self._clients: list[_Client] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM | socket.SOCK_CLOEXEC)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            _remove_stale(path)
            self._socket.bind(str(path))
            path.chmod(0o666)  # it tells, it takes no orders
            self._socket.listen(CLIENTS_MAX)
        except OSError as error:
            self._socket.close()
            reason = error.strerror or str(error)
            raise LinkError(f"status socket {path}: {reason}; see --status-socket") from None
        self._socket.setblocking(False)

    def poll(self) -> None:
        """Serve whoever waits. Never blocks, never raises for what a client does."""
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._socket.accept()
                if len(self._clients) >= CLIENTS_MAX:
                    connection.close()
                    continue
                connection.setblocking(False)
                with contextlib.suppress(OSError):
                    connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
                self._clients.append(_Client(connection, self._clock() + CLIENT_S))
        if self._clients:
            self._clients = [client for client in self._clients if self._served(client)]

    def _served(self, client: _Client) -> bool:
        """Go on with one client; whether it is to be kept."""
        try:
            if client.answer is None:
                part = client.connection.recv(REQUEST_MAX)
                client.request += part
                if b"\n" not in client.request:
                    if not part or len(client.request) > REQUEST_MAX:
                        client.connection.close()
                        return False
                else:
                    client.answer = self._answer(client.request)
            if client.answer is not None:
                sent = client.connection.send(client.answer)
                client.answer = client.answer[sent:]
        except BlockingIOError:
            pass
        except OSError:
            client.connection.close()
            return False
        if client.answer == b"" or self._clock() > client.end:
            client.connection.close()
            return False
        return True

    def _answer(self, request: bytes) -> bytes:
        line = request.partition(b"\n")[0].strip().decode("ascii", "replace")
        if line == "status":
            return status_json(self._status()).encode()
        if line == "metrics":
            return metrics_text(self._status()).encode()
        if line.startswith("GET "):
            if line.split()[1:2] == ["/metrics"]:
                return _http("200 OK", metrics_text(self._status()).encode())
            return _http("404 Not Found", b"only /metrics is here\n")
        return b"error: ask for status or metrics\n"

    def close(self) -> None:
        """Take the socket away."""
        for client in self._clients:
            client.connection.close()
        self._socket.close()
        with contextlib.suppress(OSError):
            self.path.unlink()


def status_json(status: Mapping[str, Any]) -> str:
    """One JSON object on one line."""
    return json.dumps(status, allow_nan=False, ensure_ascii=False) + "\n"


def _http(code: str, body: bytes) -> bytes:
    kind = "text/plain; version=0.0.4; charset=utf-8"
    head = f"HTTP/1.1 {code}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
    return f"{head}Connection: close\r\n\r\n".encode() + body


def _remove_stale(path: Path) -> None:
    """Remove the socket of a daemon that was killed; one that answers is left (bind then fails)."""
    if not path.is_socket():
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(0.2)
        try:
            probe.connect(str(path))
        except ConnectionRefusedError:
            path.unlink()


def ask(path: Path, request: str, timeout: float = 3.0) -> str:
    """Ask a running daemon; raises LinkError with the remedy when it does not answer."""
    parts = []
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
            connection.settimeout(timeout)
            _connect(connection, str(path), time.monotonic() + timeout)
            connection.sendall(request.encode() + b"\n")
            while part := connection.recv(65536):
                parts.append(part)
    except OSError as error:
        reason = error.strerror or str(error)
        raise LinkError(f"{path}: {reason}; is the daemon running there?") from None
    return b"".join(parts).decode("utf-8", "replace")


def _connect(connection: socket.socket, path: str, end: float) -> None:
    """Connect; while as many wait as the daemon lets wait (EAGAIN), until `end` (monotonic)."""
    while True:
        try:
            connection.connect(path)
        except BlockingIOError:
            if time.monotonic() > end:
                raise
            time.sleep(RETRY_S)
        else:
            return
