"""The unit's count of starts that followed one another: over once the daemon has lived.

The unit (`systemd/imucald@.service`) counts in this file before each start and slows a loop down by
it; that needs no clock, which would cost it a process, because this module ends the count.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

LONG_ENOUGH_S = 60.0
"""Whoever lived so long is in no loop: its next restart is at once again."""
ENDED = b"ended\n"
"""Written over a count; whatever is no number counts for nothing."""


def start_count_file(environment: Mapping[str, str]) -> Path | None:
    """The unit's file; None without a unit."""
    if "INVOCATION_ID" not in environment:  # systemd sets it
        return None
    folder = environment.get("CACHE_DIRECTORY", "").partition(":")[0]
    return Path(folder) / "starts" if folder else None


def end_count(path: Path | None) -> None:
    """An orderly end, or one that another start would not mend, is no part of a loop."""
    if path is not None:
        # in place, as the unit does: where the disk is full meanwhile, no new file could be written
        with suppress(OSError), path.open("r+b") as file:  # else a restart waits for a while
            file.write(ENDED)


class StartCount:
    """Ends the count in a file (None: there is none) after `LONG_ENOUGH_S`."""

    def __init__(self, path: Path | None) -> None:
        self._path = path

    def update(self, uptime: float) -> None:
        """uptime: of this process [s]."""
        if self._path is not None and uptime >= LONG_ENOUGH_S:
            end_count(self._path)
            self._path = None
