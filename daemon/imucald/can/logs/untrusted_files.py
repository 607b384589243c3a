"""Check files before the reader of another library opens them: are they complete and safe?

MF4: for a cut file, asammdf only reports that it cannot seek. The compiled code of asammdf trusts
the stated position of a channel. A position outside the record makes it write to wrong memory, and
the process crashes later. A list that links back to itself causes an endless loop. So does a list
of data with several parts in an unfinished file. asammdf takes memory for the stated records,
whatever the length of their data.

Layout of ASAM MDF 4: an identification of 64 bytes, then blocks, each with its length and links to
other blocks. A file that its recorder did not finish (UnFinMF) does not state all lengths. Its
missing parts are not an error, but its unpacked size and the positions of its channels are checked.
asammdf counts the records of such a file itself.

BLF: python-can's reader does not report a cut file. Layout: Vector's "Binary Logging Format", as
python-can (can/io/blf.py) reads and writes it.

SQLite: a view, a virtual table or a generated column is computed while it is read. A file of 4 kB
can then produce endless rows, or one row of a gigabyte.
"""

from __future__ import annotations

import contextlib
import sqlite3
import struct
from pathlib import Path
from typing import Final, NamedTuple

from imucald.can.logs.unpacking import FREE_BYTES, MOST_TIMES, unpacks_to_too_much

_BLOCK: Final = struct.Struct("<4s4xQQ")
"""Kind, length, number of links; the links follow."""
_DEFLATED: Final = struct.Struct("<2sBxIQQ")
"""Data of a ##DZ block after its links: kind, method, parameter, unpacked bytes, packed bytes."""
_GROUP: Final = struct.Struct("<8xQH6xII")
"""Data of a ##CG block after its links: records, flags, bytes of a record, bytes of its
invalidation bits."""
_VLSD: Final = 1
"""Flag of a ##CG block: records of any length; the bytes of a record are those of all together."""
_UNFINISHED: Final = struct.Struct("<60xH")
"""Flags of the identification: what the recorder did not finish."""
_RECORDS_OPEN, _LENGTH_OPEN, _LIST_OPEN = 1, 4, 16
"""Flags: the records of groups are not counted; the length of the last data block is not stated;
the last part of a list of data is not complete."""
_CHANNEL: Final = struct.Struct("<3xBII")
"""Data of a ##CN block after its links: first bit, first byte, number of bits."""
_FIRST: Final = 64
MAX_BLOCKS: Final = 1_000_000
_OWN_LINKS: Final = {
    b"##HD": 5, b"##DG": 3, b"##CG": 2, b"##CN": 2, b"##CA": 1, b"##HL": 1, b"##DL": None,
    b"##LD": None, b"##FH": 1, b"##CH": 1, b"##AT": 1, b"##EV": 1,
}  # fmt: skip
"""Number of first links that point to parts of the block or to the next block; None: all links."""


class _ChannelGroup(NamedTuple):
    """A channel group: its links, stated records and flags."""

    following: int
    first_channel: int
    records: int
    flags: int
    record: int
    """Bytes of one record, with its invalidation bits."""


class _Structure:
    """The blocks of a file. Checks that no block is used twice, that channels fit the record and
    that records fit their data."""

    def __init__(self, unfinished: int) -> None:
        self._unfinished = unfinished
        self._placed, self._twice = {_FIRST}, 0
        self._data_groups: dict[int, tuple[int, int, int]] = {}  # group, data, bytes of record ids
        self._groups: dict[int, _ChannelGroup] = {}
        self._channels: dict[int, tuple[int, int, int]] = {}  # next, composition, end [bytes]
        self._lists: dict[int, tuple[int, ...]] = {}  # blocks of a list of data
        self._in_parts: set[int] = set()  # lists of data with a following part
        self._held: dict[int, int] = {}  # bytes of a data block, unpacked

    def register_block(
        self, at: int, kind: bytes, links: tuple[int, ...], data: bytes, length: int
    ) -> None:
        """Register a block; data: the first of its `length` bytes after its links."""
        for link in filter(None, links[: _OWN_LINKS.get(kind, 0)]):
            if link in self._placed:
                self._twice = self._twice or link
            self._placed.add(link)
        if kind == b"##DG" and len(links) > 2 and data:
            self._data_groups[at] = links[1], links[2], data[0]
        elif kind == b"##CG" and len(links) > 1 and len(data) >= _GROUP.size:
            records, flags, samples, invalidation = _GROUP.unpack_from(data)
            self._groups[at] = _ChannelGroup(
                links[0], links[1], records, flags, samples + invalidation
            )
        elif kind == b"##LD":
            # It leaves out the invalidation bits of valid records: no more bytes than samples.
            self._lists[at] = links + links[1:]
        elif kind in (b"##HL", b"##DL"):
            self._lists[at] = links[: _OWN_LINKS[kind]]
            if kind == b"##DL" and any(links[:1]):
                self._in_parts.add(at)
        elif kind == b"##DZ" and len(data) >= _DEFLATED.size:
            self._held[at] = _DEFLATED.unpack_from(data)[3]
        elif kind in (b"##DT", b"##DV", b"##DI"):
            self._held[at] = length
        elif kind == b"##CN" and len(links) > 1 and len(data) >= _CHANNEL.size:
            bit, byte, bits = _CHANNEL.unpack_from(data)
            self._channels[at] = links[0], links[1], byte + (bit + bits + 7) // 8

    def damage(self) -> str | None:
        """Return the damage in words, or None."""
        if self._twice:
            return f"the file is damaged: two links point to the block at byte {self._twice}"
        for group in self._groups.values():
            waiting, seen = [group.first_channel], set()
            while waiting:
                at = waiting.pop()
                if at in seen or at not in self._channels:
                    continue
                seen.add(at)
                following, composition, end = self._channels[at]
                if end > group.record:
                    return f"the file is damaged: a channel at byte {at} lies beyond its record"
                waiting += [following, composition]
        return next(filter(None, map(self._damage_of_records, self._data_groups)), None)

    def _damage_of_records(self, at: int) -> str | None:
        """Return why the records of a data group do not fit its data, or None."""
        first, data, id_bytes = self._data_groups[at]
        begins = {data, *self._lists.get(data, ())[:1]}  # the list, or the list of a header
        if self._unfinished & (_LENGTH_OPEN | _LIST_OPEN) and begins & self._in_parts:
            return f"it was not finished, and its list of data at byte {data} has several parts"
        if self._unfinished & _RECORDS_OPEN:
            return None
        held = self._bytes_held(data)
        stated, group = 0, self._groups.get(first)
        while group is not None:
            if not group.flags & _VLSD:
                stated += group.records * (id_bytes + group.record)
            group = self._groups.get(group.following)
        if stated > held or held > stated == 0:
            return (
                f"the file is damaged: the group at byte {at} states {stated} bytes of records, "
                f"but has {held} bytes of data"
            )
        return None

    def _bytes_held(self, at: int) -> int:
        """Return the unpacked bytes of a data block or of a list. No block is linked twice."""
        held, waiting = 0, [at]
        while waiting:
            at = waiting.pop()
            held += self._held.get(at, 0)
            waiting += self._lists.get(at, ())
        return held


def mf4_end(path: Path) -> str | None:
    """Return why an MF4 file is incomplete or unreadable; None if all linked blocks are there."""
    size = path.stat().st_size
    unpacked = 0
    with path.open("rb") as file:
        begins = file.read(_FIRST)
        is_finished = begins.startswith(b"MDF")
        if not is_finished and not begins.startswith(b"UnFinMF "):
            return None
        if size < _FIRST + _BLOCK.size:
            return "the file is cut within its header"
        (unfinished,) = _UNFINISHED.unpack_from(begins)
        structure = _Structure(unfinished)
        waiting, seen = [_FIRST], {0, _FIRST}
        while waiting and len(seen) < MAX_BLOCKS:
            at = waiting.pop()
            if at + _BLOCK.size > size:
                if is_finished:
                    return f"the file is cut: it has {size} bytes and names a block at byte {at}"
                continue
            file.seek(at)
            kind, length, count = _BLOCK.unpack(file.read(_BLOCK.size))
            if kind[:2] != b"##" or 8 * count > length:
                if is_finished:
                    return f"the file is damaged at byte {at}"
                continue
            if at + length > size and is_finished:
                return f"the file is cut: it has {size} of at least {at + length} bytes"
            named = file.read(8 * min(count, size // 8))
            links = struct.unpack(f"<{len(named) // 8}Q", named[: len(named) // 8 * 8])
            head = file.read(max(_DEFLATED.size, _GROUP.size))
            end = size if unfinished & _LENGTH_OPEN else min(at + length, size)
            length = max(end - file.tell() + len(head), 0)
            structure.register_block(at, kind, links, head, length)
            if kind == b"##DZ" and len(head) >= _DEFLATED.size:
                _, _, _, stated, packed = _DEFLATED.unpack_from(head)
                file.seek(at + _BLOCK.size + 8 * count + _DEFLATED.size)
                unpacked += stated
                if stated > FREE_BYTES or unpacks_to_too_much(file, min(packed, size)):
                    return (
                        f"the unpacked block at byte {at} would be larger than "
                        f"{FREE_BYTES >> 20} MiB"
                    )
                if unpacked > FREE_BYTES + MOST_TIMES * size:
                    return f"its unpacked blocks would be larger than {MOST_TIMES} times the file"
            waiting += [link for link in links if link not in seen]
            seen.update(links)
    return f"it names more than {MAX_BLOCKS} blocks" if waiting else structure.damage()


_FILE_HEADER: Final = struct.Struct("<4sLBBBBBBBBQQ")
"""Signature, size of the header, application, version, ..., size of the file, size unpacked."""
_OBJECT: Final = struct.Struct("<4sHHLL")
"""Signature, size of the header, its version, size of the object, kind."""
_CONTAINER_HEAD: Final = struct.Struct("<H14x")
"""The compression of a container; its contents follow."""


def blf_faults(path: Path) -> tuple[str | None, str | None]:
    """Return why a BLF file must not be read, and why it is incomplete; None if not."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_FILE_HEADER.size)
        if len(header) < _FILE_HEADER.size:
            return None, "the file is cut within its header"
        _, at, *_, stated, _ = _FILE_HEADER.unpack(header)
        if at > size:
            return None, "the file is cut within its header"
        end = f"the file is cut: it has {size} of {stated} bytes" if stated > size else None
        while at < size:
            file.seek(at)
            begin = file.read(_OBJECT.size)
            if len(begin) < _OBJECT.size:
                break
            signature, _, _, length, kind = _OBJECT.unpack(begin)
            if signature != b"LOBJ" or length < _OBJECT.size:
                return None, end or f"the file is damaged at byte {at}"
            head = file.read(_CONTAINER_HEAD.size) if kind == 10 else b""
            packed = length - _OBJECT.size - _CONTAINER_HEAD.size
            if head[:1] == b"\x02" and unpacks_to_too_much(file, packed):
                return (
                    f"the unpacked container at byte {at} would be larger than "
                    f"{FREE_BYTES >> 20} MiB, as no recording does"
                ), end
            if at + length > size:
                break
            at += length + length % 4
        else:
            return None, end
    if 0 <= size - at < 4:  # python-can may omit the padding after the last object
        return None, end
    return None, end or f"the file is cut: it ends within the block at byte {at}"


def why_not_stored(path: Path) -> str | None:
    """Return why the messages cannot be read. None if they are a plain table. Missing parts also
    give None, because the reader reports them."""
    with contextlib.closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True)) as db:
        try:
            found = db.execute(
                "SELECT type, sql FROM sqlite_master WHERE lower(name) = ?", ("messages",)
            ).fetchall()
            kinds = [kind for kind, _ in found if kind in ("table", "view")]
            if not kinds:
                return None
            is_virtual = any(str(sql).upper().startswith("CREATE VIRTUAL") for _, sql in found)
            if kinds != ["table"] or is_virtual:
                return "'messages' is not a plain table"
            columns = db.execute("PRAGMA table_xinfo(messages)").fetchall()
        except sqlite3.Error as error:
            return str(error)
    computed = [str(name) for _, name, *_, hidden in columns if hidden]
    return "'messages' has generated columns" if computed else None
