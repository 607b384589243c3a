"""One daemon on one state folder: two would write into one another's files."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from imucald.core.errors import ImucaldError

LOCK_FILE = ".lock"


class FolderInUseError(ImucaldError):
    """Another process keeps its state in the folder."""


class FolderLock:
    """Holds a folder until `release`, or until the process ends, however it does.

    Raises FolderInUseError with the holder's pid; OSError where the folder takes no file.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        self._file = os.open(folder / LOCK_FILE, flags, 0o600)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.ftruncate(self._file, 0)
            os.pwrite(self._file, f"{os.getpid()}\n".encode(), 0)
        except BlockingIOError:
            holder = os.pread(self._file, 20, 0).decode("ascii", "replace").strip()
            os.close(self._file)
            text = f"{folder} is in use by process {holder or '?'}; see --state-dir"
            raise FolderInUseError(text) from None
        except OSError:
            os.close(self._file)
            raise

    def release(self) -> None:
        """Let others have the folder."""
        os.close(self._file)
