"""Read a text (plain or compressed, file or standard input) as complete lines in bounded memory."""

from __future__ import annotations

import io
import stat
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import Final, cast

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.logs.unpacking import (
    DAMAGE,
    MAGIC_BYTES,
    ByteSource,
    Unpacked,
    packed_as,
)
from imucald.core.errors import LogError

Bytes = NDArray[np.uint8]

BLOCK_BYTES: Final = 1 << 20
"""Size of a block of text [bytes]. The arrays made from it fit the processor's caches."""

STDIN: Final = "-"


class OpenLog(Struct, frozen=True):
    """A log that the caller has opened and will close. name: for messages, and for its suffix."""

    source: ByteSource
    name: str

    def __str__(self) -> str:
        return self.name


def folder_error(path: object) -> LogError:
    """Return the error for a folder that is given instead of a log."""
    return LogError(f"{path}: this is a folder; name one of its logs")


def open_source(path: Path | str | OpenLog) -> AbstractContextManager[ByteSource]:
    """Open a file, or standard input for "-". Raises LogError."""
    if isinstance(path, OpenLog):
        return nullcontext(path.source)
    if str(path) == STDIN:
        return nullcontext(cast(ByteSource, sys.stdin.buffer))
    try:
        return Path(path).open("rb", buffering=0)
    except IsADirectoryError:
        raise folder_error(path) from None
    except OSError as error:
        raise LogError(f"{path}: cannot be opened: {error.strerror}") from error


class _Headed:
    """An open source whose first bytes were already read."""

    def __init__(self, source: ByteSource, head: bytes) -> None:
        self.bytes_read = len(head)
        self._source, self._head = source, head

    def read(self, size: int, /) -> bytes | None:
        """Read up to `size` bytes."""
        if not self._head:
            return self._source.read(size)
        given, self._head = self._head[:size], self._head[size:]
        return given

    def readinto(self, buffer: memoryview, /) -> int:
        """Fill a buffer with the available bytes; return their number; 0 at the end."""
        if given := self._head[: len(buffer)]:
            buffer[: len(given)] = given
            self._head = self._head[len(given) :]
            return len(given)
        count = self._source.readinto(buffer) or 0
        self.bytes_read += count
        return count


@contextmanager
def looked_at(
    path: Path | str | OpenLog,
) -> Iterator[tuple[bytes, Path | str | OpenLog]]:
    """Return the first stored bytes of a log, and the source to read instead of it.

    A source that can be read only once (a pipe, standard input) is returned open, because a second
    opening would lack its beginning. The source is closed at the end of the context. An open log is
    read once for its first bytes, because waiting for more bytes could take forever. Raises
    LogError if the log cannot be opened.
    """
    with open_source(path) as opened:
        source: ByteSource = opened
        if once := not isinstance(path, OpenLog) and is_read_once(path):
            # a pipe may deliver its first bytes in pieces: a buffer collects them
            source = io.BufferedReader(opened) if isinstance(opened, io.FileIO) else opened
        try:
            head = source.read(1 << 14) or b""
        except OSError as error:
            raise LogError(f"{path}: cannot be read: {error.strerror}") from error
        if once or isinstance(path, OpenLog):
            yield head, OpenLog(_Headed(source, head), str(path))
        else:
            yield head, path


def is_read_once(path: Path | str) -> bool:
    """True if a path is a pipe, a device or standard input."""
    if str(path) == STDIN:
        return True
    try:
        return not stat.S_ISREG(Path(path).stat().st_mode)
    except OSError:
        return False


class TextBlocks:
    """Iterate over the blocks of a text. Afterwards, `rest` and `damage` show how it ended."""

    def __init__(self, source: ByteSource, padding: int, longest_line: int) -> None:
        """Prepare reading. padding: free bytes after each block. longest_line: see `__iter__`."""
        self.rest = b""
        """The last line, if it has no newline."""
        self.damage = ""
        """Why reading stopped before the end of the file; empty if it did not."""
        self._longest = longest_line
        self._store = bytearray(BLOCK_BYTES + padding)
        self._view = memoryview(self._store)[:BLOCK_BYTES]
        self._filled = 0
        head = b""
        while len(head) < MAGIC_BYTES and (more := source.read(MAGIC_BYTES - len(head))):
            head += more  # a pipe may return less than requested
        member = packed_as(head)
        self._stream = _Headed(source, head) if member is None else Unpacked(source, head, member)

    @property
    def bytes_read(self) -> int:
        """Return the number of stored bytes of the file that have been read."""
        return self._stream.bytes_read

    def __iter__(self) -> Iterator[tuple[Bytes, int]]:
        """Yield (buffer, size) with complete lines. The bytes are valid until the next block.

        A line longer than `longest_line` may lose bytes after that length, so that memory is
        bounded. The shortened line is still longer than `longest_line`.
        """
        buf = np.frombuffer(self._store, np.uint8)
        while self._fill():
            end = self._store.rfind(b"\n", 0, self._filled) + 1
            if end:
                yield buf, end
            self._view[: self._filled - end] = bytes(self._view[end : self._filled])
            self._filled -= end
            if not end:
                self._filled = min(self._filled, self._longest + 1)
        self.rest = bytes(self._view[: self._filled])

    def _fill(self) -> bool:
        """Read until the block is full or the text ends. Return whether any bytes were read."""
        before = self._filled
        try:
            while self._filled < BLOCK_BYTES:
                count = self._stream.readinto(self._view[self._filled :])
                if not count:
                    break
                self._filled += count
        except DAMAGE as error:
            self.damage = str(error)
        return self._filled > before
