"""Files of strangers, read whole: a pipe or a device is none, and no more is read than is asked."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))
"""Each is of some systems: the last of Windows."""


def read_regular(path: Path, max_bytes: int) -> bytes:
    """Return a file's bytes, one more than `max_bytes` at most: then it is too long.

    OSError where it cannot be read or is no regular file; a pipe without a writer is not waited
    for, and `/dev/zero` has an end.
    """
    # looked at before it is opened: opening a device may do things
    _refuse_other(path, path.stat())
    descriptor = os.open(path, os.O_RDONLY | _FLAGS)
    with os.fdopen(descriptor, "rb") as file:
        _refuse_other(path, os.fstat(descriptor))  # what was opened, whoever renames meanwhile
        return file.read(max_bytes + 1)


def _refuse_other(path: Path, found: os.stat_result) -> None:
    if stat.S_ISDIR(found.st_mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(found.st_mode):
        raise OSError(errno.EINVAL, "is a pipe, a device or a socket, no regular file", str(path))
