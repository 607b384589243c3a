"""The bit positions of signals; read and write these bits in one frame and in whole columns.

A frame is treated as one integer of `8 * size` bits: little-endian for Intel signals, big-endian
for Motorola signals. In this integer, each signal is one contiguous run of bits, `shift` bits above
the low end. In columns of many frames, the payload is read as 64-bit words of the same byte order.
Both ways of reading give the same number for a signal.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.dbc.message import ByteOrder, Signal

WORD_BITS = 64

Columns = NDArray[np.uint8]
"""Payload bytes (N, W), padded with zeros."""


class Field(Struct, frozen=True):
    """A contiguous run of bits. The numbering of `first_bit` depends on the byte order.

    Intel: the number of the least significant bit. Motorola: the number of the most significant
    bit, counted from the highest bit of byte 0. `end_byte`: smallest number of bytes of a frame
    that contains the field.
    """

    first_bit: int
    length: int
    byte_order: ByteOrder

    @property
    def is_big(self) -> bool:
        """True if the byte order is Motorola."""
        return self.byte_order == "big_endian"

    @property
    def order(self) -> Literal["little", "big"]:
        """The byte order, as an argument of `int.from_bytes`."""
        return "big" if self.is_big else "little"

    @property
    def end_byte(self) -> int:
        """Index of the last byte of the field, plus 1."""
        return (self.first_bit + self.length + 7) // 8

    @property
    def mask(self) -> int:
        """A mask with one set bit for each bit of the field."""
        return (1 << self.length) - 1

    def shift(self, size: int) -> int:
        """Number of bits below the field, in the integer of a frame of `size` bytes."""
        return 8 * size - self.first_bit - self.length if self.is_big else self.first_bit


def field_at(start: int, length: int, byte_order: ByteOrder) -> Field:
    """Make a field from the start bit of a DBC."""
    first = 8 * (start // 8) + 7 - start % 8 if byte_order == "big_endian" else start
    return Field(first, length, byte_order)


def field_of(signal: Signal) -> Field:
    """Return the field of a signal."""
    return field_at(signal.start, signal.length, signal.byte_order)


def read_bits(data: bytes | bytearray, field: Field) -> int:
    """Read the unsigned integer in `field`. The frame must be long enough."""
    # runs twice a frame; written out, it takes half the time of the field's properties
    first, length = field.first_bit, field.length
    size = (first + length + 7) // 8
    if field.byte_order == "big_endian":
        return int.from_bytes(data[:size], "big") >> 8 * size - first - length & (1 << length) - 1
    return int.from_bytes(data[:size], "little") >> first & (1 << length) - 1


def write_bits(data: bytearray, field: Field, value: int) -> None:
    """Write the low bits of `value` into `field`. The frame must be long enough."""
    first, length = field.first_bit, field.length
    size, mask = (first + length + 7) // 8, (1 << length) - 1
    order: Literal["little", "big"] = "little"
    shift = first
    if field.byte_order == "big_endian":
        order, shift = "big", 8 * size - first - length
    whole = int.from_bytes(data[:size], order) & ~(mask << shift)
    data[:size] = (whole | (value & mask) << shift).to_bytes(size, order)


def words_of(data: Columns, byte_order: ByteOrder) -> NDArray[np.uint64]:
    """View bytes (N, W) as words (N, ceil(W / 8)) of the byte order. Copies only if necessary."""
    count, width = data.shape
    padded_width = -(-max(width, 1) // 8) * 8
    if padded_width != width:
        padded = np.zeros((count, padded_width), np.uint8)
        padded[:, :width] = data
        data = padded
    kind = ">u8" if byte_order == "big_endian" else "<u8"
    words: NDArray[np.uint64] = np.ascontiguousarray(data).view(kind)
    return words


def read_column(words: NDArray[np.uint64], field: Field) -> NDArray[np.uint64]:
    """Read a field of at most 64 bits as unsigned (N,). words: in the field's byte order."""
    index, at = divmod(field.first_bit, WORD_BITS)
    left = np.uint64(WORD_BITS - field.length)
    if field.is_big:
        column = words[:, index] << np.uint64(at) if at else words[:, index].astype(np.uint64)
        if at + field.length > WORD_BITS:
            column = column | (words[:, index + 1] >> np.uint64(WORD_BITS - at))
        return column >> left
    column = words[:, index] >> np.uint64(at)
    if at + field.length > WORD_BITS:
        column = column | (words[:, index + 1] << np.uint64(WORD_BITS - at))
    return (column << left) >> left


def write_column(out: Columns, field: Field, values: NDArray[np.uint64]) -> None:
    """Write unsigned values (N,) into `field` of `out`. Values must fit into the field.

    `out`: (N, W), contiguous, W a multiple of 8. The bits of the field must be zero before.
    """
    words = out.view(">u8" if field.is_big else "<u8")
    index, at = divmod(field.first_bit, WORD_BITS)
    over = at + field.length - WORD_BITS
    if field.is_big:
        if over <= 0:
            words[:, index] |= values << np.uint64(-over)
        else:
            words[:, index] |= values >> np.uint64(over)
            words[:, index + 1] |= values << np.uint64(WORD_BITS - over)
    else:
        words[:, index] |= values << np.uint64(at)
        if over > 0:
            words[:, index + 1] |= values >> np.uint64(WORD_BITS - at)


def signed_column(values: NDArray[np.uint64], length: int) -> NDArray[np.int64]:
    """Convert unsigned values (N,) of `length` bits to signed values (two's complement)."""
    left = np.int64(WORD_BITS - length)
    return (values.view(np.int64) << left) >> left
