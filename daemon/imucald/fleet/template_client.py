"""The client of the template process in a worker: it sends tasks and waits until the child
processes end."""

from __future__ import annotations

import atexit
import os
import socket
import subprocess
import sys
import threading
from contextlib import suppress
from typing import ClassVar

import msgspec

from imucald.core.errors import ImucaldError
from imucald.fleet.task import Outcome, Task

STARTING_S = 120.0
"""Longest wait for the start of a template process [s]. Its imports usually take less than a
second, but packages in a shared folder may be slow."""
FOR_CHILDREN = {
    "OMP_NUM_THREADS": "1",  # logs run in parallel, not their arithmetic
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "ARROW_DEFAULT_MEMORY_POOL": "system",  # other pools map 1 GiB at once
}
"""Environment variables for child processes."""


class Template:
    """One template process. Several threads may call `run` at the same time."""

    def __init__(self, function: str) -> None:
        self._function = function
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._starting: socket.socket | None = None
        self._control: socket.socket | None = None

    def begin(self) -> None:
        """Start the template if it is not running. The call does not wait until it has started."""
        with self._lock:
            if self._process is None:
                self._starting = self._launched()

    def run(self, task: Task) -> Outcome:
        """Run a task in its own child process. Always returns an outcome and never raises an
        error."""
        ours, theirs = socket.socketpair()
        with ours:
            with theirs:
                self._send(theirs)
            with suppress(OSError):
                ours.sendall(msgspec.json.encode(task))
                ours.shutdown(socket.SHUT_WR)
            answer = b"".join(iter(lambda: _received(ours), b""))
        try:
            return msgspec.json.decode(answer, type=Outcome)
        except msgspec.DecodeError:
            text = "the process that supervises it was killed from outside"
            return Outcome("crashed", text)

    def _send(self, theirs: socket.socket) -> None:
        """Send the other end of the socket to the template. If the template has died, it is started
        again, once."""
        with self._lock:
            for last in (False, True):
                control = self._control or self._started()
                try:
                    socket.send_fds(control, [b"t"], [theirs.fileno()])
                except OSError:
                    self._stop()
                    if last:
                        raise
                else:
                    return

    def _started(self) -> socket.socket:
        ours, self._starting = self._starting or self._launched(), None
        ours.settimeout(STARTING_S)
        if ours.recv(1) != b"r":
            ours.close()
            raise ImucaldError(f"the process that evaluates logs does not start: {self._function}")
        ours.settimeout(None)
        self._control = ours
        return ours

    def _launched(self) -> socket.socket:
        ours, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [
                    sys.executable,
                    "-P",
                    "-m",
                    __package__ + ".template",
                    str(theirs.fileno()),
                    self._function,
                ],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C is for the driver: running logs are finished
                env={**os.environ, **FOR_CHILDREN},
            )
        return ours

    def _stop(self) -> None:
        for control in (self._control, self._starting):
            if control is not None:
                control.close()
        self._control = self._starting = None
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def close(self) -> None:
        """End the template. Its child processes end with it."""
        with self._lock:
            self._stop()


def _received(ours: socket.socket) -> bytes:
    try:
        return ours.recv(2**16)
    except OSError:  # the keeper died before it read the task
        return b""


class _Templates:
    """The template processes of this process: one for each function."""

    lock = threading.Lock()
    of: ClassVar[dict[str, Template]] = {}


def template_for(function: str) -> Template:
    """Return the template process for a function."""
    with _Templates.lock:
        if not _Templates.of:
            atexit.register(close_templates)
        return _Templates.of.setdefault(function, Template(function))


def close_templates() -> None:
    """End all templates of this process."""
    with _Templates.lock:
        for template in _Templates.of.values():
            template.close()
        _Templates.of.clear()
