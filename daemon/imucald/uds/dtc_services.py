"""Clear and read DTCs (services 0x14 and 0x19)."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final

from imucald.uds.codes import Answer, Nrc
from imucald.uds.dtc import AVAILABLE, Dtc, DtcMemory, DtcRecord

COUNT_BY_MASK: Final = 0x01
BY_MASK: Final = 0x02
EXTENDED_DATA: Final = 0x06
SUPPORTED: Final = 0x0A

OCCURRENCES: Final = 0x01
AGED: Final = 0x02
ALL_RECORDS: Final = 0xFF


def clear_dtcs(memory: DtcMemory, data: bytes) -> Answer:
    """Answer a request to clear all codes or one code."""
    if len(data) != 3:
        return Nrc.INCORRECT_LENGTH
    number = int.from_bytes(data, "big")
    if number == 0xFFFFFF:  # all groups
        memory.clear()
    elif memory.find(number) is not None:
        memory.clear(number)
    else:
        return Nrc.OUT_OF_RANGE
    return b""


def read_dtcs(memory: DtcMemory, data: bytes) -> Answer:
    """Answer a report request; data: the bytes from the sub-function on."""
    sub, rest = data[0], data[1:]
    if sub == SUPPORTED:
        return Nrc.INCORRECT_LENGTH if rest else _list(sub, memory)
    if sub == EXTENDED_DATA:
        return _extended(memory, rest)
    if len(rest) != 1:
        return Nrc.INCORRECT_LENGTH
    found = [(dtc, r) for dtc, r in memory if r.status & rest[0] & AVAILABLE]
    if sub == COUNT_BY_MASK:  # format 0, SAE J2012-DA: two bytes of code, one of failure type
        return struct.pack(">BBBH", sub, AVAILABLE, 0, len(found))
    return _list(sub, found)


def _list(sub: int, found: Iterable[tuple[Dtc, DtcRecord]]) -> bytes:
    lines = [_line(dtc.number, record) for dtc, record in found]
    return bytes([sub, AVAILABLE]) + b"".join(lines)


def _extended(memory: DtcMemory, rest: bytes) -> Answer:
    """Return occurrences and cycles without failure of one code."""
    if len(rest) != 4:
        return Nrc.INCORRECT_LENGTH
    number, wanted = int.from_bytes(rest[:3], "big"), rest[3]
    record = memory.find(number)
    if record is None or wanted not in (OCCURRENCES, AGED, ALL_RECORDS):
        return Nrc.OUT_OF_RANGE
    content = {OCCURRENCES: record.occurrences, AGED: record.aged}
    parts = [bytes(part) for part in content.items() if wanted in (part[0], ALL_RECORDS)]
    return bytes([EXTENDED_DATA]) + _line(number, record) + b"".join(parts)


def _line(number: int, record: DtcRecord) -> bytes:
    return number.to_bytes(3, "big") + bytes([record.status & AVAILABLE])
