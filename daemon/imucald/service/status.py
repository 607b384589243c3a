"""Status for people and programs. Clients request it over a Unix socket, and the main loop answers.

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

from imucald.core.text import json_text
from imucald.service.background_writer import Say
from imucald.service.line_server import LineServer, nobody_listens

READABLE_BY_ALL = 0o666
"""Permissions of the status socket. All users may use it, because it accepts no orders."""


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
        super().__init__(path, READABLE_BY_ALL, lambda line, _: self._answer(line), clock, say=say)
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
    kind = "text/plain; version=0.0.4; charset=utf-8"
    head = f"HTTP/1.1 {code}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
    return f"{head}Connection: close\r\n\r\n".encode() + body


def since(text: str) -> float:
    """Convert a text to a time of day [s]. Return minus infinity if the text is not a number."""
    try:
        return float(text)
    except ValueError:
        return -math.inf
