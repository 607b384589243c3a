"""Metrics over HTTP for a Prometheus that scrapes, served by a separate process.

The process asks the daemons' status sockets, as any client may; it does not use the frame loop.
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

CLIENTS_MAX = 16
"""Connections above which one without a request is closed."""
IDLE_S = 2.0
CLIENT_S = 5.0
"""Longest duration of a connection [s], however slowly its request comes."""
FRESH_S = 0.2
"""Largest age of a text that is sent as an answer [s]."""
CONTENT = "text/plain; version=0.0.4; charset=utf-8"


class MetricsHandler(BaseHTTPRequestHandler):
    """Handles GET and HEAD of /metrics, and nothing else."""

    timeout = IDLE_S
    server_version = f"imucald/{__version__}"
    sys_version = ""
    server: MetricsServer

    def do_GET(self) -> None:
        """Answer a scrape."""
        self.wfile.write(self._headed())

    def do_HEAD(self) -> None:
        """Answer as for GET, without the text."""
        self._headed()

    def _headed(self) -> bytes:
        """Send the head of the answer; return its text."""
        self.server.has_asked(self.connection)
        if not self.server.is_named(self.headers.get("Host", "")):
            self.send_error(403, "these metrics are for this machine only")
            return b""
        if self.path.partition("?")[0] != "/metrics":
            self.send_error(404, "only /metrics is here")
            return b""
        body = self.server.fresh_text().encode()
        self.send_response(200)
        self.send_header("Content-Type", CONTENT)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        return body

    def log_message(self, format: str, *args: Any) -> None:  # noqa: A002 - as in the library
        """Write no line: scrapes come without end."""


class MetricsServer(ThreadingHTTPServer):
    """Serves on a socket that already listens. text: function that makes the answer of each
    scrape.
    """

    daemon_threads = True
    request_queue_size = 128

    def __init__(self, listening: socket.socket, text: Callable[[], str]) -> None:
        super().__init__(listening.getsockname()[:2], MetricsHandler, bind_and_activate=False)
        self.socket.close()
        self.socket = listening
        self.text = text
        self._is_local = _is_loopback(str(self.server_address[0]))
        self._open: dict[Any, str] = {}  # sockets, oldest first, with the address of each
        self._asking: set[Any] = set()
        """Connections whose request has not come yet."""
        self._lock, self._making = threading.Lock(), threading.Lock()
        self._made, self._made_at = "", -math.inf

    def is_named(self, host: str) -> bool:
        """Return whether a request's Host is a valid name of this server.

        A server for this machine only is valid under an address or as localhost. Any other name may
        belong to a web page that was made to point here, in order to read what its visitor's
        machine shows.
        """
        if not self._is_local:
            return True
        try:
            name = urlsplit(f"//{host}").hostname
        except ValueError:
            return False
        return name is None or name == "localhost" or _is_loopback(name)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Serve a connection along with the others.

        If there are too many, one without a request is closed. The oldest connection of the address
        with the most such connections is closed. A client with slow requests therefore cannot block
        others, however many connections it has.
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
        """Note that the request of a connection is complete, so the connection is answered in any
        case.
        """
        with self._lock:
            self._asking.discard(request)

    def fresh_text(self) -> str:
        """Return the text; simultaneous requests share one text."""
        with self._making:
            if time.monotonic() - self._made_at > FRESH_S:
                self._made, self._made_at = self.text(), time.monotonic()
            return self._made

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Serve a connection for its allowed duration."""
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
        """Ignore the error: a client that went away is usual."""


def _cut(request: socket.socket) -> None:
    """End the wait of a connection's thread.

    Closing would not do this, because the thread's files keep the connection open.
    """
    with contextlib.suppress(OSError):
        request.shutdown(socket.SHUT_RDWR)


def _is_loopback(address: str) -> bool:
    try:
        return ipaddress.ip_address(address).is_loopback
    except ValueError:
        return False
