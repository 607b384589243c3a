"""Check whether a BLF file is complete. python-can's reader does not report a cut file.

Layout: Vector's "Binary Logging Format", as python-can (can/io/blf.py) reads and writes it.
"""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Final

from imucald.can.logs.unpacking import FREE_BYTES, unpacks_to_too_much

_FILE_HEADER: Final = struct.Struct("<4sLBBBBBBBBQQ")
"""Signature, size of the header, application, version, ..., size of the file, size unpacked."""
_OBJECT: Final = struct.Struct("<4sHHLL")
"""Signature, size of the header, its version, size of the object, kind."""
_SIGNATURE: Final = b"LOBJ"
_CONTAINER: Final = 10
_CONTAINER_HEAD: Final = struct.Struct("<H14x")
"""The compression of a container; its contents follow."""
_DEFLATED: Final = 2


def blf_bomb(path: Path) -> str | None:
    """Return which container of a BLF file unpacks to too much memory; None if none."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_FILE_HEADER.size)
        at = _FILE_HEADER.unpack(header)[1] if len(header) == _FILE_HEADER.size else size
        while at < size:
            file.seek(at)
            begin = file.read(_OBJECT.size)
            if len(begin) < _OBJECT.size:
                return None
            signature, _, _, length, kind = _OBJECT.unpack(begin)
            if signature != _SIGNATURE or length < _OBJECT.size:
                return None
            head = file.read(_CONTAINER_HEAD.size) if kind == _CONTAINER else b""
            left = length - _OBJECT.size - _CONTAINER_HEAD.size
            deflated = len(head) == _CONTAINER_HEAD.size and head[0] == _DEFLATED
            if deflated and unpacks_to_too_much(file, left):
                return (
                    f"the unpacked container at byte {at} would be larger than "
                    f"{FREE_BYTES >> 20} MiB"
                )
            at += length + length % 4
    return None


def blf_end(path: Path) -> str | None:
    """Return why a BLF file is incomplete; None if it is complete."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_FILE_HEADER.size)
        if len(header) < _FILE_HEADER.size:
            return "the file is cut within its header"
        _, at, *_, stated, _ = _FILE_HEADER.unpack(header)
        if at > size:
            return "the file is cut within its header"
        if stated > size:
            return f"the file is cut: it has {size} of {stated} bytes"
        while at < size:
            file.seek(at)
            begin = file.read(_OBJECT.size)
            if len(begin) < _OBJECT.size:
                break
            signature, _, _, length, _ = _OBJECT.unpack(begin)
            if signature != _SIGNATURE or length < _OBJECT.size:
                return f"the file is damaged at byte {at}"
            if at + length > size:
                break
            at += length + length % 4
        else:
            return None
    if 0 <= size - at < 4:  # python-can may omit the padding after the last object
        return None
    return f"the file is cut: it ends within the block at byte {at}"
