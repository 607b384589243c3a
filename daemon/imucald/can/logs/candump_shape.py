"""The head of candump lines, checked for thousands of lines at once against one shape.

Nearly all lines of a log share a few heads, ``(dddddddddd.dddddd) can0 ``, which differ in their
digits only. A shape is learned from one line that the strict reader accepted; whether other lines
have it takes a handful of word operations.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.can.id_filter import IdFilter
from imucald.can.logs.ascii_columns import (
    Bytes,
    Index,
    Words,
    decimal_number,
    repeated,
    runs_at,
    u8,
)

EXACT_INTEGER: Final = 2**53
"""Whole numbers below are doubles exactly; their quotient by a power of ten up to 22 is then
the double nearest to the decimal text, which is what float() gives for it."""

MAX_DIGITS: Final = 18
"""Decimal digits that surely fit into 64 bits."""

ID_BYTES: Final = 9
"""Characters behind the head that show the kind of frame: ``12345678#`` or ``123##F``."""

_HIGH: Final = repeated(0xF0)


class Layout(NamedTuple):
    """What makes a shape: digits before and behind the point, spaces, channel."""

    seconds: int
    fraction: int
    gap: int
    channel: str


class Shape:
    """One head of lines, with the filter of its channel."""

    def __init__(self, layout: Layout, channel_index: int, ids: IdFilter) -> None:
        self.layout = layout
        self.channel_index = channel_index
        self.ids = ids
        a, b = layout.seconds, layout.fraction
        digits = b"(" + b"0" * a + b"." + b"0" * b + b")"
        head = digits + b" " * layout.gap + layout.channel.encode("ascii") + b" "
        self.head_bytes = len(head)
        self.words = -(-(len(head) + ID_BYTES) // 8)
        self.stray = sum(byte not in b"0123456789abcdefABCDEF" for byte in head)
        """Characters of the head that are no hexadecimal digits."""
        self._head_words = -(-len(head) // 8)
        places = [k for k in range(len(head)) if digits[k : k + 1] == b"0"]
        pad = 8 * self._head_words - len(head)
        # Added to the difference from the head, 6 carries into the high nibble from 10 upwards,
        # 15 from 1 upwards. A byte that overflows had its high nibble set before the sum.
        add = bytes(6 if k in places else 15 for k in range(len(head)))
        self._head = _words(head + b"\0" * pad)
        self._add = _words(add + b"\0" * pad)
        self._last_mask = _words(b"\xff" * (8 - pad) + b"\0" * pad)[0]

    @property
    def key(self) -> Layout:
        """What distinguishes it from other shapes."""
        return self.layout

    def heads(self, buf: Bytes, starts: Index) -> tuple[Words, NDArray[np.bool_]]:
        """Return the first words of each line (N, words), and whether its head has this shape."""
        runs = runs_at(buf, starts, self.words)
        wrong = np.zeros(len(starts), np.uint64)
        for k in range(self._head_words):
            difference = runs[:, k] ^ self._head[k]
            if k == self._head_words - 1:
                difference &= self._last_mask
            wrong |= difference
            difference += self._add[k]
            wrong |= difference
        wrong &= _HIGH
        return runs, wrong == 0

    def behind(self, runs: Words) -> Words:
        """Return (N,): the eight characters behind the head."""
        k, shift = divmod(self.head_bytes, 8)
        low = runs[:, k] >> u8(8 * shift)
        if shift:
            low |= runs[:, k + 1] << u8(64 - 8 * shift)
        return low

    def times(self, buf: Bytes, starts: Index) -> NDArray[np.float64]:
        """Return the time stamps [s], to the last bit what float() of their text gives."""
        a, b = self.layout.seconds, self.layout.fraction
        if a + b > MAX_DIGITS:
            return self._times_by_text(buf, starts)
        total = _decimal(buf, starts + 1, a) * u8(10**b) + _decimal(buf, starts + a + 2, b)
        if len(total) and int(total.max()) >= EXACT_INTEGER:
            return self._times_by_text(buf, starts)
        seconds: NDArray[np.float64] = total.astype(np.float64)
        seconds /= float(10**b)
        return seconds

    def _times_by_text(self, buf: Bytes, starts: Index) -> NDArray[np.float64]:
        size = self.layout.seconds + self.layout.fraction + 1
        view = np.ndarray((len(buf) - size + 1,), f"S{size}", buf, 0, (1,))
        return np.array([float(text) for text in view[starts + 1].tolist()], np.float64)


def _words(text: bytes) -> Words:
    return np.frombuffer(text, "<u8")


def _decimal(buf: Bytes, at: Index, digits: int) -> Words:
    """Return the numbers of `digits` decimal digits (up to 24) that begin at `at`."""
    number = np.zeros(len(at), np.uint64)
    first = digits % 8
    if first:
        values = (runs_at(buf, at, 1)[:, 0] ^ repeated(0x30)) << u8(8 * (8 - first))
        number += decimal_number(values)
    for done in range(first, digits, 8):
        values = runs_at(buf, at + done, 1)[:, 0] ^ repeated(0x30)
        number *= u8(10**8)
        number += decimal_number(values)
    return number
