"""Lines for the log: with syslog priorities where the journal reads them, and never in floods."""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Callable, Mapping
from typing import TextIO

ERROR, WARNING, NOTICE, INFO = 3, 4, 5, 6
"""Priorities of syslog."""
SELDOM_S = 30.0
"""Lines of one kind that may come without end are told so often at most [s]."""


class Journal:
    """Says things in one line each. A log that cannot be written stops nothing."""

    def __init__(
        self,
        stream: TextIO | None = None,
        environment: Mapping[str, str] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._to_journal = _is_journal(
            self._stream, os.environ if environment is None else environment
        )
        self._clock = clock
        self._last: dict[str, tuple[float, int]] = {}

    def say(self, text: str, priority: int = INFO) -> None:
        """Write a line."""
        line = " ".join(text.split())
        head = f"<{priority}>" if self._to_journal else "imucald: "
        try:
            self._stream.write(f"{head}{line}\n")
            self._stream.flush()
        except (OSError, ValueError):
            return

    def seldom(self, kind: str, text: str, priority: int = WARNING) -> None:
        """Write a line unless one of its kind came lately; then say how many were left out."""
        now = self._clock()
        last, untold = self._last.get(kind, (-math.inf, 0))
        if now - last < SELDOM_S:
            self._last[kind] = (last, untold + 1)
            return
        self._last[kind] = (now, 0)
        self.say(text + (f" ({untold} such lines left out before)" if untold else ""), priority)


def _is_journal(stream: TextIO, environment: Mapping[str, str]) -> bool:
    """Whether the stream goes to journald, as systemd.exec(5) says how to find out."""
    named = environment.get("JOURNAL_STREAM", "")
    try:
        found = os.fstat(stream.fileno())
    except (OSError, ValueError, AttributeError):
        return False
    return named == f"{found.st_dev}:{found.st_ino}"
