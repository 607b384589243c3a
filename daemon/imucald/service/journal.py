"""Log lines of the daemon, at a limited rate. If journald reads them, each line begins with its
syslog priority."""

from __future__ import annotations

import math
import os
import select
import socket
import stat
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import NamedTuple, TextIO

from imucald.core.text import counted, made_safe

ERROR, WARNING, NOTICE, INFO = 3, 4, 5, 6
"""Priorities of syslog."""
LEVELS = {ERROR: "error", WARNING: "warning", NOTICE: "notice", INFO: "info"}
PRIORITIES = {word: priority for priority, word in LEVELS.items()}
SELDOM_S = 30.0
"""Shortest time between two lines of a kind that may repeat without end [s]."""
LINE_BYTES = 4000
"""Lines are cut to this length, because any pipe accepts 4096 bytes at once."""


class LogEvent(NamedTuple):
    """One log line. at: wall clock [s]. level: "error", "warning", "notice" or "info"."""

    at: float
    level: str
    text: str


class Journal:
    """Writes messages of one line each.

    A log that cannot be written neither stops nor delays the program.

    stream: None for standard error, which may be closed. A line that cannot be written at once is
    dropped and counted. The next written line states the number of dropped lines. level: the least
    important priority that is written; `events` stores all lines.
    """

    def __init__(
        self,
        stream: TextIO | None = None,
        environment: Mapping[str, str] | None = None,
        clock: Callable[[], float] = time.monotonic,
        level: int = INFO,
    ) -> None:
        self.events: deque[LogEvent] = deque(maxlen=200)
        """The newest log lines, the oldest first. The system's journal contains all lines."""
        self.dropped = 0
        """Number of lines that could not be written."""
        self._untold = 0
        self._stream: TextIO | None = sys.stderr if stream is None else stream
        self._file = _descriptor(self._stream)
        self._to_journal = _is_journal(
            self._stream, os.environ if environment is None else environment
        )
        self._clock = clock
        self._level = level
        self._due: dict[str, tuple[float, int]] = {}

    def say(self, text: str, priority: int = INFO) -> None:
        """Write a line."""
        line = made_safe(" ".join(text.split()))
        self.events.append(LogEvent(round(time.time(), 3), LEVELS[priority], line[:LINE_BYTES]))
        if priority > self._level:
            return
        if self._untold and self._write(
            f"{counted(self._untold, 'line')} could not be written", WARNING
        ):
            self._untold = 0
        if not self._write(line, priority):
            self.dropped += 1
            self._untold += 1

    def _write(self, line: str, priority: int) -> bool:
        """Write a line if it can be written without waiting. Return whether the line was
        written."""
        head = f"<{priority}>" if self._to_journal else "imucald: "
        try:
            if self._file is not None:
                data = f"{head}{line}".encode("utf-8", "backslashreplace")
                return _written_at_once(self._file, data[:LINE_BYTES] + b"\n")
            if self._stream is None:
                return False
            self._stream.write(f"{head}{line}\n")
            self._stream.flush()
        except (OSError, ValueError):
            return False
        return True

    def seldom(self, kind: str, text: str, priority: int = WARNING, burst: int = 1) -> bool:
        """Write a line unless `burst` lines of its kind were written within `SELDOM_S`. The next
        line of the kind states the number of omitted lines. Return whether the line was written.
        """
        due, untold = self._due.get(kind, (-math.inf, 0))
        now = self._clock()
        due = max(due, now - (burst - 1) * SELDOM_S)  # time of the next line without bursts
        if now < due:
            self._due[kind] = (due, untold + 1)
            return False
        self._due[kind] = (due + SELDOM_S, 0)
        self.say(
            text + (f" ({counted(untold, 'such line')} omitted before)" if untold else ""),
            priority,
        )
        return True

    def is_due(self, kind: str) -> bool:
        """Return whether `seldom` would write a line of the kind."""
        return self._clock() >= self._due.get(kind, (-math.inf, 0))[0]


def _descriptor(stream: TextIO | None) -> int | None:
    try:
        return None if stream is None else stream.fileno()
    except (OSError, ValueError, AttributeError):
        return None


def _written_at_once(file: int, data: bytes) -> bool:
    """Write the data without waiting for the reader of the file. Return whether the data were
    written.

    Other processes may share the file, so it cannot be set to non-blocking.
    """
    if stat.S_ISSOCK(os.fstat(file).st_mode):
        with socket.socket(fileno=os.dup(file)) as connection:
            return connection.send(data, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL) == len(data)
    poll = select.poll()
    poll.register(file, select.POLLOUT)
    if not any(events & select.POLLOUT for _, events in poll.poll(0)):
        return False
    return os.write(file, data) == len(data)


def _is_journal(stream: TextIO | None, environment: Mapping[str, str]) -> bool:
    """Return whether the stream is connected to journald (method: systemd.exec(5))."""
    named = environment.get("JOURNAL_STREAM", "")
    try:
        found = os.fstat(-1 if stream is None else stream.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return named == f"{found.st_dev}:{found.st_ino}"
