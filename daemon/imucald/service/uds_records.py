"""Saved records of the diagnostics: DTCs, and the number of successive wrong keys.

The DTCs are information for a workshop; no function depends on them. If the record of DTCs is
invalid, the memory starts empty. The number of wrong keys is saved, so that a restart does not
allow new attempts. A missing record counts as no wrong key. An invalid record counts as one wrong
key, which starts the delay.
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
from imucald.uds.dtc import DtcMemory

DTC_KIND: Final = "imucald-troubles"
"""First word of the files with DTCs. The word cannot change, because existing files begin with
it."""
PERIOD_S: Final = 10.0
"""Shortest time between writes of changed codes [s]. An input that fails repeatedly therefore does
not wear out the disk.
"""
MAX_WRONG: Final = 255


class WrongKeys(Struct, frozen=True):
    """Content of the record. wrong: number of successive wrong keys."""

    wrong: Annotated[int, Meta(ge=0, le=MAX_WRONG)]


class AttemptStore(KeptRecord[WrongKeys]):
    """The number of successive wrong keys of one daemon. With path None, nothing is saved.

    say: function that takes a log line and its priority.
    """

    def __init__(self, path: Path | None, say: Say) -> None:
        title = "the count of wrong keys"
        super().__init__(
            path, "imucald-keys", lambda record: convert(record, WrongKeys), title, say
        )
        self.wrong = int(bool(self.problems)) if self.content is None else self.content.wrong
        """The saved number of successive wrong keys."""
        if self.problems:
            say("one wrong key is assumed", WARNING)

    def put_count(self, wrong: int) -> None:
        """Request that the number `wrong` is saved. The call never waits for the disk."""
        self.wrong = wrong
        self.put(WrongKeys(min(wrong, MAX_WRONG)))


class DtcStore(KeptRecord[dict[str, Any]]):
    """The DTC memory of one daemon, restored at the start and written when it changes.

    With path None, nothing is saved. say: function that takes a log line and its priority. clock:
    monotonic [s].
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
        """Request that changed codes are written. The call never waits for the disk."""
        if self._clock() >= self._next:
            self._put_changes()

    def close(self) -> None:
        """Write the last changes. The wait for the disk is limited."""
        self._put_changes()
        super().close()

    def _put_changes(self) -> None:
        now = self.memory.saved()
        if now != self._written:
            self._written, self._next = now, self._clock() + PERIOD_S
            self.put(now)
        elif self.writer is not None:
            self.writer.report()
