"""A text file, plain or gzip, or standard input, as blocks of whole lines in bounded memory."""

from __future__ import annotations

import sys
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol, cast

import numpy as np

from imucald.can.logs.ascii_columns import Bytes
from imucald.core.errors import LogError

BLOCK_BYTES: Final = 1 << 20
"""Text read at once: the arrays made of it stay within a core's caches."""

COMPRESSED_BYTES: Final = 1 << 18
"""Compressed bytes read at once."""

GZIP_MAGIC: Final = b"\x1f\x8b"
_GZIP_FORMAT: Final = 31
"""What zlib calls a gzip header with the largest window."""

STDIN: Final = "-"


class ByteSource(Protocol):
    """Something open that gives bytes."""

    def read(self, size: int, /) -> bytes | None:
        """Read up to so many bytes."""
        ...

    def readinto(self, buffer: Any, /) -> int | None:
        """Fill a buffer as far as bytes are there."""
        ...


@dataclass(frozen=True)
class OpenLog:
    """A log that somebody else has opened, and closes; name: for messages, and its ending."""

    source: ByteSource
    name: str

    def __str__(self) -> str:
        return self.name


def open_source(path: Path | str | OpenLog) -> AbstractContextManager[ByteSource]:
    """Open a file, or standard input for "-". Raises LogError."""
    if isinstance(path, OpenLog):
        return nullcontext(path.source)
    if str(path) == STDIN:
        return nullcontext(cast(ByteSource, sys.stdin.buffer))
    try:
        return Path(path).open("rb", buffering=0)
    except OSError as error:
        raise LogError(f"{path}: cannot be opened: {error.strerror}") from error


class _Plain:
    """Bytes as they are, after those already read to know the format."""

    def __init__(self, source: ByteSource, head: bytes) -> None:
        self.bytes_read = len(head)
        self._source = source
        self._head = head

    def readinto(self, view: memoryview) -> int:
        """Read what there is, up to the view's length; 0 at the end."""
        if self._head:
            count = len(self._head)
            view[:count] = self._head
            self._head = b""
            return count
        count = self._source.readinto(view) or 0
        self.bytes_read += count
        return count


class _Inflated:
    """Bytes of a gzip file of one or more members (the gzip module reads in small pieces)."""

    def __init__(self, source: ByteSource, head: bytes) -> None:
        self.bytes_read = len(head)
        self._source = source
        self._input = head
        self._member = zlib.decompressobj(_GZIP_FORMAT)

    def readinto(self, view: memoryview) -> int:
        """Read what there is, up to the view's length; 0 at the end.

        Raises EOFError where the file ends within a member, zlib.error where it is damaged.
        """
        while True:
            if self._member.eof:
                # Zeros behind a member are padding of tapes and disks, as for the gzip module.
                self._input = self._member.unused_data.lstrip(b"\0") or self._more().lstrip(b"\0")
                if not self._input:
                    return 0
                self._member = zlib.decompressobj(_GZIP_FORMAT)
            elif not self._input:
                self._input = self._more()
                if not self._input:
                    raise EOFError("the compressed file is cut")
            text = self._member.decompress(self._input, len(view))
            self._input = self._member.unconsumed_tail
            if text:
                view[: len(text)] = text
                return len(text)

    def _more(self) -> bytes:
        data = self._source.read(COMPRESSED_BYTES) or b""
        self.bytes_read += len(data)
        return data


class TextBlocks:
    """Iterate over the blocks of a text; afterwards `rest` and `damage` say how it ended."""

    def __init__(self, source: ByteSource, padding: int, longest_line: int) -> None:
        """padding: bytes kept free behind each block. longest_line: see `__iter__`."""
        self.rest = b""
        """The last line where it has no newline."""
        self.damage = ""
        """Why reading stopped before the end of the file, if it did."""
        self._longest = longest_line
        self._store = bytearray(BLOCK_BYTES + padding)
        self._view = memoryview(self._store)[:BLOCK_BYTES]
        self._filled = 0
        head = source.read(1) or b""
        head += source.read(1) or b""  # one by one: a pipe may give less than asked for
        self._stream = (_Inflated if head == GZIP_MAGIC else _Plain)(source, head)

    @property
    def bytes_read(self) -> int:
        """Return how much of the file (as it is stored) has been read."""
        return self._stream.bytes_read

    def __iter__(self) -> Iterator[tuple[Bytes, int]]:
        """Yield (buffer, size): whole lines, valid until the next block is asked for.

        A line longer than `longest_line` may lose bytes behind that length, so that memory stays
        bounded, but it remains one line and too long.
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
        """Read until the block is full or the text ends; say whether anything came."""
        before = self._filled
        try:
            while self._filled < BLOCK_BYTES:
                count = self._stream.readinto(self._view[self._filled :])
                if not count:
                    break
                self._filled += count
        except (OSError, EOFError, zlib.error) as error:
            self.damage = str(error)
        return self._filled > before
