"""Small files that a power cut cannot spoil: written whole or not at all, read with a checksum.

A file is one line of text (what it is, then the SHA-256 of the rest) and a body of bytes.
"""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

from imucald.core.digest import sha256


def write_file(path: Path, data: bytes) -> None:
    """Replace a file by one that is on the disk; OSError where that fails (nothing is lost then).

    Written beside it, forced to the disk, renamed, the folder forced too: at every instant the
    file is the old one or the new one.
    """
    temporary = path.with_name(path.name + ".tmp")
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            temporary.unlink()  # ours, and unfinished; on a full disk it would stay in the way
        raise
    sync_folder(path.parent)


def with_checksum(title: str, body: bytes) -> bytes:
    """Return the bytes of a file: title (one line of ASCII) and SHA-256, then the body."""
    return f"{title} {sha256(body).hexdigest()}\n".encode() + body


def split_checksum(data: bytes) -> tuple[bytes, bytes, bool]:
    """Return title, body, and whether the checksum is that of the body."""
    head, _, body = data.partition(b"\n")
    title, _, checksum = head.rpartition(b" ")
    return title, body, checksum == sha256(body).hexdigest().encode()


def free_name(path: Path, word: str) -> Path:
    """Return a name beside the file that none has yet: what is set aside replaces nothing."""
    number = 1
    while (target := path.with_name(f"{path.name}.{word}.{number}")).exists():
        number += 1
    return target


def sync_folder(folder: Path) -> None:
    """Force a rename to the disk, where the file system knows how."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
