"""Check whether an MF4 file is complete and safe for asammdf, before asammdf opens it.

For a cut file, asammdf only reports that it cannot seek. The compiled code of asammdf trusts the
stated position of a channel. A position outside the record makes it write to wrong memory, and the
process crashes later. A list that links back to itself causes an endless loop.

Layout of ASAM MDF 4: an identification of 64 bytes, then blocks, each with its length and links to
other blocks. A file that its recorder did not finish (UnFinMF) does not state all lengths. Its
missing parts are not an error, but its unpacked size and the positions of its channels are checked.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

from imucald.can.logs.unpacking import FREE_BYTES, MOST_TIMES, unpacks_to_too_much

_BLOCK: Final = struct.Struct("<4s4xQQ")
"""Kind, length, number of links; the links follow."""
_DEFLATED: Final = struct.Struct("<2sBxIQQ")
"""Data of a ##DZ block after its links: kind, method, parameter, unpacked bytes, packed bytes."""
_GROUP: Final = struct.Struct("<24xII")
"""Data of a ##CG block after its links: bytes of a record, bytes of its invalidation bits."""
_CHANNEL: Final = struct.Struct("<3xBII")
"""Data of a ##CN block after its links: first bit, first byte, number of bits."""
_FIRST: Final = 64
MAX_BLOCKS: Final = 1_000_000
_OWN_LINKS: Final = {
    b"##HD": 5, b"##DG": 3, b"##CG": 2, b"##CN": 2, b"##CA": 1, b"##HL": 1, b"##DL": None,
    b"##LD": None, b"##FH": 1, b"##CH": 1, b"##AT": 1, b"##EV": 1,
}  # fmt: skip
"""Number of first links that point to parts of the block or to the next block; None: all links."""


class _Structure:
    """The blocks of a file. Checks that no block is used twice and that channels fit the record."""

    def __init__(self) -> None:
        self._placed, self._twice = {_FIRST}, 0
        self._groups: list[tuple[int, int]] = []  # first channel, bytes of a record
        self._channels: dict[int, tuple[int, int, int]] = {}  # next, composition, end [bytes]

    def register_block(self, at: int, kind: bytes, links: tuple[int, ...], data: bytes) -> None:
        """Register a block; data: the bytes after its links."""
        for link in filter(None, links[: _OWN_LINKS.get(kind, 0)]):
            if link in self._placed:
                self._twice = self._twice or link
            self._placed.add(link)
        if kind == b"##CG" and len(links) > 1 and len(data) >= _GROUP.size:
            self._groups.append((links[1], sum(_GROUP.unpack_from(data))))
        elif kind == b"##CN" and len(links) > 1 and len(data) >= _CHANNEL.size:
            bit, byte, bits = _CHANNEL.unpack_from(data)
            self._channels[at] = links[0], links[1], byte + (bit + bits + 7) // 8

    def damage(self) -> str | None:
        """Return the damage in words, or None."""
        if self._twice:
            return f"the file is damaged: two links point to the block at byte {self._twice}"
        for first, record in self._groups:
            waiting, seen = [first], set()
            while waiting:
                at = waiting.pop()
                if at in seen or at not in self._channels:
                    continue
                seen.add(at)
                following, composition, end = self._channels[at]
                if end > record:
                    return f"the file is damaged: a channel at byte {at} lies beyond its record"
                waiting += [following, composition]
        return None


def mf4_end(path: Path) -> str | None:
    """Return why an MF4 file is incomplete or unreadable; None if all linked blocks are there."""
    size = path.stat().st_size
    unpacked = 0
    structure = _Structure()
    with path.open("rb") as file:
        begins = file.read(8)
        is_finished = begins.startswith(b"MDF")
        if not is_finished and begins != b"UnFinMF ":
            return None
        if size < _FIRST + _BLOCK.size:
            return "the file is cut within its header"
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
            structure.register_block(at, kind, links, head)
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
    return structure.damage()
