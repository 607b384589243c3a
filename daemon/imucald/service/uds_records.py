"""Saved records of the diagnostics: DTCs, and wrong keys in a row.

The DTCs only tell a workshop what to examine; no function depends on them. An invalid record is
started from nothing. The number of wrong keys is saved so that a restart gives no new attempts. A
missing record counts as no wrong key, an invalid one as one wrong key, which costs the delay.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Final

from msgspec import Meta, Struct, convert

from imucald.service.background_writer import Say
from imucald.service.journal import WARNING
from imucald.service.records import KeptRecord
from imucald.uds.dtc_memory import DtcMemory

DTC_KIND: Final = "imucald-troubles"
"""The word is older than the name of the memory; existing files begin with it."""
KEYS_KIND: Final = "imucald-keys"
PERIOD_S: Final = 10.0
"""Shortest time between writes of changed codes [s]: a flapping input does not wear out the
disk.
"""
MAX_WRONG: Final = 255


class WrongKeys(Struct, frozen=True):
    """wrong: wrong keys in a row."""

    wrong: Annotated[int, Meta(ge=0, le=MAX_WRONG)]


class AttemptStore(KeptRecord[WrongKeys]):
    """Wrong keys in a row of one daemon. path: None saves nothing.

    say: function that takes a log line and its priority.
    """

    def __init__(self, path: Path | None, say: Say) -> None:
        title = "the count of wrong keys"
        super().__init__(path, KEYS_KIND, lambda record: convert(record, WrongKeys), title, say)
        self.wrong = int(bool(self.problems)) if self.content is None else self.content.wrong
        """Wrong keys in a row, as saved."""
        if self.problems:
            say("one wrong key is assumed", WARNING)

    def put_count(self, wrong: int) -> None:
        """Request that another number is saved; never waits for the disk."""
        self.wrong = wrong
        self.put(WrongKeys(min(wrong, MAX_WRONG)))


class DtcStore(KeptRecord[dict[str, Any]]):
    """The DTC memory of one daemon, restored at the start and written when it changes.

    path: None saves nothing. say: function that takes a log line and its priority. clock: monotonic
    [s].
    """

    def __init__(
        self, path: Path | None, say: Say, clock: Callable[[], float] = time.monotonic
    ) -> None:
        super().__init__(path, DTC_KIND, dict, "the DTC memory", say)
        self.memory = DtcMemory()
        self.memory.restore(self.content or {})
        self._clock = clock
        self._next = clock()
        self._written = self.memory.saved()

    def update(self) -> None:
        """Request that changed codes are written; never waits for the disk."""
        if self._clock() >= self._next:
            self._put_changes()

    def close(self) -> None:
        """Write the last changes; waits for the disk, but not for long."""
        self._put_changes()
        super().close()

    def _put_changes(self) -> None:
        now = self.memory.saved()
        if now != self._written:
            self._written, self._next = now, self._clock() + PERIOD_S
            self.put(now)
        elif self.writer is not None:
            self.writer.report()
