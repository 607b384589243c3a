"""Keeps the number of wrong keys in a row over restarts, so that a restart gives no new attempts.

A missing file counts as no wrong key. An invalid file counts as one wrong key, which costs the
delay.
"""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Final

from imucald.core.files import free_name, read_regular, split_checksum, with_checksum, write_file
from imucald.service.background_writer import Say, StateWriter
from imucald.service.journal import WARNING

MAGIC: Final = "imucald-keys 1"
MAX_BYTES: Final = 256
MAX_WRONG: Final = 255
CLOSE_WAIT_S: Final = 0.2
"""Longest wait for the disk at a stop [s]."""


class AttemptStore:
    """The file of one daemon. path: None saves nothing.

    say: function that takes a log line and its priority.
    """

    def __init__(self, path: Path | None, say: Say) -> None:
        self.wrong = 0
        """Wrong keys in a row, as saved."""
        self._writer: StateWriter[bytes] | None = None
        if path is not None:
            self.wrong = _read(path, say)
            title = f"the count of wrong keys in {path.parent}"
            self._writer = StateWriter(lambda data: write_file(path, data), title, say)

    def put(self, wrong: int) -> None:
        """Request that another number is saved; never waits for the disk."""
        self.wrong = wrong
        if self._writer is not None:
            body = json.dumps({"wrong": min(wrong, MAX_WRONG)}).encode()
            self._writer.put(with_checksum(MAGIC, body))
            self._writer.report()

    def close(self) -> None:
        """Write pending data. The method waits for the disk, but not for long."""
        if self._writer is not None:
            self._writer.close(CLOSE_WAIT_S)
            self._writer.report()


def _read(path: Path, say: Say) -> int:
    try:
        data = read_regular(path, MAX_BYTES)
    except FileNotFoundError:
        return 0
    except OSError as error:
        say(
            f"the count of wrong keys in {path} cannot be read: {error.strerror}; one "
            "wrong key is assumed",
            WARNING,
        )
        return 1
    title, body, is_right = split_checksum(data)
    with contextlib.suppress(ValueError, RecursionError, TypeError, KeyError):
        wrong = json.loads(body)["wrong"] if is_right and title == MAGIC.encode() else None
        if type(wrong) is int and 0 <= wrong <= MAX_WRONG:
            return wrong
    aside = free_name(path, "corrupt")
    with contextlib.suppress(OSError):
        path.rename(aside)
    say(
        f"the count of wrong keys in {path} is damaged. The file is renamed to "
        f"{aside.name}; one wrong key is assumed",
        WARNING,
    )
    return 1
