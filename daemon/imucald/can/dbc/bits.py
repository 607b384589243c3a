"""Where a signal's bits lie, and how to move them for one frame and for whole columns.

A frame is seen as one integer of `8 * size` bits, little-endian for Intel signals and big-endian
for Motorola ones; in it every signal is one run of bits at a `shift` from the low end. Columns
are seen as 64-bit words of the same byte order. Both give the same integer.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.dbc.message import ByteOrder, Signal

MAX_FRAME_BYTES = 64
"""Longest CAN FD frame [byte]."""

WORD_BITS = 64

Columns = NDArray[np.uint8]
"""(N, W) payload bytes, zero-padded."""


class Field(Struct, frozen=True):
    """A run of bits: `first_bit` counted in transmission order of its byte order.

    Intel: the least significant bit's number. Motorola: the most significant bit's number,
    counted from byte 0's highest bit. `end_byte`: bytes a frame needs to hold it.
    """

    first_bit: int
    length: int
    byte_order: ByteOrder

    @property
    def is_big(self) -> bool:
        """True for Motorola order."""
        return self.byte_order == "big_endian"

    @property
    def order(self) -> Literal["little", "big"]:
        """The byte order, as `int.from_bytes` names it."""
        return "big" if self.is_big else "little"

    @property
    def end_byte(self) -> int:
        """One past the last byte touched."""
        return (self.first_bit + self.length + 7) // 8

    @property
    def mask(self) -> int:
        """As many ones as the field has bits."""
        return (1 << self.length) - 1

    def shift(self, size: int) -> int:
        """Distance of the lowest bit from the low end of a frame of `size` bytes."""
        return 8 * size - self.first_bit - self.length if self.is_big else self.first_bit


def field_at(start: int, length: int, byte_order: ByteOrder) -> Field:
    """Field from a DBC's start bit."""
    first = 8 * (start // 8) + 7 - start % 8 if byte_order == "big_endian" else start
    return Field(first, length, byte_order)


def field_of(signal: Signal) -> Field:
    """Field of a signal."""
    return field_at(signal.start, signal.length, signal.byte_order)


def read_bits(data: bytes | bytearray, field: Field) -> int:
    """Unsigned integer in `field`; the frame must be long enough."""
    # twice a frame: spelt out, which takes half as long as by the field's properties
    first, length = field.first_bit, field.length
    size = (first + length + 7) // 8
    if field.byte_order == "big_endian":
        return int.from_bytes(data[:size], "big") >> 8 * size - first - length & (1 << length) - 1
    return int.from_bytes(data[:size], "little") >> first & (1 << length) - 1


def write_bits(data: bytearray, field: Field, value: int) -> None:
    """Put the low bits of `value` into `field`; the frame must be long enough."""
    first, length = field.first_bit, field.length
    size, mask = (first + length + 7) // 8, (1 << length) - 1
    order: Literal["little", "big"] = "little"
    shift = first
    if field.byte_order == "big_endian":
        order, shift = "big", 8 * size - first - length
    whole = int.from_bytes(data[:size], order) & ~(mask << shift)
    data[:size] = (whole | (value & mask) << shift).to_bytes(size, order)


def words_of(data: Columns, byte_order: ByteOrder) -> NDArray[np.uint64]:
    """See (N, W) bytes as (N, ceil(W / 8)) words of the byte order; copies only if it must."""
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
    """Unsigned (N,) column of a field of at most 64 bits, in the words of its byte order."""
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
    """Put (N,) unsigned values, already cut to the field, into zero bits of `out`.

    `out`: (N, W), contiguous, W a multiple of 8.
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
    """Two's complement reading of unsigned (N,) values of `length` bits."""
    left = np.int64(WORD_BITS - length)
    return (values.view(np.int64) << left) >> left
