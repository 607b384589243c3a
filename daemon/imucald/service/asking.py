"""Asking a running daemon over one of its Unix sockets (one line there, everything back)."""

from __future__ import annotations

import socket
import time
from pathlib import Path

from imucald.core.errors import LinkError

RETRY_S = 0.02
"""A full queue of clients is tried again after so long [s]; the daemon looks every 0.1 s."""


class BusyError(LinkError):
    """A daemon has the socket, and did not answer in time."""


def ask(path: Path, request: str, timeout: float = 3.0, is_repeatable: bool = True) -> str:
    """Ask a running daemon; raises LinkError with the remedy when none has the socket.

    is_repeatable: ask again where the daemon turned us away, until `timeout` [s]. Raises BusyError
    where a daemon has the socket and does not answer.
    """
    end = time.monotonic() + timeout
    while True:
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
                connection.settimeout(timeout)
                _connect(connection, str(path), end)
                answer = _answer(connection, request)
        except OSError as error:
            reason = error.strerror or str(error)
            if isinstance(error, BlockingIOError):
                raise _busy(path) from None
            raise LinkError(f"{path}: {reason}; is the daemon running there?") from None
        if answer:
            return answer.decode("utf-8", "replace")
        if not is_repeatable or time.monotonic() > end:
            raise _busy(path)
        time.sleep(RETRY_S)


def _busy(path: Path) -> BusyError:
    return BusyError(
        f"{path}: a daemon runs there and gave no answer: too many ask at a time, or its loop is "
        "held up; ask again"
    )


def _answer(connection: socket.socket, request: str) -> bytes:
    """What the daemon says; empty where it turned us away."""
    parts = []
    try:
        connection.sendall(request.encode() + b"\n")
        while part := connection.recv(65536):
            parts.append(part)
    except (ConnectionError, TimeoutError):
        return b""
    return b"".join(parts)


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


def control_socket(status_socket: Path) -> Path:
    """Next to the status socket."""
    if status_socket.name == "status.sock":
        return status_socket.with_name("control.sock")
    return status_socket.with_name(f"{status_socket.name}.control")
