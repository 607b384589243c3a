"""Messages to systemd: ready, reloading, stopping, a status line, and watchdog messages.

The protocol is sd_notify(3): datagrams with NAME=value lines are sent to the socket that systemd
names in the environment. If the environment does not name a socket, nothing is sent. Sending never
blocks and never fails, because a service manager that does not listen must not stop the daemon.

The module also resets the unit's count of successive starts after the daemon has run for a while.
The unit (`systemd/imucald@.service`) increases the count in a file before each start, and delays
the start if the count is high. The unit does not need to measure time, because this module resets
the count.
"""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path


class Notifier:
    """Sends messages to the service manager.

    environment: environment variables that name the socket and the watchdog (default: the
    environment of this process).
    """

    def __init__(self, environment: Mapping[str, str] | None = None) -> None:
        environment = os.environ if environment is None else environment
        self._address = environment.get("NOTIFY_SOCKET", "")
        if self._address.startswith("@"):  # an abstract one
            self._address = "\0" + self._address[1:]
        self._socket: socket.socket | None = None
        if self._address:
            self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
            self._socket.setblocking(False)
        self._period = _watchdog_period(environment)
        self._next_feed = time.monotonic()
        self._status = ""

    def ready(self) -> None:
        """Report that starting, or reloading, is complete."""
        self._send("READY=1")

    def reloading(self) -> None:
        """Report that the configuration is being read again. `ready` reports the end of the
        reload."""
        self._send(f"RELOADING=1\nMONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> None:
        """Report that the service ends."""
        self._send("STOPPING=1")

    def status(self, text: str) -> None:
        """Send the line that `systemctl status` shows, if the line has changed."""
        line = " ".join(text.split())
        if line != self._status:
            self._status = line
            self._send(f"STATUS={line}")

    def feed(self) -> None:
        """Send a watchdog message if one is due. The main loop must call this often."""
        now = time.monotonic()
        if self._period and now >= self._next_feed:
            self._next_feed = now + self._period
            self._send("WATCHDOG=1")

    def _send(self, text: str) -> None:
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.sendto(text.encode("utf-8", "backslashreplace"), self._address)


def _watchdog_period(environment: Mapping[str, str]) -> float:
    """Return the period of watchdog messages [s], a quarter of the time-out; 0 if systemd expects
    no watchdog messages from this process."""
    try:
        timeout = int(environment.get("WATCHDOG_USEC", "0")) / 1e6
        pid = int(environment.get("WATCHDOG_PID", os.getpid()))
    except ValueError:
        return 0.0
    return timeout / 4.0 if timeout > 0 and pid == os.getpid() else 0.0


LONG_ENOUGH_S = 60.0
"""A process that has run for this long is not in a restart loop [s]. Its next restart has no
delay.
"""


def start_count_file(environment: Mapping[str, str]) -> Path | None:
    """Return the path of the file with the unit's count; None if systemd did not start this
    process."""
    if "INVOCATION_ID" not in environment:  # systemd sets it
        return None
    folder = environment.get("CACHE_DIRECTORY", "").partition(":")[0]
    return Path(folder) / "starts" if folder else None


def end_count(path: Path | None) -> None:
    """Reset the count in the file. The function is called at an orderly end, and at an error that
    another start would not cure. Neither is part of a restart loop.
    """
    if path is not None:
        # The file is overwritten in place, as the unit does: on a disk that has become full, no new
        # file could be written.
        with suppress(OSError), path.open("r+b") as file:  # else a restart waits for a while
            file.write(b"ended\n")  # the unit reads any text but a number as zero


class StartCount:
    """Resets the count of starts in a file after the process has run for `LONG_ENOUGH_S`. Without a
    file (None), nothing is done."""

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def update(self, uptime: float) -> None:
        """Reset the count if the time has passed. uptime: uptime of this process [s]."""
        if self._path is not None and uptime >= LONG_ENOUGH_S:
            end_count(self._path)
            self._path = None
