"""A block of candump text: its lines, and those of one head and kind of frame found at once."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CLASSIC_BYTES, FD_BYTES
from imucald.can.id_filter import NO_ID, WANTED
from imucald.can.logs.ascii_columns import (
    Bytes,
    Index,
    Words,
    hex_nibbles,
    hex_number,
    line_ends,
    not_hex,
    u8,
)
from imucald.can.logs.candump_shape import Shape

FEW: Final = 64
"""Odd lines of a block up to which their characters are counted one by one."""

_HASH, _CR, _SPACE, _R, _T = (np.uint8(ord(c)) for c in "#\r RT")
_DIGITS: Final = b"0123456789abcdefABCDEF"


class _Kind(NamedTuple):
    """What stands behind the head: id digits, then ``#`` or, for CAN FD, ``##F``."""

    id_digits: int
    fd: bool

    @property
    def data_offset(self) -> int:
        return self.id_digits + (3 if self.fd else 1)

    @property
    def max_digits(self) -> np.uint64:
        return u8(2 * (FD_BYTES if self.fd else CLASSIC_BYTES))


_KINDS: Final = (_Kind(3, False), _Kind(8, False), _Kind(3, True), _Kind(8, True))


class _Lines(Struct, frozen=True):
    """Lines of one head: number in the block, place behind the head, bytes from there, eight of
    them as a word."""

    line: Index
    place: Index
    rest: Index
    word: Words

    def only(self, mask: NDArray[np.bool_]) -> _Lines:
        return _Lines(self.line[mask], self.place[mask], self.rest[mask], self.word[mask])


class Hits(Struct, frozen=True):
    """Wanted frames of one shape and kind, H of them.

    line: number in the block; start: its place; at, digits: place and number of data digits;
    can_id: with `CAN_EFF_FLAG`. All (H,).
    """

    shape: Shape
    fd: bool
    line: Index
    start: Index
    at: Index
    digits: Index
    can_id: NDArray[np.uint32]

    def only(self, mask: NDArray[np.bool_]) -> Hits:
        """Return the chosen ones."""
        columns = (self.line, self.start, self.at, self.digits, self.can_id)
        return Hits(self.shape, self.fd, *(column[mask] for column in columns))  # type: ignore[arg-type]


class CandumpBlock:
    """Whole lines, each of which is in the end either accounted for or odd.

    A line is accounted for when head, id and length are right; it then must hold a known number
    of characters that are no hexadecimal digits, which `settle` holds against the real one.
    """

    def __init__(self, buf: Bytes, size: int) -> None:
        """buf: text in the first `size` bytes, then room for runs read past the end."""
        self.buf = buf
        self.size = size
        self.newlines = line_ends(buf, size)
        self.starts = np.empty_like(self.newlines)
        self.starts[:1] = 0
        self.starts[1:] = self.newlines[:-1] + 1
        self._stray = np.zeros(len(self.newlines), np.int32)
        self._trim()

    def __len__(self) -> int:
        return len(self.newlines)

    def text(self, line: int) -> bytes:
        """Return one line without its newline."""
        return self.buf[self.starts[line] : self.newlines[line]].tobytes()

    def _trim(self) -> None:
        """Find where the frames end: before `` R``, `` T`` and before CR."""
        self._ends = self.newlines
        self._tail: NDArray[np.int32] | np.int32 = np.int32(1)
        last = self.buf.take(self._ends - 1)
        returns = last == _CR
        if returns.any():
            self._ends = self._ends - returns
            self._tail = self._tail + returns.astype(np.int32)
            last = self.buf.take(self._ends - 1)
        marks = (last == _R) | (last == _T)
        if marks.any():
            marks &= self.buf.take(self._ends - 2) == _SPACE
            self._ends = self._ends - 2 * marks
            self._tail = self._tail + 2 * marks.astype(np.int32)

    def find(self, shape: Shape, lines: Index) -> tuple[Index, list[Hits]]:
        """Return those of `lines` that have another head, and the hits among the others."""
        starts = self.starts if len(lines) == len(self) else self.starts[lines]
        runs, right = shape.heads(self.buf, starts)
        other = lines[:0]
        if not right.all():
            other = lines[~right]
            lines, starts, runs = lines[right], starts[right], runs[right]
        place = starts + shape.head_bytes
        ends = self._ends if len(lines) == len(self) else self._ends[lines]
        left = _Lines(lines, place, ends - place, shape.behind(runs))
        hits = []
        for kind in _KINDS:
            if not len(left.line):
                break
            good, ids, wanted = self._of_kind(left, kind, shape)
            if not good.any():
                continue
            self._account(left.line, good, shape.stray + (2 if kind.fd else 1))
            wanted &= good
            if wanted.any():
                hits.append(_hits(shape, kind, left, np.flatnonzero(wanted), ids))
            if good.all():
                break
            left = left.only(~good)
        return other, hits

    def _of_kind(
        self, lines: _Lines, kind: _Kind, shape: Shape
    ) -> tuple[NDArray[np.bool_], NDArray[np.uint32], NDArray[np.bool_]]:
        """Say which lines have this kind; their ids (flag included), and whether wanted."""
        digits = (lines.rest - kind.data_offset).view(np.uint64)
        good = digits <= kind.max_digits
        good &= (digits & u8(1)) == 0
        if kind.id_digits == 3:
            good &= (lines.word & u8(0xFF00_0000)) == u8(ord("#") << 24)
            fd = (lines.word & u8(0xFF_0000_0000)) == u8(ord("#") << 32)
        else:
            good &= self.buf.take(lines.place + 8) == _HASH
            fd = self.buf.take(lines.place + 9) == _HASH
        good &= fd if kind.fd else ~fd
        if kind.id_digits == 3:
            ids = _three_digits(lines.word)
            verdict = shape.ids.verdict.take(ids)
            good &= verdict != NO_ID
            return good, ids, verdict == WANTED
        if not good.any():
            return good, np.zeros(len(good), np.uint32), good
        ids = hex_number(lines.word).astype(np.uint32)
        good &= ids <= CAN_EFF_MASK
        return good, ids | np.uint32(CAN_EFF_FLAG), shape.ids.extended(ids)

    def _account(self, lines: Index, good: NDArray[np.bool_], stray: int) -> None:
        count = self._tail + np.int32(stray)
        if len(lines) == len(self):
            np.multiply(good, count, out=self._stray, casting="unsafe")
        else:
            lines = lines[good]
            self._stray[lines] = count[lines] if isinstance(count, np.ndarray) else count

    def settle(self) -> tuple[Index, NDArray[np.bool_] | None]:
        """Return the odd lines, in order, and (where any looked right but is not) a mask of those.

        The mask is (lines of the block,), True at lines whose hits must be dropped.
        """
        stray = not_hex(self.buf[: self.size])
        odd = np.flatnonzero(self._stray == 0)
        if len(odd) <= FEW:
            known = int(self._stray.sum()) + sum(self._stray_characters(i) for i in odd.tolist())
            if known == np.count_nonzero(stray):
                return odd, None
        running = np.cumsum(stray, dtype=np.int32)[self.newlines]
        count = np.diff(running, prepend=np.int32(0))
        wrong = (count != self._stray) & (self._stray != 0)
        return np.flatnonzero(wrong | (self._stray == 0)), wrong

    def _stray_characters(self, line: int) -> int:
        return len(self.text(line).translate(None, _DIGITS)) + 1


_PAIR_OF_THREE: Final = np.uint32((1 << 24) | (1 << 12) | 1)


def _three_digits(words: Words) -> NDArray[np.uint32]:
    """Return the number (12 bits) that the first three hexadecimal digits spell.

    The product puts the digits n0 + n1 * 256 + n2 * 65536 side by side at bit 16; what else it
    makes stays below bit 16 without a carry (65295 at most) or is masked.
    """
    nibbles = hex_nibbles(words & u8(0xFF_FFFF)).astype(np.uint32)
    nibbles *= _PAIR_OF_THREE
    nibbles >>= np.uint32(16)
    nibbles &= np.uint32(0xFFF)
    return nibbles


def _hits(shape: Shape, kind: _Kind, lines: _Lines, at: Index, ids: NDArray[np.uint32]) -> Hits:
    place = lines.place[at]
    return Hits(
        shape,
        kind.fd,
        lines.line[at],
        place - shape.head_bytes,
        place + kind.data_offset,
        lines.rest[at] - kind.data_offset,
        ids[at],
    )
