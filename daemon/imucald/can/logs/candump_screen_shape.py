"""Lines of candump's screen output, checked for thousands of lines at once against one shape.

    (1436509052.249713)  can0  044   [5]  2A 36 6C 2B BA

A shape is learned from one line that the strict reader accepted: where its digits of the stamp, the
id and the length are, and what stands between them. Other lines that have it differ in those
digits and in their data only.
"""

from __future__ import annotations

import re
from typing import Final

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, CLASSIC_BYTES, FD_BYTES, Channels, FrameColumns
from imucald.can.id_filter import NO_ID, WANTED, IdFilter
from imucald.can.logs.ascii_columns import Bytes, Index, Words, runs_at
from imucald.can.logs.candump_screen_line import ERROR_ID
from imucald.can.logs.candump_screen_times import StampedTimes
from imucald.can.logs.candump_shape import EXACT_INTEGER

DATE_BYTES: Final = len("2015-07-10 08:17:32")

_BAD: Final = 0xFF
_STAMP: Final = re.compile(
    rb"(?:[0-9]{1,10}|[0-9]{4}(?:-[0-9]{2}){2} [0-9]{2}(?::[0-9]{2}){2})\.[0-9]{1,8}"
)
"""Of 18 digits at most, which surely fit into 64 bits."""
_NEWLINE, _CR, _SPACE = (np.uint8(ord(c)) for c in "\n\r ")


def _table(digits: bytes, blank: int = _BAD) -> NDArray[np.uint8]:
    table = np.full(256, _BAD, np.uint8)
    for value, digit in enumerate(digits):
        table[digit] = value
    table[ord(" ")] = blank
    return table


_VALUE: Final = _table(b"0123456789ABCDEF")
"""Of a digit of the head: candump prints ids in capitals."""
_NIBBLE: Final = _table(b"0123456789ABCDEF", 0x10)
_NIBBLE[list(b"abcdef")] = range(10, 16)
"""Of a digit of the data; 16 for a blank."""


def _not_as_printed(max_bytes: int) -> tuple[Words, Words]:
    """Bits that no value of data has as `_NIBBLE` says, and those that it has; (max_bytes + 1, W).

    A value is right where it has none of the first, and all of the second.
    """
    size = -(-3 * max_bytes // 8) * 8
    never, always = (np.zeros((max_bytes + 1, size), np.uint8) for _ in range(2))
    for length in range(1, max_bytes + 1):
        never[length, : 3 * length - 1] = 0xF0  # a digit
        never[length, 2 : 3 * length - 1 : 3] = 0xEF  # a blank
        always[length, 2 : 3 * length - 1 : 3] = 0x10
    return never.view("<u8"), always.view("<u8")


_DATA_BITS: Final = {size: _not_as_printed(size) for size in (CLASSIC_BYTES, FD_BYTES)}


class Found(Struct, frozen=True):
    """Frames of a block, N of them; `frames`: the wanted ones, without their time.

    line: number in the block; channel: its index; can_id: with `CAN_EFF_FLAG`; stamp: what it
    spells [s]. All (N,).
    """

    line: Index
    channel: NDArray[np.uint8]
    can_id: NDArray[np.uint32]
    stamp: NDArray[np.float64]
    wanted: NDArray[np.bool_]
    frames: FrameColumns


class ScreenShape:
    """What lines have in common, with the filter of their channel."""

    def __init__(
        self, match: re.Match[bytes], index: int, channels: Channels, ids: IdFilter
    ) -> None:
        """match: of `PRINTED`, a line with data printed in the usual way; index: its channel's."""
        line, rest = match.string, match["rest"]
        self._channel, self._channels = index, channels
        self._ids = ids
        self._fd = len(match["length"]) == 2
        self.stamp: bytes | None = match["stamp"]
        """Of the line it was learned from."""
        self._head = match.start("rest") + len(rest) - len(rest.lstrip(b" "))
        self._most = FD_BYTES if self._fd else CLASSIC_BYTES
        self._id = np.arange(*match.span("id"))
        self._length = np.arange(*match.span("length"))
        start, stop = match.span("stamp")
        self._stamp = [k for k in range(start, stop) if line[k] in b"0123456789"]
        self._date = start if b":" in (match["stamp"] or b"") else None
        self._part = len((match["stamp"] or b"").partition(b".")[2])
        places = np.concatenate([self._stamp, self._length]).astype(np.intp)
        self._digits = np.concatenate([self._id, places])
        self._limits = np.array([15] * len(self._id) + [9] * len(places), np.uint8)
        self._words = -(-self._head // 8)
        literal = np.zeros(8 * self._words, np.uint8)
        literal[: self._head] = 0xFF
        literal[self._digits] = 0
        text = np.frombuffer(line[: self._head].ljust(8 * self._words, b"\0"), np.uint8)
        self._literal, self._text = literal.view("<u8"), (text & literal).view("<u8")

    @property
    def key(self) -> tuple[bytes, bytes]:
        """What distinguishes it from other shapes."""
        return self._text.tobytes(), self._digits.tobytes()

    @staticmethod
    def can_be_of(match: re.Match[bytes]) -> bool:
        """Whether the number of the stamp can be read here (or there is none)."""
        return match["stamp"] is None or _STAMP.fullmatch(match["stamp"]) is not None

    def find(
        self, buf: Bytes, starts: Index, lines: Index, times: StampedTimes | None
    ) -> tuple[Index, Found]:
        """Return those of `lines` that have another shape, and the frames of the others.

        starts: where each line of the block begins; times: None where no stamps are asked for.
        """
        heads = runs_at(buf, starts[lines], self._words)
        right = (((heads & self._literal) ^ self._text) == 0).all(axis=1)
        values = _VALUE[heads.view(np.uint8)[:, self._digits]]
        right &= (values <= self._limits).all(axis=1)
        at = np.where(right, starts[lines] + self._head, 0)
        length = _number(values[:, len(values.T) - len(self._length) :], 10)
        right &= (length > 0) & (length <= self._most)
        length = np.where(right, length, 1)
        data = _NIBBLE[runs_at(buf, at, 3 * self._most // 8).view(np.uint8)]
        never, always = (bits[length] for bits in _DATA_BITS[self._most])
        words = data.view("<u8")
        right &= (((words & never) | (~words & always)) == 0).all(axis=1)
        right &= _ends_there(buf, at + 3 * length - 1)
        can_id = _number(values[:, : len(self._id)], 16)
        if len(self._id) == 3:
            verdict = self._ids.verdict[np.where(right, can_id, 0)]
            right &= verdict != NO_ID
            wanted = verdict == WANTED
        else:
            right &= can_id < ERROR_ID
            wanted = self._ids.extended(can_id.astype(np.uint32))
            can_id |= CAN_EFF_FLAG
        stamp = np.zeros(len(lines))
        if times is not None:
            stamp = self._stamps(buf, starts[lines], values, times)
            right &= ~np.isnan(stamp)
        ours = right & wanted
        frames = FrameColumns(
            np.zeros(np.count_nonzero(ours)),
            can_id[ours].astype(np.uint32),
            length[ours].astype(np.uint8),
            _bytes(data[ours], length[ours]),
            np.full(np.count_nonzero(ours), self._channel, np.uint8),
            self._channels.names,
            np.ones(np.count_nonzero(ours), np.bool_) if self._fd else None,
        )
        found = Found(
            lines[right],
            np.full(np.count_nonzero(right), self._channel, np.uint8),
            can_id[right].astype(np.uint32),
            stamp[right],
            wanted[right],
            frames,
        )
        return lines[~right], found

    def _stamps(
        self, buf: Bytes, starts: Index, values: NDArray[np.uint8], times: StampedTimes
    ) -> NDArray[np.float64]:
        """What stamps spell [s], to the last bit as float() of their text; NaN: none."""
        first = len(self._id)
        digits = values[:, first : first + len(self._stamp)]
        if not self._stamp:
            return np.full(len(starts), np.nan)
        if self._date is None:
            total = _number(digits, 10)
            return np.where(total < EXACT_INTEGER, total / 10**self._part, np.nan)
        text = np.ndarray((len(buf) - DATE_BYTES + 1,), f"S{DATE_BYTES}", buf, 0, (1,))
        dates = text[starts + self._date]
        changed = np.flatnonzero(np.concatenate([[True], dates[1:] != dates[:-1]]))
        known = [times.date(dates[k]) for k in changed.tolist()]
        seconds = np.array([np.nan if date is None else date for date in known], np.float64)
        count = np.diff(np.concatenate([changed, [len(dates)]]))
        part = _number(digits[:, len(self._stamp) - self._part :], 10) / 10**self._part
        stamps: NDArray[np.float64] = np.repeat(seconds, count) + part
        return stamps


def _number(digits: NDArray[np.uint8], base: int) -> NDArray[np.int64]:
    """The numbers that rows of digits spell."""
    total = np.zeros(len(digits), np.int64)
    for column in digits.T:
        total *= base
        total += column
    return total


def _ends_there(buf: Bytes, at: Index) -> NDArray[np.bool_]:
    """Whether what comes behind the data is a blank or the end of the line."""
    following = buf[at]
    right: NDArray[np.bool_] = (following == _NEWLINE) | (following == _SPACE)
    returns = following == _CR
    if returns.any():
        right |= returns & (buf[at + 1] == _NEWLINE)
    return right


def _bytes(nibbles: NDArray[np.uint8], length: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Data bytes (W, 8 or 64), zero beyond their length."""
    data = (nibbles[:, 0::3] << np.uint8(4)) | (nibbles[:, 1::3] & np.uint8(0x0F))
    data[np.arange(data.shape[1]) >= length[:, None]] = 0
    return data
