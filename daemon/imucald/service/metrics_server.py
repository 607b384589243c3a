"""Metrics over HTTP for Prometheus, served by a separate process.

The process requests the metrics at the status sockets of the daemons, like any other client.
"""

from __future__ import annotations

import contextlib
import ipaddress
import math
import socket
import threading
import time
from collections import Counter
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import urlsplit

from imucald import __version__
from imucald.service.exposition import METRICS_TYPE

CLIENTS_MAX = 16
"""Largest number of open connections. For another connection, a connection that has sent no request
is closed."""
IDLE_S = 2.0
CLIENT_S = 5.0
"""Longest duration of a connection [s], also if the client sends its request slowly."""
FRESH_S = 0.2
"""Largest age of the metrics text that is sent as an answer [s]."""


class MetricsHandler(BaseHTTPRequestHandler):
    """Handles the requests GET and HEAD for /metrics; other requests are refused."""

    timeout = IDLE_S
    server_version = f"imucald/{__version__}"
    sys_version = ""
    server: MetricsServer

    def do_GET(self) -> None:
        """Answer a request of Prometheus with the metrics."""
        self.wfile.write(self._headed())

    def do_HEAD(self) -> None:
        """Send only the head of the answer to GET."""
        self._headed()

    def _headed(self) -> bytes:
        """Send the head of the answer, and return the body."""
        self.server.has_asked(self.connection)
        if not self.server.is_named(self.headers.get("Host", "")):
            self.send_error(403, "these metrics are for this machine only")
            return b""
        if self.path.partition("?")[0] != "/metrics":
            self.send_error(404, "only /metrics is here")
            return b""
        body = self.server.fresh_text().encode()
        self.send_response(200)
        self.send_header("Content-Type", METRICS_TYPE)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        return body

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - as in the library
        """Log nothing, because requests repeat without end."""


class MetricsServer(ThreadingHTTPServer):
    """HTTP server on a socket that already listens. text: function that returns the metrics
    text.
    """

    daemon_threads = True

    def __init__(self, listening: socket.socket, text: Callable[[], str]) -> None:
        super().__init__(listening.getsockname()[:2], MetricsHandler, bind_and_activate=False)
        self.socket.close()
        self.socket = listening
        self.text = text
        self._is_local = _is_loopback(str(self.server_address[0]))
        self._open: dict[Any, str] = {}  # sockets, oldest first, with the address of each
        self._asking: set[Any] = set()
        """Connections whose request is not complete yet."""
        self._lock, self._making = threading.Lock(), threading.Lock()
        self._made, self._made_at = "", -math.inf

    def is_named(self, host: str) -> bool:
        """Return whether the Host field of a request is a valid name of this server.

        A server that listens only on this machine accepts a loopback address and "localhost". Other
        names are refused, because a foreign web page could let its own name point to this machine
        and read the metrics through its visitor's browser.
        """
        if not self._is_local:
            return True
        try:
            name = urlsplit(f"//{host}").hostname
        except ValueError:
            return False
        return name is None or name == "localhost" or _is_loopback(name)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a new connection.

        If there are too many connections, one that has sent no request is closed: the oldest such
        connection of the address with the most connections. A client with slow requests therefore
        cannot block other clients, even with many connections.
        """
        with self._lock:
            if len(self._open) >= CLIENTS_MAX:
                counts = Counter(self._open.values())
                waiting = [other for other in self._open if other in self._asking]
                if not waiting:
                    self.shutdown_request(request)
                    return
                out = max(waiting, key=lambda other: counts[self._open[other]])  # the first of them
                self._forget(out)
                _cut(out)
            self._open[request] = str(client_address[0])
            self._asking.add(request)
        super().process_request(request, client_address)

    def _forget(self, request: Any) -> None:
        self._open.pop(request, None)
        self._asking.discard(request)

    def has_asked(self, request: Any) -> None:
        """Register that the request of a connection is complete. The connection is then not closed
        before its answer.
        """
        with self._lock:
            self._asking.discard(request)

    def fresh_text(self) -> str:
        """Return the metrics text, not older than `FRESH_S`. Simultaneous requests share one
        text."""
        with self._making:
            if time.monotonic() - self._made_at > FRESH_S:
                self._made, self._made_at = self.text(), time.monotonic()
            return self._made

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection, for at most `CLIENT_S`."""
        end = threading.Timer(CLIENT_S, _cut, [request])
        end.daemon = True
        end.start()
        try:
            super().process_request_thread(request, client_address)
        finally:
            end.cancel()
            with self._lock:
                self._forget(request)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Ignore the error, because clients often end a connection early."""


def _cut(request: socket.socket) -> None:
    """Shut down a connection, so that its thread stops waiting. Closing the socket would not end
    the wait, because the thread's file objects keep the connection open.
    """
    with contextlib.suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False
