"""The lock of a folder with saved state, so that two daemons never overwrite each other's files."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path

from imucald.core.errors import ImucaldError

LOCK_FILE = ".lock"


class FolderInUseError(ImucaldError):
    """Another process uses the folder for its state."""


class FolderLock:
    """Locks a folder until `release`, or until the process ends in any way.

    The folder itself is locked, which also works for a read-only folder. A file in the folder is
    locked too. The file contains the process id of the holder, and it replaces the folder's lock on
    file systems that cannot lock folders. Raises FolderInUseError with this process id. Raises
    OSError if neither the folder nor the file can be locked.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder
        self._held: list[int] = []
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            self._take()
        except BaseException:
            self.release()
            raise

    def _take(self) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
        no_lock: OSError | None = None
        try:
            fcntl.flock(self._folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise self._in_use() from None
        except OSError as error:
            no_lock = error
        try:
            file = os.open(self._path / LOCK_FILE, flags, 0o600)
        except OSError:
            if no_lock is not None:
                raise
            return
        self._held.append(file)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise self._in_use() from None
        with contextlib.suppress(OSError):  # a full disk
            os.ftruncate(file, 0)
            os.pwrite(file, f"{os.getpid()}\n".encode(), 0)

    def _in_use(self) -> FolderInUseError:
        holder = ""
        with contextlib.suppress(OSError):
            flags = os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK
            with os.fdopen(os.open(self._path / LOCK_FILE, flags), "rb") as file:
                holder = (file.read(20) or b"").decode("ascii", "replace").strip()
        return FolderInUseError(
            f"{self._path} is in use by process {holder or '?'}; name another folder with "
            "--state-dir"
        )

    def renew(self) -> bool:
        """Lock again if another folder now has the same path. Return whether a new lock was
        necessary. Raises the errors of the constructor; FolderInUseError means that another process
        was faster.
        """
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(self._path.stat(), os.fstat(self._folder)):
                return False
        now = FolderLock(self._path)
        self.release()
        self._folder, self._held = now._folder, now._held
        return True

    def release(self) -> None:
        """Release the lock of the folder."""
        for descriptor in (self._folder, *self._held):
            os.close(descriptor)
        self._held = []
