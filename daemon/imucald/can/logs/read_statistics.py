"""What a reader of logs counts: frames, what it passes over, what it rejects and why."""

from __future__ import annotations

from collections import Counter
from typing import Final

from imucald.core.errors import LogError

MAX_PROBLEMS: Final = 20
"""Texts kept: enough to see what is wrong, and bounded whatever the file holds."""


class ReadStatistics:
    """Counts over all files of one reader."""

    def __init__(self, strict: bool) -> None:
        """strict: raise LogError at the first rejection instead of counting it."""
        self.strict = strict
        self.frames_read = 0
        self.first_stamp: float | None = None
        """Time stamp of the first valid frame [s]."""
        self.ignored: Counter[str] = Counter()
        self.rejected: Counter[str] = Counter()
        self.problems: list[str] = []

    def reject(self, reason: str, text: str) -> None:
        """Count one rejection; `text` begins with its place. Raises LogError where strict."""
        if self.strict:
            raise LogError(text)
        self.rejected[reason] += 1
        if len(self.problems) < MAX_PROBLEMS:
            self.problems.append(text)

    def stamp(self, t: float) -> None:
        """Take note of a valid frame's time stamp [s]: the first one is kept."""
        if self.first_stamp is None:
            self.first_stamp = t

    def ignore(self, kind: str) -> None:
        """Count one valid frame that carries no data (remote, error) or is not for us (XL)."""
        self.frames_read += 1
        self.ignored[kind] += 1
