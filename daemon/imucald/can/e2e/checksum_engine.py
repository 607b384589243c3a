"""A table-driven CRC (or XOR) over the bytes of a message, for one frame and for whole columns.

All checksums of `checksums` use the same scheme. The CRC runs over the prefix, the payload without
the checksum bytes, and the suffix. Prefix and suffix may depend on the alive counter. A frame has
the same checksum when computed alone and in columns.
"""

from __future__ import annotations

from collections.abc import Iterable
from functools import cache
from itertools import chain
from typing import Any, Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.dbc.bits import Columns, Field, read_bits, read_column, words_of
from imucald.core.errors import ConfigError


class ChecksumSpec(Struct, frozen=True):
    """The position of a checksum and the bytes that it covers.

    `size`: number of covered bytes; in a longer frame, later bytes are not covered. `position`:
    first byte of the checksum; `width`: 1 or 2 bytes, in `byte_order`. `polynomial`: 0 means XOR.
    `prefixes`, `suffixes`: bytes before and after the payload; either one entry, or one entry per
    counter value (`counter` is then the position of the counter). `fixed`: a field that must have a
    fixed value (the nibble of the data id in profiles 1 and 11).
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
    byte_order: Literal["little", "big"] = "little"

    def __post_init__(self) -> None:
        if self.width not in (1, 2) or not 0 <= self.position <= self.size - self.width:
            raise ConfigError(
                f"the checksum at byte {self.position} is outside a message of {self.size} bytes"
            )
        for field in (self.counter, self.fixed[0] if self.fixed else None):
            if field is not None and field.end_byte > self.size:
                raise ConfigError(
                    f"the counter or the data id is outside a message of {self.size} bytes"
                )
        needed = 1 if self.counter is None else 1 << self.counter.length
        for table in (self.prefixes, self.suffixes):
            if len(table) not in (1, needed):
                raise ConfigError(
                    f"{len(table)} data ids are given, but the counter has {needed} "
                    "values: give one for each"
                )

    def bytes_at(self) -> list[tuple[int, int]]:
        """The shift [bits] and the position of each byte of the checksum."""
        places = range(self.position, self.position + self.width)
        if self.byte_order == "big":
            places = places[::-1]
        return [(8 * i, place) for i, place in enumerate(places)]


class Checksum:
    """Computes and checks the checksum of one message."""

    def __init__(self, spec: ChecksumSpec) -> None:
        self.spec = spec
        self._table = _table(spec.polynomial, spec.width)
        self._before = spec.position
        self._after = spec.position + spec.width
        self._many = max(len(spec.prefixes), len(spec.suffixes))
        self._starts = tuple(self._fed(self._table, spec.start, p) for p in spec.prefixes)
        if len(self._starts) == 1:
            self._starts *= self._many
        self._suffixes = spec.suffixes * (self._many if len(spec.suffixes) == 1 else 1)

    @property
    def tables(self) -> tuple[tuple[int, ...], tuple[int, ...], tuple[bytes, ...]]:
        """The byte table, and for each counter value the start of the CRC and the last bytes."""
        return self._table, self._starts, self._suffixes

    def compute(self, data: bytes | bytearray) -> int:
        """Return the correct checksum for a frame of at least `size` bytes."""
        spec = self.spec
        index = 0
        if self._many > 1 and spec.counter is not None:
            index = read_bits(data, spec.counter)
        covered = data[: self._before] + data[self._after : spec.size] + self._suffixes[index]
        crc: int = self._fed(self._table, self._starts[index], covered)
        return crc ^ spec.final_xor

    def is_right(self, data: bytes | bytearray) -> bool:
        """True if checksum (and data id nibble) of a frame of at least `size` bytes are right."""
        spec = self.spec
        if spec.fixed is not None and read_bits(data, spec.fixed[0]) != spec.fixed[1]:
            return False
        stored = int.from_bytes(data[self._before : self._after], spec.byte_order)
        return stored == self.compute(data)

    def compute_columns(self, data: Columns) -> NDArray[np.uint16]:
        """Return the correct checksums for frames (N, W), W at least `size`."""
        counter = self.spec.counter
        index = np.zeros(len(data), np.uint64)
        if self._many > 1 and counter is not None:
            index = read_column(words_of(data, counter.byte_order), counter)
        suffixes = np.frombuffer(b"".join(self._suffixes), np.uint8).reshape(self._many, -1)
        covered = [data[:, : self._before], data[:, self._after : self.spec.size], suffixes[index]]
        kind = np.uint16 if self.spec.width == 2 else np.uint8
        table, starts = np.array(self._table, kind), np.array(self._starts, kind)
        crc = self._fed(table, starts[index], chain.from_iterable(part.T for part in covered))
        return np.asarray(crc.astype(np.uint16) ^ np.uint16(self.spec.final_xor))

    def stored_columns(self, data: Columns) -> NDArray[np.uint16]:
        """Return the checksums that frames (N, W) contain."""
        stored = np.zeros(len(data), np.uint16)
        for shift, place in self.spec.bytes_at():
            stored |= data[:, place].astype(np.uint16) << np.uint16(shift)
        return stored

    def are_right(self, data: Columns) -> NDArray[np.bool_]:
        """Do the check of `is_right` for frames (N, W), W at least `size`."""
        right = self.stored_columns(data) == self.compute_columns(data)
        if self.spec.fixed is not None:
            field, value = self.spec.fixed
            right &= read_column(words_of(data, field.byte_order), field) == value
        return np.asarray(right)

    def _fed(self, table: Any, crc: Any, data: Iterable[Any]) -> Any:
        """Return the CRC after more bytes. The code is the same for one frame (integers) and for
        columns (arrays).
        """
        if self.spec.width == 1:
            for byte in data:
                crc = table[crc ^ byte]
        else:
            for byte in data:
                crc = (crc << 8 & 0xFF00) ^ table[crc >> 8 ^ byte]
        return crc


@cache
def _table(polynomial: int, width: int) -> tuple[int, ...]:
    """Return the CRC table, most significant bit first; polynomial 0 gives XOR (the byte itself).

    A reflected CRC (least significant bit first) needs another table here. No loop changes, neither
    in Python nor in C: an 8-bit CRC uses the same loop, and a 16-bit CRC too if its register is
    byte-swapped. Table, start and final XOR of the spec are then byte-swapped, and `byte_order` is
    the opposite of the order in the message (`checksums.in_signal` sets it).
    """
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
