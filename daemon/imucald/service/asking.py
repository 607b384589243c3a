"""The path of a daemon's status socket, and a request to this socket: one line is sent, the whole
answer is read."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from imucald.core.errors import LinkError

RUNNING = Path("/run/imucald")
"""Folder with one subfolder for each daemon of systemd or root."""
RETRY_S = 0.02
"""Pause before the next attempt when the queue of clients is full [s]. The daemon serves the queue
every 0.1 s.
"""
MOST_BYTES = 1 << 23
"""Longest accepted answer [bytes]: several times the size of a history of half an hour."""


def default_socket(channel: str, environment: Mapping[str, str] | None = None) -> Path | None:
    """Return the path of the status socket, or None if there is no folder for it.

    For root there is always a folder, even if the environment does not name one (in a container,
    under sudo or cron).
    """
    environment = os.environ if environment is None else environment
    if folder := environment.get("RUNTIME_DIRECTORY", "").partition(":")[0]:
        return Path(folder) / "status.sock"
    if folder := environment.get("XDG_RUNTIME_DIR", ""):
        return Path(folder) / f"imucald-{_in_one_name(channel)}.sock"
    return running_socket(channel) if os.geteuid() == 0 else None


def running_socket(channel: str) -> Path:
    """Return the path of the status socket of a daemon that systemd or root runs on a channel."""
    return RUNNING / _in_one_name(channel) / "status.sock"


def _in_one_name(channel: str) -> str:
    """Return the name of a channel such as /dev/ttyACM0 as one file name without folders."""
    return channel.strip("/.").replace("/", "-")


KINDS: Mapping[str, Mapping[str, type]] = {
    "status": {"state": str, "quality": int, "mount": dict, "link": dict, "config": str},
    "events": {"events": list},
}
"""Keys of the JSON answer to a request, with the types of their values."""


def content(path: Path, request: str, answer: str) -> dict[str, Any]:
    """Return the content of a JSON answer. Raises LinkError if the answer is not from imucald."""
    try:
        found = json.loads(answer)
    except (ValueError, RecursionError):
        found = None
    kinds = KINDS[request].items()
    if isinstance(found, dict) and all(isinstance(found.get(key), kind) for key, kind in kinds):
        return found
    raise _foreign(path)


@contextlib.contextmanager
def understood(path: Path | None) -> Iterator[None]:
    """Context for reading an answer. Raises LinkError if a key of the answer is missing or a value
    has a wrong type.
    """
    try:
        yield
    except (LookupError, TypeError, ValueError, ArithmeticError, AttributeError) as error:
        raise _foreign(path, f" ({type(error).__name__}: {error})") from error


def _foreign(path: Path | None, why: str = "") -> LinkError:
    return LinkError(
        f"{path or 'status'}: the answer is not from an imucald daemon{why}; name the status "
        "socket of the daemon (--socket PATH)"
    )


class NotRunningError(LinkError):
    """No daemon listens."""

    exit_status = 3
    """The number that `systemctl is-active` and the command `status` of init scripts use."""


class BusyError(LinkError):
    """A daemon listens on the socket but did not answer in time."""

    exit_status = 8


def ask(path: Path, request: str, timeout: float = 3.0, is_repeatable: bool = True) -> str:
    """Send a request to a running daemon, and return the answer. Raises NotRunningError with the
    remedy if no daemon listens on the socket, and BusyError if a daemon does not answer.

    is_repeatable: send the request again if the daemon refused the connection, until `timeout` [s].
    """
    end = time.monotonic() + timeout
    while True:
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
                connection.settimeout(timeout)
                _connect(connection, str(path), end)
                answer = _answer(connection, path, request, timeout)
        except OSError as error:
            reason = error.strerror or str(error)
            if isinstance(error, BlockingIOError):
                raise _busy(path) from None
            raise NotRunningError(f"{path}: {reason}. Is the daemon running?") from None
        if answer:
            return answer.decode("utf-8", "replace")
        if not is_repeatable or time.monotonic() > end:
            raise _busy(path)
        time.sleep(RETRY_S)


def _busy(path: Path) -> BusyError:
    return BusyError(
        f"{path}: the daemon runs but did not answer. The daemon is busy, or has "
        "too many clients at the same time; try again"
    )


def _answer(connection: socket.socket, path: Path, request: str, timeout: float) -> bytes:
    """Return the daemon's answer; empty if the daemon refused the connection, or if the answer was
    not complete in time. Raises LinkError if the answer is longer than `MOST_BYTES`.
    """
    found, end = bytearray(), time.monotonic() + timeout
    try:
        connection.sendall(request.encode() + b"\n")
        while part := connection.recv(65536):
            found += part
            if len(found) > MOST_BYTES:
                raise _foreign(path)
            connection.settimeout(max(end - time.monotonic(), 0.001))
    except (ConnectionError, TimeoutError):
        return b""
    return bytes(found)


def _connect(connection: socket.socket, path: str, end: float) -> None:
    """Connect. If the queue of clients is full (EAGAIN), try again until `end` (monotonic)."""
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
    """Return the path of the control socket, in the folder of the status socket."""
    if status_socket.name == "status.sock":
        return status_socket.with_name("control.sock")
    return status_socket.with_name(f"{status_socket.name}.control")
