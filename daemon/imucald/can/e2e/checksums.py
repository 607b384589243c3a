"""Checksums of protected CAN messages: XOR, CRC-8 SAE J1850, AUTOSAR E2E profiles 1, 2, 5, 11.

One frame and whole columns give the same number. All of them are one scheme: bytes are fed into a
table-driven CRC in the order prefix, payload without the checksum's own bytes, suffix; prefix and
suffix may depend on the alive counter.

Source: AUTOSAR PRS "E2E Protocol Specification" (profiles 1, 2, 5, 11) and SWS "CRC Library".
Profiles 1 and 11 start their CRC-8 SAE J1850 at 0 and do not invert it: PRS calls the routine with
the XOR value as start value and inverts the result again, to stay with the profile's first release.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.dbc.bits import Columns, Field, read_bits, read_column, words_of
from imucald.core.errors import ConfigError

J1850_POLYNOMIAL = 0x1D
"""CRC-8 SAE J1850."""

H2F_POLYNOMIAL = 0x2F
"""CRC-8 of E2E profile 2 (AUTOSAR Crc_CalculateCRC8H2F)."""

CCITT_POLYNOMIAL = 0x1021
"""CRC-16 of E2E profile 5 (AUTOSAR Crc_CalculateCRC16, start 0xFFFF)."""

E2E_COUNTER_VALUES = 16
"""Profiles 1, 2 and 11 count in four bits."""

DataIdMode = Literal["both", "alternating", "low", "nibble"]


class ChecksumSpec(Struct, frozen=True):
    """Where a checksum lies and over what it runs.

    `size`: bytes of the message that are covered; longer frames are covered up to there.
    `position`: first byte of the checksum; `width`: 1, or 2 (low byte first). `polynomial`:
    0 is XOR. `prefixes`, `suffixes`: bytes fed before and after the payload; one entry, or one for
    each counter value (then `counter` says where the counter is). `fixed`: a field that must hold
    a value (the data id's nibble of profiles 1 and 11).
    """

    size: int
    position: int
    width: int = 1
    polynomial: int = 0
    start: int = 0
    final_xor: int = 0
    prefixes: tuple[bytes, ...] = (b"",)
    suffixes: tuple[bytes, ...] = (b"",)
    counter: Field | None = None
    fixed: tuple[Field, int] | None = None

    def __post_init__(self) -> None:
        if self.width not in (1, 2) or not 0 <= self.position <= self.size - self.width:
            raise ConfigError(
                f"checksum at byte {self.position} is not within a message of {self.size} bytes"
            )
        for field in (self.counter, self.fixed[0] if self.fixed else None):
            if field is not None and field.end_byte > self.size:
                raise ConfigError(f"counter or data id is beyond a message of {self.size} bytes")
        needed = 1 if self.counter is None else 1 << self.counter.length
        for table in (self.prefixes, self.suffixes):
            if len(table) not in (1, needed):
                raise ConfigError(f"{len(table)} data ids for {needed} counter values")


def xor_checksum(size: int, position: int, id_bytes: bytes = b"", start: int = 0) -> ChecksumSpec:
    """XOR of all other bytes, the identifier bytes and a start value."""
    return ChecksumSpec(size, position, start=start, prefixes=(id_bytes,))


def crc8_j1850(
    size: int, position: int, id_bytes: bytes = b"", id_bytes_last: bool = False
) -> ChecksumSpec:
    """CRC-8 SAE J1850 (0x1D, start 0xFF, inverted) over identifier bytes and all other bytes."""
    first, last = (b"", id_bytes) if id_bytes_last else (id_bytes, b"")
    return ChecksumSpec(
        size, position, 1, J1850_POLYNOMIAL, 0xFF, 0xFF, prefixes=(first,), suffixes=(last,)
    )


def e2e_profile_1(
    size: int,
    data_id: int,
    mode: DataIdMode = "both",
    crc_bit: int = 0,
    counter_bit: int = 8,
    nibble_bit: int = 12,
) -> ChecksumSpec:
    """E2E profile 1 (variant 1A: mode both; 1B: alternating; 1C: nibble) [PRS_E2E_00195...].

    Offsets are AUTOSAR's, in bits: the CRC's a multiple of 8, the others of 4.
    """
    low, high = _id_bytes(data_id)
    prefixes: tuple[bytes, ...]
    if mode == "both":
        prefixes = (bytes([low, high]),)
    elif mode == "low":
        prefixes = (bytes([low]),)
    elif mode == "nibble":
        prefixes = (bytes([low, 0]),)
    elif mode == "alternating":
        prefixes = tuple(bytes([high if c % 2 else low]) for c in range(E2E_COUNTER_VALUES))
    else:
        raise ConfigError(f"{mode!r} is no data id mode of E2E profile 1")
    return ChecksumSpec(
        size,
        _byte_of(crc_bit),
        1,
        J1850_POLYNOMIAL,
        prefixes=prefixes,
        counter=_nibble(counter_bit),
        fixed=(_nibble(nibble_bit), high & 0xF) if mode == "nibble" else None,
    )


def e2e_profile_2(size: int, data_ids: Sequence[int], crc_bit: int = 0) -> ChecksumSpec:
    """E2E profile 2: CRC-8H2F, then the data id that the counter (next byte's low nibble) picks."""
    if len(data_ids) != E2E_COUNTER_VALUES:
        raise ConfigError(f"E2E profile 2 has {E2E_COUNTER_VALUES} data ids, not {len(data_ids)}")
    if not all(0 <= i <= 0xFF for i in data_ids):
        raise ConfigError("a data id of E2E profile 2 is one byte")
    return ChecksumSpec(
        size,
        _byte_of(crc_bit),
        1,
        H2F_POLYNOMIAL,
        0xFF,
        0xFF,
        suffixes=tuple(bytes([i]) for i in data_ids),
        counter=_nibble(crc_bit + 8),
    )


def e2e_profile_5(size: int, data_id: int, offset_bit: int = 0) -> ChecksumSpec:
    """E2E profile 5: CRC-16 (low byte first), counter in the byte after it."""
    suffix = bytes(_id_bytes(data_id))
    return ChecksumSpec(size, _byte_of(offset_bit), 2, CCITT_POLYNOMIAL, 0xFFFF, suffixes=(suffix,))


def e2e_profile_11(
    size: int,
    data_id: int,
    mode: DataIdMode = "nibble",
    crc_bit: int = 0,
    counter_bit: int = 8,
    nibble_bit: int = 12,
) -> ChecksumSpec:
    """E2E profile 11 (variant 11A: mode both; 11C: nibble): profile 1's, two modes only."""
    if mode not in ("both", "nibble"):
        raise ConfigError(f"{mode!r} is no data id mode of E2E profile 11")
    return e2e_profile_1(size, data_id, mode, crc_bit, counter_bit, nibble_bit)


class Checksum:
    """Computes and checks the checksum of one message."""

    def __init__(self, spec: ChecksumSpec) -> None:
        self.spec = spec
        self._table = _table(spec.polynomial, spec.width)
        self._table_array = np.array(self._table, np.uint16 if spec.width == 2 else np.uint8)
        self._before = spec.position
        self._after = spec.position + spec.width
        self._many = max(len(spec.prefixes), len(spec.suffixes))
        self._starts = tuple(self._feed(spec.start, p) for p in spec.prefixes)
        if len(self._starts) == 1:
            self._starts *= self._many
        self._suffixes = spec.suffixes * (self._many if len(spec.suffixes) == 1 else 1)

    def compute(self, data: bytes | bytearray) -> int:
        """Checksum that a frame of at least `size` bytes should have."""
        spec = self.spec
        index = 0
        if self._many > 1 and spec.counter is not None:
            index = read_bits(data, spec.counter)
        covered = data[: self._before] + data[self._after : spec.size] + self._suffixes[index]
        return self._feed(self._starts[index], covered) ^ spec.final_xor

    def is_right(self, data: bytes | bytearray) -> bool:
        """Whether a frame of at least `size` bytes carries its checksum (and data id nibble)."""
        spec = self.spec
        if spec.fixed is not None and read_bits(data, spec.fixed[0]) != spec.fixed[1]:
            return False
        stored = int.from_bytes(data[self._before : self._after], "little")
        return stored == self.compute(data)

    def compute_columns(self, data: Columns) -> NDArray[np.uint16]:
        """The same for (N, W) frames, W at least `size`."""
        spec = self.spec
        index = self._indices(data)
        crc = np.array(self._starts, self._table_array.dtype)[index]
        for i in range(spec.size):
            if not self._before <= i < self._after:
                crc = self._feed_column(crc, data[:, i])
        for i in range(len(self._suffixes[0])):
            suffix = np.array([s[i] for s in self._suffixes], np.uint8)
            crc = self._feed_column(crc, suffix[index])
        return crc.astype(np.uint16) ^ np.uint16(spec.final_xor)

    def are_right(self, data: Columns) -> NDArray[np.bool_]:
        """The same as `is_right` for (N, W) frames, W at least `size`."""
        stored = data[:, self._before].astype(np.uint16)
        if self.spec.width == 2:
            stored |= data[:, self._before + 1].astype(np.uint16) << np.uint16(8)
        right: NDArray[np.bool_] = stored == self.compute_columns(data)
        if self.spec.fixed is not None:
            field, value = self.spec.fixed
            right &= read_column(words_of(data, field.byte_order), field) == value
        return right

    def _indices(self, data: Columns) -> NDArray[np.intp]:
        counter = self.spec.counter
        if self._many == 1 or counter is None:
            return np.zeros(len(data), np.intp)
        return read_column(words_of(data, counter.byte_order), counter).astype(np.intp)

    def _feed(self, crc: int, data: bytes | bytearray) -> int:
        table = self._table
        if self.spec.width == 1:
            for byte in data:
                crc = table[crc ^ byte]
        else:
            for byte in data:
                crc = (crc << 8 & 0xFF00) ^ table[crc >> 8 ^ byte]
        return crc

    def _feed_column(
        self, crc: NDArray[np.unsignedinteger], byte: NDArray[np.uint8]
    ) -> NDArray[np.unsignedinteger]:
        table = self._table_array
        if self.spec.width == 1:
            narrow: NDArray[np.unsignedinteger] = table[crc ^ byte]
            return narrow
        high = (crc >> np.uint16(8)).astype(np.uint8)
        result: NDArray[np.unsignedinteger] = (crc << np.uint16(8)) ^ table[high ^ byte]
        return result


def _table(polynomial: int, width: int) -> tuple[int, ...]:
    """CRC table, most significant bit first; polynomial 0 gives XOR (the byte itself)."""
    if polynomial == 0:
        return tuple(range(256))
    top, mask = 1 << 8 * width - 1, (1 << 8 * width) - 1
    table = []
    for byte in range(256):
        crc = byte << 8 * (width - 1)
        for _ in range(8):
            crc = (crc << 1 ^ polynomial if crc & top else crc << 1) & mask
        table.append(crc)
    return tuple(table)


def _id_bytes(data_id: int) -> tuple[int, int]:
    if not 0 <= data_id <= 0xFFFF:
        raise ConfigError(f"data id {data_id} is not within 0..65535")
    return data_id & 0xFF, data_id >> 8


def _byte_of(bit: int) -> int:
    if bit < 0 or bit % 8:
        raise ConfigError(f"a checksum starts at a byte, not at bit {bit}")
    return bit // 8


def _nibble(bit: int) -> Field:
    """Four bits at an AUTOSAR bit offset: a multiple of 4, low nibble first."""
    if bit < 0 or bit % 4:
        raise ConfigError(f"counter and data id nibble start at a multiple of 4, not at bit {bit}")
    return Field(bit, 4, "little_endian")
