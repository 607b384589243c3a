"""Small files: written completely or not at all, read with a checksum; files of other users read
safely.

An atomic file is one line of text (its kind, then the SHA-256 of the rest) and a body of bytes. A
power cut cannot damage it. When a file of another user is read, pipes and devices are refused, and
no more bytes are read than requested. SHA-256 comes from the interpreter's own module: `hashlib`
would load OpenSSL, which costs 3 ms and 3.6 MiB of the 50 MiB that a daemon may use.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from pathlib import Path

UNFINISHED = ".tmp"
"""Ending of a file that is being written."""
FOLDER = "folder"
"""Part of the name of a folder that was in the place of a file and was set aside."""
MAX_ASIDE = 8
"""Largest number of files set aside under one name and word; the next replaces the oldest."""


def write_file(path: Path, data: bytes, mode: int | None = None) -> None:
    """Replace a file by one that is safely on the disk.

    Raises OSError if that fails; nothing is lost then.

    mode: its permissions, if they differ from those of new files.

    The new file is written to the folder of the old one, forced to the disk, and renamed. The
    folder is forced to the disk too. At every instant the file is the old one or the new one.
    """
    unfinished = write_beside(path, data)
    if mode is not None:
        try:
            unfinished.chmod(mode)
        except OSError:
            _remove(unfinished)
            raise
    put_in_place(unfinished, path)
    sync_folder(path.parent)


def put_in_place(unfinished: Path, path: Path) -> None:
    """Give a finished file its final name; a folder of that name is set aside.

    Raises OSError if that fails; the unfinished file is then removed.
    """
    try:
        try:
            unfinished.replace(path)
        except IsADirectoryError:  # a folder would block the name for ever
            path.rename(free_name(path, FOLDER))
            unfinished.replace(path)
    except OSError:
        _remove(unfinished)
        raise


def write_beside(path: Path, data: bytes) -> Path:
    """Write the replacement of a file and force it to the disk; return its path."""
    unfinished = path.with_name(path.name + UNFINISHED)
    path.parent.mkdir(parents=True, exist_ok=True)
    _remove(unfinished)  # a left-over, or a link that somebody put there
    if unfinished.is_dir():
        unfinished.rename(free_name(unfinished, FOLDER))
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(unfinished, flags, 0o666), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
    except OSError:
        _remove(unfinished)  # ours; on a full disk it would stay in the way
        raise
    return unfinished


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        path.unlink()


def with_checksum(title: str, body: bytes) -> bytes:
    """Return the bytes of a file: title (one line of ASCII) and SHA-256, then the body."""
    return f"{title} {sha256(body).hexdigest()}\n".encode() + body


def split_checksum(data: bytes) -> tuple[bytes, bytes, bool]:
    """Return title, body, and whether the checksum matches the body."""
    head, _, body = data.partition(b"\n")
    title, _, checksum = head.rpartition(b" ")
    return title, body, checksum == sha256(body).hexdigest().encode()


def free_name(path: Path, word: str) -> Path:
    """Return a name in the file's folder for something set aside: a free one, or the oldest's."""
    names = [path.with_name(f"{path.name}.{word}.{n}") for n in range(1, MAX_ASIDE + 1)]
    ages = {}
    for name in names:
        try:
            ages[name] = name.lstat().st_mtime_ns
        except OSError:
            return name
    return min(names, key=lambda name: ages[name])


def sync_folder(folder: Path) -> None:
    """Force a rename to the disk, if the file system supports it."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))
"""Flags that exist only on some systems: the last one on Windows."""


def read_regular(path: Path, max_bytes: int) -> bytes:
    """Return a file's bytes, at most one more than `max_bytes`: then the file is too long.

    Raises OSError if it cannot be read or is no regular file. The function does not wait for the
    writer of a pipe, and stops reading `/dev/zero`.
    """
    # The check comes before opening, because opening a device may have effects.
    _refuse_other(path, path.stat())
    descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    with os.fdopen(descriptor, "rb") as file:
        _refuse_other(path, os.fstat(descriptor))  # check the opened file: it may have been renamed
        return file.read(max_bytes + 1)


def _refuse_other(path: Path, found: os.stat_result) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(
            errno.EINVAL, "is a pipe, a device or a socket, not a regular file", str(path)
        )


try:
    from _sha256 import sha256  # type: ignore[import-not-found,unused-ignore]
except ImportError:  # its name from Python 3.12 on
    try:
        from _sha2 import sha256  # type: ignore[import-not-found,unused-ignore]
    except ImportError:
        from hashlib import sha256

__all__ = ["sha256"]
