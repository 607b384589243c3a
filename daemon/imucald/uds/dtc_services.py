"""Clear and read DTCs (services 0x14 and 0x19)."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import Final

from imucald.uds.codes import Answer, Nrc
from imucald.uds.dtc import Dtc
from imucald.uds.dtc_memory import AVAILABLE, DtcMemory, DtcRecord

COUNT_BY_MASK: Final = 0x01
BY_MASK: Final = 0x02
EXTENDED_DATA: Final = 0x06
SUPPORTED: Final = 0x0A

ALL_GROUPS: Final = 0xFFFFFF
J2012_FORMAT: Final = 0x00
"""Format of the codes: SAE J2012-DA, two bytes for the code and one for the failure type."""

OCCURRENCES: Final = 0x01
AGED: Final = 0x02
ALL_RECORDS: Final = 0xFF


class ClearDtcs:
    """Service 0x14."""

    def __init__(self, memory: DtcMemory) -> None:
        self._memory = memory

    def answer(self, data: bytes) -> Answer:
        """Answer a request to clear all codes or one code."""
        if len(data) != 3:
            return Nrc.INCORRECT_LENGTH
        number = int.from_bytes(data, "big")
        if number == ALL_GROUPS:
            self._memory.clear()
        elif self._memory.find(number) is not None:
            self._memory.clear(number)
        else:
            return Nrc.OUT_OF_RANGE
        return b""


class ReadDtcs:
    """Service 0x19."""

    def __init__(self, memory: DtcMemory) -> None:
        self._memory = memory

    def answer(self, data: bytes) -> Answer:
        """Answer a report request; data: the bytes from the sub-function on."""
        sub, rest = data[0], data[1:]
        if sub == SUPPORTED:
            return Nrc.INCORRECT_LENGTH if rest else self._list(sub, self._memory)
        if sub == EXTENDED_DATA:
            return self._extended(rest)
        if len(rest) != 1:
            return Nrc.INCORRECT_LENGTH
        found = [(dtc, r) for dtc, r in self._memory if r.status & rest[0] & AVAILABLE]
        if sub == COUNT_BY_MASK:
            return struct.pack(">BBBH", sub, AVAILABLE, J2012_FORMAT, len(found))
        return self._list(sub, found)

    @staticmethod
    def _list(sub: int, found: Iterable[tuple[Dtc, DtcRecord]]) -> bytes:
        lines = [_line(dtc.number, record) for dtc, record in found]
        return bytes([sub, AVAILABLE]) + b"".join(lines)

    def _extended(self, rest: bytes) -> Answer:
        """Return occurrences and cycles without failure of one code."""
        if len(rest) != 4:
            return Nrc.INCORRECT_LENGTH
        number, wanted = int.from_bytes(rest[:3], "big"), rest[3]
        record = self._memory.find(number)
        if record is None or wanted not in (OCCURRENCES, AGED, ALL_RECORDS):
            return Nrc.OUT_OF_RANGE
        content = {OCCURRENCES: record.occurrences, AGED: record.aged}
        parts = [bytes(part) for part in content.items() if wanted in (part[0], ALL_RECORDS)]
        return bytes([EXTENDED_DATA]) + _line(number, record) + b"".join(parts)


def _line(number: int, record: DtcRecord) -> bytes:
    return number.to_bytes(3, "big") + bytes([record.status & AVAILABLE])
