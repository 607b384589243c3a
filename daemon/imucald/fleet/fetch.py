"""Provide a log as a local file: the file itself if it is local, else a temporary copy."""

from __future__ import annotations

import contextlib
import hashlib
import os
import stat
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import fsspec

from imucald.can.logs.unpacking import keep_disk_free
from imucald.core.errors import ImucaldError
from imucald.fleet.bundle import KEY_DIGITS

BLOCK = 2**20
TRIES = 3
WAIT_S = 0.5
"""Pause before the second attempt [s]. The pause doubles before each further attempt."""
MAX_BYTES = 64 * 2**30
"""Largest size of a copied log [bytes], so that a wrong address does not fill the disk."""
LOCAL = ("file", "local")


class StorageError(ImucaldError):
    """A log could not be fetched. The text states the reason and the address."""


class NoRegularFileError(ImucaldError):
    """The path of a log is not a regular file but a pipe, a device or a folder."""


def protocol_of(url: str) -> str:
    """Return the protocol of a URL; "file" if it has none."""
    return url.partition("://")[0] if "://" in url else "file"


def bare_path(url: str) -> str:
    """Return the path of a local URL."""
    return url.partition("://")[2] if "://" in url else url


def file_system(url: str, storage: Mapping[str, Mapping[str, Any]]) -> fsspec.AbstractFileSystem:
    """Return the file system of a URL. Raises StorageError if the Python package for its protocol
    is missing."""
    protocol = protocol_of(url)
    try:
        return fsspec.filesystem(protocol, **storage.get(protocol, {}))
    except Exception as error:  # each storage has its own errors
        raise StorageError(f"{url}: {error}") from None


@contextlib.contextmanager
def local_copy(
    url: str, storage: Mapping[str, Mapping[str, Any]], within: str | None = None
) -> Iterator[tuple[Path, str]]:
    """Yield path and key (hash of the content) of a log.

    within: folder that must contain a local log after links are followed. Raises NoRegularFileError
    if the log is not a regular file, or if a link leads out of the folder. Raises StorageError if
    the log cannot be fetched.
    """
    with tempfile.TemporaryDirectory(prefix="imucald-log-") as folder:
        path = Path(folder) / url.rpartition("/")[2]
        if protocol_of(url) not in LOCAL:
            yield path, _downloaded(url, storage, path)
            return
        with _opened(Path(bare_path(url)), within) as file:
            path.symlink_to(_held(file))
            yield path, _hash(file, None)


def _held(file: IO[bytes]) -> str:
    """Return a path to an open file. The path stays valid even if another file gets the name of
    this file."""
    return f"/proc/{os.getpid()}/fd/{file.fileno()}"


def _opened(path: Path, within: str | None) -> IO[bytes]:
    """Open a local log. Links out of the folder are refused, so that a supplier of logs cannot get
    access to other files."""
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise NoRegularFileError(
                f"{path}: this is a pipe, a device or a folder, not a regular file"
            )
        file = os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb")
    except OSError as error:
        raise StorageError(f"{path}: cannot be read: {error.strerror or error}") from None
    found = Path(os.path.realpath(_held(file)))
    if within is not None and not found.is_relative_to(os.path.realpath(within)):
        file.close()
        text = f"{path}: this link points outside {within}; put the log there, or list its path"
        raise NoRegularFileError(text)
    return file


def _hash(source: IO[bytes], target: IO[bytes] | None) -> str:
    digest, size = hashlib.sha256(), 0
    while block := source.read(BLOCK):
        digest.update(block)
        size += len(block)
        if target is not None:
            keep_disk_free(target.name)
            target.write(block)
            if size > MAX_BYTES:
                raise OSError(f"is longer than {MAX_BYTES} bytes")
    return digest.hexdigest()[:KEY_DIGITS]


def _downloaded(url: str, storage: Mapping[str, Mapping[str, Any]], path: Path) -> str:
    system = file_system(url, storage)
    for left in reversed(range(TRIES)):
        try:
            with system.open(url, "rb") as source, path.open("wb") as target:
                return _hash(source, target)
        except Exception as error:  # each storage has its own errors
            if left == 0 or isinstance(error, FileNotFoundError):
                text = f"{url}: cannot be fetched: {type(error).__name__}: {error}"
                raise StorageError(text) from None
            time.sleep(WAIT_S * 2 ** (TRIES - 1 - left))
    raise AssertionError("the last try returns or raises")
