"""Unpack compressed logs (gzip, xz, bzip2, Zstandard) in pieces. Their first bytes show the
format."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO, Final, Protocol

from imucald.core.errors import LogError
from imucald.core.libraries import how_to_install

PLAIN_BYTES: Final = 1 << 20
"""Number of bytes that are unpacked in one step."""

DAMAGE: Final = (OSError, EOFError, zlib.error, ValueError)
"""Errors for damaged compressed data (bzip2: OSError; xz, Zstandard: converted to ValueError)."""


class ByteSource(Protocol):
    """An open source of bytes."""

    def read(self, size: int, /) -> bytes | None:
        """Read up to `size` bytes."""
        ...

    def readinto(self, buffer: Any, /) -> int | None:
        """Fill a buffer with the available bytes; return their number."""
        ...


class Member(Protocol):
    """The interface of all decompressors. Each unpacks one member; a file may have several."""

    @property
    def eof(self) -> bool:
        """True if the member has ended."""

    @property
    def unused_data(self) -> bytes:
        """The bytes after the end of the member."""

    @property
    def needs_input(self) -> bool:
        """True if more input is needed for more output."""

    def decompress(self, data: bytes, max_length: int, /) -> bytes:
        """Unpack `data`; return at most `max_length` bytes."""


class _Inner:
    _inner: Any

    @property
    def eof(self) -> bool:
        return bool(self._inner.eof)

    @property
    def unused_data(self) -> bytes:
        return bytes(self._inner.unused_data)


class _Zlib(_Inner):
    """A gzip member with the interface of the other modules' decompressors."""

    def __init__(self) -> None:
        # a gzip header with the largest window
        self._inner = zlib.decompressobj(31)

    @property
    def needs_input(self) -> bool:
        return not self._inner.unconsumed_tail

    def decompress(self, data: bytes, max_length: int, /) -> bytes:
        return bytes(self._inner.decompress(self._inner.unconsumed_tail + data, max_length))


def _bzip2() -> Member:
    import bz2  # noqa: PLC0415 - few logs need it

    return bz2.BZ2Decompressor()


def _xz() -> Member:
    import lzma  # noqa: PLC0415 - few logs need it

    return lzma.LZMADecompressor()


class _Zstd(_Inner):
    """A Zstandard frame with the interface of the other decompressors. One call returns all output
    of its input."""

    def __init__(self) -> None:
        try:
            import zstandard  # noqa: PLC0415 - an extra
        except ImportError:
            text = f"Zstandard (.zst): needs the package zstandard: {how_to_install('logs')}"
            raise LogError(text) from None
        self._inner = zstandard.ZstdDecompressor().decompressobj()
        self._made = self._given = b""

    @property
    def eof(self) -> bool:
        return super().eof and not self._made

    @property
    def unused_data(self) -> bytes:
        return super().unused_data + self._given

    @property
    def needs_input(self) -> bool:
        return not self._made and (not self._given or super().eof)

    def decompress(self, data: bytes, max_length: int, /) -> bytes:
        self._given += data
        while self._given and not self._made and not super().eof:
            piece, self._given = self._given[:_ZSTD_PIECE], self._given[_ZSTD_PIECE:]
            self._made = self._inner.decompress(piece)
        given, self._made = self._made[:max_length], self._made[max_length:]
        return given


_MEMBERS: Final[Mapping[bytes, Callable[[], Member]]] = {
    b"\x1f\x8b": _Zlib,
    b"\xfd7zXZ\0": _xz,
    b"BZh": _bzip2,
    b"\x28\xb5\x2f\xfd": _Zstd,
}
MAGIC_BYTES: Final = max(map(len, _MEMBERS))
"""Number of first bytes that identify compressed files."""
_ZSTD_PIECE: Final = 1 << 8
"""Number of input bytes per call of Zstandard. Zstandard returns the whole output of a call at
once: at most 8 MiB for this number of bytes."""
FREE_BYTES: Final = 64 << 20
"""Size up to which every file may unpack [bytes]."""
MOST_TIMES: Final = 1000
"""Above `FREE_BYTES`, a file may unpack to at most this many times its size. Real recordings are
far below because of the time stamps, even if all frames are equal."""
KEPT_SHARE: Final = 0.05
KEPT_BYTES: Final = 1 << 30
"""Temporary files leave KEPT_SHARE of the disk free, but not more than KEPT_BYTES [bytes]."""

MOST_OF_A_BYTE: Final = 1032
"""Largest number of bytes that deflate unpacks from one byte."""


class InPieces:
    """An open file for a reader of another library, which trusts the lengths stated in the file.

    Raises ValueError if the reader requests more than `FREE_BYTES` at once.
    """

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, size: int = -1) -> bytes:
        """Read up to `size` bytes; a negative size means all bytes."""
        if not 0 <= size <= FREE_BYTES:
            length = f"{size} bytes" if size > 0 else "all its bytes"
            raise ValueError(
                f"the file asks its reader for {length} at once; at most {FREE_BYTES >> 20} MiB "
                "are read at once"
            )
        return self._file.read(size)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def unpacks_to_too_much(file: Any, size: int) -> bool:
    """True if the next `size` bytes of an open file (zlib) unpack to more than `FREE_BYTES`. A
    reader of another library would unpack such a block as a whole."""
    if size * MOST_OF_A_BYTE <= FREE_BYTES:
        return False
    member, made, left = zlib.decompressobj(), 0, size
    try:
        while left > 0 and made <= FREE_BYTES and (data := file.read(min(left, _ZSTD_PIECE))):
            left -= len(data)
            made += len(member.decompress(data))
    except zlib.error:
        return False  # it is damaged; the reader reports this
    return made > FREE_BYTES


def _decompressed(member: Member, data: bytes, most: int) -> bytes:
    """Return at most so many unpacked bytes. Raises one of DAMAGE for damaged data."""
    try:
        return member.decompress(data, most)
    except (*DAMAGE, MemoryError):
        raise
    except Exception as error:  # lzma and zstandard have errors of their own
        raise ValueError(str(error)) from None


def packed_as(head: bytes) -> Callable[[], Member] | None:
    """Return the decompressor for a file with these first bytes; None if not compressed."""
    return next((m for magic, m in _MEMBERS.items() if head.startswith(magic)), None)


def plain_ending(path: Path) -> str:
    """Return the suffix of a file's name in lower case, without the suffix of its compression."""
    packed = path.suffix.lower() in (".gz", ".xz", ".bz2", ".zst")
    return Path(path.stem if packed else path.name).suffix.lower()


class Unpacked:
    """The unpacked bytes of a compressed file with one or more members. (The file classes of the
    standard modules read pieces that are too small.)"""

    def __init__(self, source: ByteSource, head: bytes, member: Callable[[], Member]) -> None:
        self.bytes_read = len(head)
        self._plain_bytes = 0
        self._source = source
        self._input = head
        self._new = member
        self._member = member()
        self._at_once = _ZSTD_PIECE if isinstance(self._member, _Zstd) else 1 << 18

    def readinto(self, view: memoryview) -> int:
        """Read the available bytes, up to the view's length. Return their number; 0 at the end.

        Raises one of DAMAGE for damaged data; EOFError if the file ends within a member.
        """
        while True:
            if self._member.eof:
                # Zeros after a member are padding of tapes and disks, as in the gzip module.
                self._input = self._member.unused_data.lstrip(b"\0") or self._more().lstrip(b"\0")
                if not self._input:
                    return 0
                self._member = self._new()
            elif self._member.needs_input and not self._input:
                self._input = self._more()
                if not self._input:
                    raise EOFError("the compressed file is cut")
            given, self._input = self._input, b""
            text = _decompressed(self._member, given, len(view))
            if text:
                view[: len(text)] = text
                self._plain_bytes += len(text)
                if self._plain_bytes > FREE_BYTES + MOST_TIMES * self.bytes_read:
                    raise ValueError(
                        f"its unpacked size would be more than {MOST_TIMES} times its "
                        "size: no recording can be compressed that much"
                    )
                return len(text)

    def _more(self) -> bytes:
        data = self._source.read(self._at_once) or b""
        self.bytes_read += len(data)
        return data


def damage_within(path: Path) -> str:
    """Return why a compressed file cannot be trusted; "" if it can, or if it is only cut.

    The file is unpacked once to check its checksum. The checksum is after the data, too late for a
    reader that uses the data at once. A source that can be read only once is not checked.
    """
    if not path.is_file():
        return ""
    try:
        with path.open("rb", buffering=0) as source:
            head = source.read(MAGIC_BYTES) or b""
            member = packed_as(head)
            if member is None:
                return ""
            stream, view = Unpacked(source, head, member), memoryview(bytearray(PLAIN_BYTES))
            while stream.readinto(view):
                pass
    except EOFError:
        return ""
    except DAMAGE as error:
        return str(error)
    return ""


def first_bytes(head: bytes, count: int) -> bytes:
    """Unpack the first bytes of a file from its beginning; empty if they are damaged."""
    member = packed_as(head)
    if member is None:
        return head[:count]
    try:
        return _decompressed(member(), head, count)
    except DAMAGE:
        return b""


@contextlib.contextmanager
def plain_file(path: Path) -> Iterator[tuple[Path, str]]:
    """Context that gives the path of an uncompressed file, and the reason if the file is cut, else
    "". A compressed file is unpacked to a temporary file.

    Raises LogError if the file cannot be opened.
    """
    try:
        source = path.open("rb", buffering=0)
    except OSError as error:
        raise LogError(f"{path}: cannot be opened: {error.strerror}") from error
    with source:
        head = source.read(MAGIC_BYTES) or b""
        member = packed_as(head)
        if member is None:
            yield path, ""
            return
        import tempfile  # noqa: PLC0415 - not needed for text logs

        with tempfile.NamedTemporaryFile(prefix="imucald-") as plain:
            damage = _unpack(Unpacked(source, head, member), plain, path)
            yield Path(plain.name), damage


def _unpack(stream: Unpacked, plain: Any, path: Path) -> str:
    view = memoryview(bytearray(PLAIN_BYTES))
    while True:
        try:
            count = stream.readinto(view)
        except DAMAGE as error:
            plain.flush()
            return str(error)
        try:
            if not count:
                plain.flush()
                return ""
            keep_disk_free(plain.name)
            plain.write(view[:count])
        except OSError as error:
            raise LogError(f"{path}: cannot be unpacked: {error.strerror or error}") from None


def keep_disk_free(path: str | os.PathLike[str]) -> None:
    """Raise OSError if a temporary file uses disk space that must stay free.

    All processes share the disk, so the limit holds for all of them together.
    """
    disk = shutil.disk_usage(path)
    kept = min(KEPT_SHARE * disk.total, KEPT_BYTES)
    if disk.free < kept:
        text = f"no space left for temporary files: {kept / 2**20:.0f} MiB of the disk stay free"
        raise OSError(errno.ENOSPC, text)
