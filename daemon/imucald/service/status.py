"""Status for people and programs: requested over a Unix socket, answered by the loop itself.

A client connects, sends one line and reads until the end. ``status`` gives JSON, ``events`` the
last events as JSON, ``history`` (or ``history SINCE``) the last half hour, ``metrics`` Prometheus
text, and ``GET /metrics HTTP/1.1`` the same text as a web server would send it.
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
"""Permissions of the socket: it answers questions and takes no orders."""


class StatusServer(LineServer):
    """Answers on a Unix socket that all users may read.

    status: function that makes the status on request; events: the last events; history: function
    that returns the last half hour after a time of day, as JSON. say: see `LineServer`. Raises
    LinkError when the socket cannot be made.
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
    """Return one JSON object on one line."""
    return json_text(status) + "\n"


def _http(code: str, body: bytes) -> bytes:
    kind = "text/plain; version=0.0.4; charset=utf-8"
    head = f"HTTP/1.1 {code}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
    return f"{head}Connection: close\r\n\r\n".encode() + body


def since(text: str) -> float:
    """Return a time of day [s]; a time before all others if the text is none."""
    try:
        return float(text)
    except ValueError:
        return -math.inf
