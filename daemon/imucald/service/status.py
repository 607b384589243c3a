"""The status socket, and both sockets of a daemon. The main loop answers the clients.

A client connects, sends one line and reads until the end. The line ``status`` gives JSON,
``events`` gives the last events as JSON, ``history`` (or ``history SINCE``) gives the last half
hour, and ``metrics`` gives Prometheus text. ``GET /metrics HTTP/1.1`` gives the same text as an
HTTP response.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from imucald.core.errors import LinkError
from imucald.core.text import json_text
from imucald.runtime.mount_orders import MountOrders
from imucald.service.asking import control_socket
from imucald.service.background_writer import Say
from imucald.service.control import ControlServer
from imucald.service.exposition import METRICS_TYPE
from imucald.service.journal import WARNING, Journal
from imucald.service.line_server import LineServer, nobody_listens


class StatusServer(LineServer):
    """Answers on a Unix socket that all users may read.

    status: function that returns the status; events: the last events; history: function that
    returns the rows of the last half hour after a given time of day, as JSON. say: see
    `LineServer`. Raises LinkError when the socket cannot be made.
    """

    def __init__(
        self,
        path: Path,
        status: Callable[[], Mapping[str, Any]],
        clock: Callable[[], float] = time.monotonic,
        events: Callable[[], Sequence[Mapping[str, Any]]] = list,
        history: Callable[[float], str] = lambda _: "{}\n",
        say: Say = nobody_listens,
    ) -> None:
        # all users may use it, because it accepts no orders
        super().__init__(path, 0o666, lambda line, _: self._answer(line), clock, say=say)
        self._status = status
        self._events = events
        self._history = history

    def _answer(self, request: bytes) -> bytes:
        line = request.strip().decode("ascii", "replace")
        if line == "status":
            return status_json(self._status()).encode()
        if line == "events":
            return status_json({"events": list(self._events())}).encode()
        if line.partition(" ")[0] == "history":
            return self._history(since(line.partition(" ")[2])).encode()
        if line == "metrics":
            return self._metrics()
        if line.startswith("GET "):
            if line.split()[1:2] == ["/metrics"]:
                return _http("200 OK", self._metrics())
            return _http("404 Not Found", b"only /metrics is here\n")
        return b"error: ask for status, events, history or metrics\n"

    def _metrics(self) -> bytes:
        from imucald.service.metrics import metrics_text  # noqa: PLC0415 - few ask for metrics

        return metrics_text(self._status()).encode()


def status_json(status: Mapping[str, Any]) -> str:
    """Return the status as one line of JSON."""
    return json_text(status) + "\n"


def _http(code: str, body: bytes) -> bytes:
    head = f"HTTP/1.1 {code}\r\nContent-Type: {METRICS_TYPE}\r\nContent-Length: {len(body)}\r\n"
    return f"{head}Connection: close\r\n\r\n".encode() + body


def since(text: str) -> float:
    """Convert a text to a time of day [s]. Return minus infinity if the text is not a number."""
    try:
        return float(text)
    except ValueError:
        return -math.inf


class Sockets:
    """The status socket and the control socket. The daemon also works without them.

    path: path of the status socket; with None, there is no socket. is_needed: raise LinkError if
    the status socket cannot be created. status: function that returns the status. history: see
    `StatusServer`.
    """

    def __init__(
        self,
        path: Path | None,
        is_needed: bool,
        status: Callable[[], Mapping[str, Any]],
        orders: MountOrders,
        journal: Journal,
        history: Callable[[float], str],
    ) -> None:
        self.status: StatusServer | None = None
        self.control: ControlServer | None = None
        if path is None:
            return
        try:
            self.status = StatusServer(
                path,
                status,
                events=lambda: [event._asdict() for event in journal.events],
                history=history,
                say=journal.say,
            )
            is_needed = False
            self.control = ControlServer(control_socket(path), orders, journal.say)
        except LinkError as error:
            if is_needed:
                raise
            journal.say(f"{error}; continuing without it", WARNING)

    def poll_status(self) -> None:
        """Serve the clients of the status socket. The method is also called during a long batch of
        frames."""
        if self.status is not None:
            self.status.poll()

    def poll(self) -> None:
        """Serve the waiting clients of both sockets."""
        self.poll_status()
        if self.control is not None:
            self.control.poll()

    def close(self) -> None:
        """Remove both sockets."""
        for server in (self.status, self.control):
            if server is not None:
                server.close()
