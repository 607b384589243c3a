"""Whether an MF4 file is whole and asammdf can bear it: it says of a cut one that it cannot seek.

asammdf's compiled part believes what a channel says of its place: one beyond the record makes it
write where it may not, and the process ends later, somewhere else. It goes round for ever where a
list leads back into itself.

Layout: ASAM MDF 4: an identification of 64 bytes, then blocks, each with its length and links to
others. A file that its recorder did not finish (UnFinMF) does not state all lengths: what it lacks
is no fault of it, what it unpacks to and where its channels lie is judged all the same.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

from imucald.can.logs.unpacking import FREE_BYTES, MOST_TIMES, unpacks_to_too_much

_BLOCK: Final = struct.Struct("<4s4xQQ")
"""Kind, length, number of links; the links follow."""
_DEFLATED: Final = struct.Struct("<2sBxIQQ")
"""Of a ##DZ block behind its links: kind, way, parameter, bytes unpacked, bytes that follow."""
_GROUP: Final = struct.Struct("<24xII")
"""Of a ##CG block behind its links: bytes of a record, and of its invalidation bits."""
_CHANNEL: Final = struct.Struct("<3xBII")
"""Of a ##CN block behind its links: first bit, first byte, bits."""
_FIRST: Final = 64
MAX_BLOCKS: Final = 1_000_000
_OWN_LINKS: Final = {
    b"##HD": 5, b"##DG": 3, b"##CG": 2, b"##CN": 2, b"##CA": 1, b"##HL": 1, b"##DL": None,
    b"##LD": None, b"##FH": 1, b"##CH": 1, b"##AT": 1, b"##EV": 1,
}  # fmt: skip
"""First links of a block that name what is a part of it, or the next in its list; None: all."""


class _Structure:
    """Blocks of a file: whether each has one place, and each channel lies within its record."""

    def __init__(self) -> None:
        self._placed, self._twice = {_FIRST}, 0
        self._groups: list[tuple[int, int]] = []  # first channel, bytes of a record
        self._channels: dict[int, tuple[int, int, int]] = {}  # next, composition, end [bytes]

    def take(self, at: int, kind: bytes, links: tuple[int, ...], data: bytes) -> None:
        """Take a block; data: what follows its links."""
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
        """What is wrong; None: nothing."""
        if self._twice:
            return f"the file is damaged: the block at byte {self._twice} is in two places"
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
    """Why an MF4 file ends too soon or cannot be read; None where all that it names is there."""
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
            structure.take(at, kind, links, head)
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
