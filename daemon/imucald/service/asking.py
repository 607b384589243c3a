"""Asking a running daemon over one of its Unix sockets: one line there, everything back."""

from __future__ import annotations

import socket
import time
from pathlib import Path

from imucald.core.errors import LinkError

RETRY_S = 0.02
"""A full queue of clients is tried again after so long [s]; the daemon looks every 0.1 s."""


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
