"""A recorded drive with edits: any bytes stand for some, so that libFuzzer can damage a log."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import NamedTuple

MAX_EDITS, MAX_BYTES = 100, 65


class Kind(IntEnum):
    LOST = 0
    REPEATED = 1
    CLOCK_SET = 2
    REPLACED = 3
    OTHER_BITS = 4
    STUCK = 5
    ANY_TEXT = 6
    ANOTHERS = 7
    """The frame has the data of another one."""


WITH_BYTES = (Kind.REPLACED, Kind.OTHER_BITS, Kind.ANY_TEXT)


class Frame(NamedTuple):
    t: float
    can_id: str
    data: bytes


class EditedDrive:
    """The drive as candump text; see `edited`."""

    def __init__(self, frames: list[Frame]) -> None:
        self.lines: list[str] = []
        self.frames = frames
        self.at = 0
        self._late = 0.0

    def pass_on(self, count: int) -> None:
        """The next frames as they are."""
        for t, can_id, data in self.frames[self.at : self.at + count]:
            self.lines.append(f"({t + self._late:.6f}) can0 {can_id}#{data.hex()}")
        self.at = min(self.at + count, len(self.frames))

    def edit(self, kind: Kind, much: int, own: bytes) -> None:
        """Edit at the frame that is next, of which there is one."""
        frames, at = self.frames, self.at
        one = frames[at]
        match kind:
            case Kind.LOST:
                self.at = min(at + much, len(frames))
            case Kind.REPEATED:
                frames[at:at] = much * [one]
            case Kind.CLOCK_SET:
                self._late += (much - 128) ** 3 * 1e-5
            case Kind.REPLACED:
                frames[at] = one._replace(data=own)
            case Kind.OTHER_BITS:
                mask = own.ljust(len(one.data), b"\0")
                both = zip(one.data, mask, strict=False)
                frames[at] = one._replace(data=bytes(x ^ y for x, y in both))
            case Kind.STUCK:
                for k in range(at, min(at + 16 * much, len(frames))):
                    if frames[k].can_id == one.can_id:
                        frames[k] = frames[k]._replace(data=one.data)
            case Kind.ANY_TEXT:
                self.lines.append(own.decode("latin-1"))
            case Kind.ANOTHERS:
                frames[at] = one._replace(data=frames[(at + 1 + much) % len(frames)].data)


def edited(frames: list[Frame], data: bytes) -> str:
    """The drive with the edits that the bytes say: of each how far on (16 bits), its kind, how
    much, and bytes of its own."""
    drive = EditedDrive(list(frames))
    for _ in range(MAX_EDITS):
        if len(data) < 4:
            break
        further, number, much = struct.unpack_from("<HBB", data)
        kind = Kind(number % len(Kind))
        own = data[4 : 4 + much % MAX_BYTES] if kind in WITH_BYTES else b""
        data = data[4 + len(own) :]
        drive.pass_on(further)
        if drive.at == len(drive.frames):
            break
        drive.edit(kind, much, own)
    drive.pass_on(len(drive.frames))
    return "\n".join(drive.lines) + "\n"
