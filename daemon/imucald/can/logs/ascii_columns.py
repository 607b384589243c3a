"""ASCII text as columns: gathers of byte runs, lines, decimal and hexadecimal digits, by words.

A run of bytes is handled as little-endian 64-bit words, eight characters in each operation: the
first character is the lowest byte. All sums stay inside their bytes or are masked, as noted.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Bytes = NDArray[np.uint8]
Words = NDArray[np.uint64]
Index = NDArray[np.intp]

NEWLINE: Final = np.uint8(ord("\n"))
_BYTE_OF_BIT: Final = np.uint64(sum(k << (61 - 8 * k) for k in range(8)))
"""Multiplying 1 << 8k by this puts k into the top three bits."""


def u8(value: int) -> np.uint64:
    """Return an eight-byte constant."""
    return np.uint64(value)


def repeated(byte: int) -> np.uint64:
    """Return a word of eight equal bytes."""
    return np.uint64(byte * 0x0101_0101_0101_0101)


_ONE: Final = u8(1)
_SHIFT: Final = {n: u8(n) for n in (3, 4, 6, 8, 16, 32, 61)}
_NIBBLES: Final = repeated(0x0F)
_ONES: Final = repeated(0x01)
_NINE: Final = u8(9)


def runs_at(buf: Bytes, at: Index, words: int) -> Words:
    """Return (N, words): the 8 * words bytes of `buf` from each place `at`.

    Every place must leave that many bytes to the end of `buf`.
    """
    size = 8 * words
    view = np.ndarray((len(buf) - size + 1,), f"V{size}", buf, 0, (1,))
    runs: Words = view[at].view("<u8").reshape(-1, words)
    return runs


def line_ends(buf: Bytes, size: int) -> Index:
    """Return the places of all newlines in the first `size` bytes of `buf`.

    `buf` must be at least 7 bytes longer. Faster than flatnonzero on bytes: newlines are few, so
    first the words of eight are found that hold one, then its place within.
    """
    mask = buf[: -(-size // 8) * 8] == NEWLINE
    mask[size:] = False
    words = mask.view("<u8")
    hit = np.flatnonzero(words != 0)
    bits = words[hit]
    if (bits & (bits - _ONE)).any():
        return np.flatnonzero(mask)
    hit <<= 3
    hit += ((bits * _BYTE_OF_BIT) >> _SHIFT[61]).view(np.int64)
    return hit


def not_hex(buf: Bytes) -> NDArray[np.bool_]:
    """Say which bytes are no hexadecimal digit of either case."""
    work = buf - np.uint8(ord("0"))
    digit = work < np.uint8(10)
    np.bitwise_or(buf, np.uint8(0x20), out=work)
    work -= np.uint8(ord("a"))
    letter = work < np.uint8(6)
    # 0x10 to 0x1F become no letters by the bit for lower case: only 0x41.. and 0x61.. do.
    digit |= letter
    return np.logical_not(digit, out=digit)


def hex_nibbles(words: Words) -> Words:
    """Return the value of each of eight digits in its byte; other characters give nonsense."""
    high = words >> _SHIFT[6]
    high &= _ONES
    high *= _NINE
    high += words & _NIBBLES
    return high


_PAIRS: Final = u8(0x00FF_00FF_00FF_00FF)
_QUADS: Final = u8(0x0000_FFFF_0000_FFFF)


def hex_bytes(words: Words) -> Words:
    """Return four data bytes in the low 32 bits, in order, from words of eight digits."""
    v = hex_nibbles(words)
    v = ((v << _SHIFT[4]) | (v >> _SHIFT[8])) & _PAIRS
    v = (v | (v >> _SHIFT[8])) & _QUADS
    return (v | (v >> _SHIFT[16])) & u8(0xFFFF_FFFF)


def hex_number(words: Words) -> Words:
    """Return the number that eight hexadecimal digits spell."""
    v = hex_nibbles(words)
    v = ((v << _SHIFT[4]) | (v >> _SHIFT[8])) & _PAIRS
    v = ((v << _SHIFT[8]) | (v >> _SHIFT[16])) & _QUADS
    return ((v << _SHIFT[16]) | (v >> _SHIFT[32])) & u8(0xFFFF_FFFF)


def decimal_number(words: Words) -> Words:
    """Return the number that eight decimal digits (given as values 0..9 in bytes) spell.

    Neighbours are joined thrice: to pairs, fours, eights (a well-known way to read digits).
    """
    v = words * u8(10) + (words >> _SHIFT[8])
    v &= _PAIRS
    v = v * u8(100) + (v >> _SHIFT[16])
    v &= _QUADS
    return (v * u8(10_000) + (v >> _SHIFT[32])) & u8(0xFFFF_FFFF)
