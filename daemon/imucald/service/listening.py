"""Listen at an address, and serve metrics there in a separate process."""

from __future__ import annotations

import os
import select
import signal
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

from imucald.core.errors import LinkError
from imucald.service.line_server import BACKLOG


def listening_at(address: str) -> socket.socket:
    """Listen at "127.0.0.1:8131" or "[::1]:8131". Raises LinkError with the remedy."""
    host, colon, port = address.rpartition(":")
    if not colon or not host or not port.isdecimal() or not 0 <= int(port) <= 0xFFFF:
        raise LinkError(f"{address!r} is not an address: write HOST:PORT, such as 127.0.0.1:8131")
    host = host.strip("[]")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, int(port)), family=family, backlog=BACKLOG)
    except OSError as error:
        reason = error.strerror or str(error)
        hint = "; give another address or port"
        if isinstance(error, PermissionError) or "not supported" in reason:
            hint = "; docs/service.md, Metrics, says how to allow it under systemd"
        raise LinkError(f"metrics cannot be served at {address}: {reason}{hint}") from None


class ServingProcess:
    """A forked process that serves a socket. The forked process ends when its parent process ends,
    for any reason.

    serve: function that runs in the forked process forever. The object must be created before any
    thread is started.
    """

    def __init__(self, listening: socket.socket, serve: Callable[[socket.socket], None]) -> None:
        alive, self._mine = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            os.close(self._mine)
            _serve(listening, serve, alive)
        os.close(alive)
        listening.close()
        self.has_ended = False

    def poll(self) -> bool:
        """Return whether the forked process has ended by itself since the last call."""
        if self.has_ended:
            return False
        try:
            self.has_ended = os.waitpid(self.pid, os.WNOHANG)[0] != 0
        except ChildProcessError:  # SIGCHLD is ignored: the kernel has forgotten it already
            self.has_ended = True
        return self.has_ended

    def close(self) -> None:
        """End the forked process."""
        os.close(self._mine)
        self.poll()  # its number may be another process's by now where SIGCHLD is ignored
        if not self.has_ended:
            with suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)  # it has nothing to lose
            with suppress(ChildProcessError):
                os.waitpid(self.pid, 0)
            self.has_ended = True


def _serve(
    listening: socket.socket, serve: Callable[[socket.socket], None], alive: int
) -> NoReturn:
    def end_with_the_parent() -> None:
        select.select([alive], [], [])  # readable when the other end is gone
        os._exit(0)

    try:
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        signal.signal(signal.SIGUSR1, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        threading.Thread(target=end_with_the_parent, daemon=True).start()
        serve(listening)
    finally:
        os._exit(1)
