"""Write small files completely or not at all, check them with a checksum, and read files of other
users safely.

A file with a checksum consists of one line of text (its kind, then the SHA-256 of the rest) and a
body of bytes. A power cut cannot damage such a file. When a file of another user is read, pipes and
devices are refused, and no more bytes are read than requested. SHA-256 comes from the interpreter's
own module: `hashlib` would load OpenSSL, which costs 3 ms and 3.6 MiB of the 50 MiB that a daemon
may use.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from pathlib import Path

UNFINISHED = ".tmp"
"""Suffix of a file that is being written."""
FOLDER = "folder"
"""Word in the new name of a folder that had the name of a file and was renamed."""
MAX_ASIDE = 8
"""Largest number of renamed files with the same name and word. The next renamed file replaces the
oldest."""


def write_file(path: Path, data: bytes, mode: int | None = None) -> None:
    """Replace a file safely.

    The new file is written to the folder of the old file, forced to the disk, and renamed. The
    folder is forced to the disk too. At every instant, the complete old file or the complete new
    file exists. Raises OSError if a step fails; the old file is then unchanged. mode: permissions
    of the new file; None means the default for new files.
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
    """Rename a completely written file to its final name. A folder with this name is renamed first.

    Raises OSError if renaming fails; the written file is then removed.
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
    """Write the replacement of a file with another name, and force it to the disk. Return the path
    of the replacement."""
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
    """Split the bytes of a file. Return title, body, and whether the checksum matches the body."""
    head, _, body = data.partition(b"\n")
    title, _, checksum = head.rpartition(b" ")
    return title, body, checksum == sha256(body).hexdigest().encode()


def free_name(path: Path, word: str) -> Path:
    """Return the new path for a file that is renamed and kept: a free name in its folder, or the
    name of the oldest renamed file."""
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
"""Flags for opening files that exist only on some systems (O_BINARY on Windows)."""


def read_regular(path: Path, max_bytes: int) -> bytes:
    """Return the bytes of a file. A result of `max_bytes` + 1 bytes means that the file is too
    long.

    Raises OSError if the file cannot be read or is not a regular file. The function never waits for
    the writer of a pipe, and never reads `/dev/zero` without end.
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
