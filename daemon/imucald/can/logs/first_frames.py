"""What the first frames of a recording's files show: the same file twice."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from imucald.can.columns import FrameColumns
from imucald.can.logs.text_blocks import OpenLog, is_read_once
from imucald.core.errors import LogError

MIN_FRAMES: Final = 64
"""Fewer frames show nothing. So many with the same times and payloads, noise of sensors among them,
are never recorded twice."""

Log = Path | str | OpenLog


def refuse_same_files(paths: Iterable[Log]) -> None:
    """Raise LogError where a file is named twice: the same evidence would count twice."""
    seen: dict[tuple[int, int], Log] = {}
    for path in paths:
        if isinstance(path, OpenLog) or is_read_once(path):
            continue
        try:
            found = os.stat(path)  # noqa: PTH116 - a name or a path
        except OSError:
            continue  # whoever opens it says why
        key = found.st_dev, found.st_ino
        if key in seen:
            raise _same(path, seen[key])
        seen[key] = path


class FirstFrames:
    """Takes the first chunk of each file of a recording."""

    def __init__(self) -> None:
        self._seen: dict[bytes, Log] = {}

    def take(self, path: Log, frames: FrameColumns) -> None:
        """Raise LogError where an earlier file began with the same frames at the same times."""
        if len(frames) < MIN_FRAMES:
            return
        first = frames.take(slice(0, MIN_FRAMES))
        key = b"".join(column.tobytes() for column in (first.t, first.can_id, first.data))
        if key in self._seen:
            raise _same(path, self._seen[key])
        self._seen[key] = path


def _same(path: Log, other: Log) -> LogError:
    return LogError(f"{path}: is the same recording as {other}: its evidence would count twice")
