"""Keeps the DTCs over restarts: one small file in the folder of the saved state.

The codes only tell a workshop what to examine; no function depends on them. One generation is
therefore enough. An invalid file is set aside and started from nothing.
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final

from imucald.core.files import free_name, read_regular, split_checksum, with_checksum, write_file
from imucald.service.background_writer import Say, StateWriter
from imucald.service.journal import WARNING
from imucald.uds.dtc_memory import DtcMemory

MAGIC: Final = "imucald-troubles 1"
"""The first word is older than this module's name; existing files begin with it."""
MAX_BYTES: Final = 1 << 16
"""A longer file was not written by this module."""
PERIOD_S: Final = 10.0
"""Shortest time between writes of changed codes [s]: a flapping input does not wear out the
disk.
"""

CLOSE_WAIT_S: Final = 0.2
"""Longest wait for the disk at a stop [s]; the calibration's state waits longer."""


class DtcStore:
    """The memory of one daemon, read from its file at the start and written when it changes.

    path: None saves nothing. say: function that takes a log line and its priority. clock: monotonic
    [s].
    """

    def __init__(
        self, path: Path | None, say: Say, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.memory = DtcMemory()
        self.path = path
        self._say = say
        self._clock = clock
        self._next = clock()
        self.writer: StateWriter[bytes] | None = None
        if path is not None:
            self.writer = StateWriter(lambda data: write_file(path, data), "the DTC memory", say)
            self.memory.restore(self._read(path))
        self._written = self.memory.saved()

    def update(self) -> None:
        """Request that changed codes are written; never waits for the disk."""
        if self._clock() >= self._next:
            self._put()

    def close(self) -> None:
        """Write the last changes; waits for the disk, but not for long."""
        self._put()
        if self.writer is not None:
            self.writer.close(CLOSE_WAIT_S)
            self.writer.report()

    def _put(self) -> None:
        if self.writer is None:
            return
        self.writer.report()
        now = self.memory.saved()
        if now != self._written:
            self._written, self._next = now, self._clock() + PERIOD_S
            self.writer.put(encoded(now))

    def status(self) -> dict[str, Any] | None:
        """Return saves, failures and the last error; None if nothing is saved."""
        return None if self.writer is None else self.writer.status()

    def _read(self, path: Path) -> Mapping[str, Any]:
        try:
            data = read_regular(path, MAX_BYTES)
        except FileNotFoundError:
            return {}
        except OSError as error:
            self._say(f"DTCs: {path} cannot be read: {error.strerror}", WARNING)
            return {}
        found = decoded(data)
        if found is None:
            aside = free_name(path, "corrupt")
            with contextlib.suppress(OSError):
                path.rename(aside)
            self._say(f"DTCs: {path} is damaged; the file is renamed to {aside.name}", WARNING)
        return found or {}


def encoded(records: Mapping[str, Any]) -> bytes:
    """Return the bytes of a file: one line with version and checksum, then JSON."""
    body = json.dumps(records).encode()
    return with_checksum(MAGIC, body)


def decoded(data: bytes) -> Mapping[str, Any] | None:
    """Return the records in a file's bytes, or None if it is damaged."""
    title, body, is_right = split_checksum(data)
    if len(data) > MAX_BYTES or title != MAGIC.encode() or not is_right:
        return None
    try:
        found = json.loads(body)
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None
