"""Whether an MF4 file is whole: asammdf says of a cut one that it cannot seek.

Layout: ASAM MDF 4: an identification of 64 bytes, then blocks, each with its length and links to
others. A file that its recorder did not finish (UnFinMF) states no lengths, and is not judged.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

_BLOCK: Final = struct.Struct("<4s4xQQ")
"""Kind, length, number of links; the links follow."""
_FIRST: Final = 64
MAX_BLOCKS: Final = 1_000_000


def mf4_end(path: Path) -> str | None:
    """Why an MF4 file ends too soon; None where every block that is named is there."""
    size = path.stat().st_size
    with path.open("rb") as file:
        if not file.read(8).startswith(b"MDF"):
            return None
        if size < _FIRST + _BLOCK.size:
            return "the file is cut within its header"
        waiting, seen = [_FIRST], {0, _FIRST}
        while waiting and len(seen) < MAX_BLOCKS:
            at = waiting.pop()
            if at + _BLOCK.size > size:
                return f"the file is cut: it has {size} bytes and names a block at byte {at}"
            file.seek(at)
            kind, length, count = _BLOCK.unpack(file.read(_BLOCK.size))
            if kind[:2] != b"##" or 8 * count > length:
                return f"the file is damaged at byte {at}"
            if at + length > size:
                return f"the file is cut: {size} of at least {at + length} bytes are there"
            links = struct.unpack(f"<{count}Q", file.read(8 * count))
            waiting += [link for link in links if link not in seen]
            seen.update(links)
    return None
