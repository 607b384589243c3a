"""Write frames as candump text, in the format of ``candump -L`` and canplayer.

Columns are written with a few array operations. Frames of the same form (id width, CAN FD or not,
length, channel) have lines of equal length. These lines are filled as a table and then put into
their order.
"""

from __future__ import annotations

import os
import re
import stat
import sys
from contextlib import suppress
from functools import cache
from io import BufferedIOBase
from pathlib import Path
from typing import Final, Self, cast

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CAN_SFF_MASK,
    CANFD_BRS,
    CLASSIC_BYTES,
    FD_BYTES,
    FrameColumns,
)
from imucald.core.errors import LogError

MAX_SECONDS: Final = 2**32
"""Limit of written times [s] (year 2106). Below it, a double is exact to the microsecond."""

MICROSECONDS: Final = 1_000_000
ROWS: Final = 32_768
"""Number of frames formatted together, so that memory is bounded and fits the cache."""

GZIP_LEVEL: Final = 3
"""Compression level of gzip: twice as fast as the default, and 10 % larger."""

_CLASSIC: Final = CLASSIC_BYTES
_STAMP_BYTES: Final = len("(1600000000.000000) ")


class CandumpWriter:
    """Writes candump text to a file, a gzip file (``.gz``) or standard output ("-").

    Usable as a context manager. All methods raise LogError if the file cannot be written or a frame
    cannot be expressed as text. A regular file that cannot be written is removed, because it would
    fill a full disk.
    """

    def __init__(self, path: Path | str, fd_flags: int = CANFD_BRS) -> None:
        """Open the file. fd_flags: digit for CAN FD frames (1: bit rate switch, 2: error state)."""
        self.frames_written = 0
        self._name = str(path)
        self._fd_flags = fd_flags & 0xF
        self._made: os.stat_result | None = None
        try:
            self._file = _open(self._name)
            if self._name != "-":
                self._made = os.fstat(self._file.fileno())
        except OSError as error:
            raise self._failed(error) from error

    def write_columns(self, frames: FrameColumns) -> None:
        """Write frames in order. If `fd` is None, frames longer than 8 bytes are CAN FD."""
        for start in range(0, len(frames), ROWS):
            part = frames.take(slice(start, start + ROWS))
            self._put(_formatted(part, self._fd_flags, self._name), len(part))

    def flush(self) -> None:
        """Pass all data written so far to the operating system."""
        try:
            self._file.flush()
        except OSError as error:
            raise self._failed(error) from error

    def close(self) -> None:
        """Write the remaining data and close the file. Standard output stays open."""
        try:
            self._file.flush()
            if self._name != "-":
                self._file.close()
        except BrokenPipeError:
            raise
        except OSError as error:
            with suppress(OSError):
                self._file.close()
            raise self._failed(error) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _put(self, text: bytes, frames: int) -> None:
        try:
            self._file.write(text)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise self._failed(error) from error
        self.frames_written += frames

    def _failed(self, error: OSError) -> LogError:
        if self._made is not None and stat.S_ISREG(self._made.st_mode):
            with suppress(OSError):
                if os.path.samestat(Path(self._name).lstat(), self._made):
                    Path(self._name).unlink()
        return LogError(f"{self._name}: cannot be written: {error.strerror or error}")


def _no_frame(name: str, t: float, can_id: int, length: int) -> LogError:
    return LogError(
        f"{name}: a CAN frame cannot have these values: time {t} s, id {can_id:X}, {length} bytes"
    )


def _open(name: str) -> BufferedIOBase:
    if name == "-":
        stdout = getattr(sys.stdout, "buffer", None)  # a notebook's stdout accepts only text
        if stdout is None:
            raise LogError("standard output cannot take bytes here: name a file")
        return cast("BufferedIOBase", stdout)
    if name.endswith(".gz"):
        import gzip  # noqa: PLC0415 - replay seldom writes

        return gzip.open(name, "wb", GZIP_LEVEL)
    return Path(name).open("wb")


def _formatted(frames: FrameColumns, fd_flags: int, name: str) -> bytes:
    """Return the lines of some frames."""
    length = frames.length.astype(np.intp)
    fd = length > _CLASSIC if frames.fd is None else frames.fd
    good = (frames.t >= 0) & (frames.t < MAX_SECONDS)
    good &= length <= np.where(fd, FD_BYTES, _CLASSIC)
    extended = frames.can_id >= CAN_EFF_FLAG
    good &= frames.can_id <= np.where(extended, CAN_EFF_FLAG | CAN_EFF_MASK, CAN_SFF_MASK)
    if not good.all():
        bad = int(np.argmin(good))
        raise _no_frame(name, frames.t[bad], int(frames.can_id[bad]), int(length[bad]))
    stamps = _stamps(frames.t)
    form = ((frames.channel.astype(np.intp) * 2 + extended) * 2 + fd) * 128 + length
    forms, first, which = np.unique(form, return_index=True, return_inverse=True)
    heads = [
        _Form(
            _channel(frames.channels[frames.channel[k]]).encode("ascii") + b" ",
            8 if extended[k] else 3,
            b"##%X" % fd_flags if fd[k] else b"#",
            int(length[k]),
        )
        for k in first.tolist()
    ]
    if len(forms) == 1:
        return heads[0].lines(stamps, frames.can_id, frames.data).tobytes()
    sizes = np.array([head.size for head in heads])[which]
    ends = np.cumsum(sizes)
    text = np.zeros(int(ends[-1]), np.uint8)
    for k, head in enumerate(heads):
        mine = np.flatnonzero(which == k)
        lines = head.lines(stamps[mine], frames.can_id[mine], frames.data[mine])
        places = np.ndarray((len(text) - head.size + 1,), f"V{head.size}", text, 0, (1,))
        places[ends[mine] - head.size] = lines.view(f"V{head.size}")[:, 0]
    return text.tobytes()


def _stamps(t: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Return characters (N, 20): ``(seconds.microseconds) ``, with ten and six digits."""
    micros = np.rint(t * MICROSECONDS).astype(np.int64)
    seconds, micros = np.divmod(micros, MICROSECONDS)
    high, low = np.divmod(seconds, 10_000)
    rows = np.empty((len(t), _STAMP_BYTES), np.uint8)
    rows[:, 0] = ord("(")
    rows[:, 1:3] = _digits(high // 10_000)[:, 2:]
    rows[:, 3:7] = _digits(high % 10_000)
    rows[:, 7:11] = _digits(low)
    rows[:, 11] = ord(".")
    rows[:, 12:14] = _digits(micros // 10_000)[:, 2:]
    rows[:, 14:18] = _digits(micros % 10_000)
    rows[:, 18] = ord(")")
    rows[:, 19] = ord(" ")
    return rows


def _digits(number: NDArray[np.int64]) -> NDArray[np.uint8]:
    return _four_digits().take(number)[:, None].view(np.uint8)


class _Form:
    """Lines of frames of the same form. These lines differ only in their digits."""

    def __init__(self, channel: bytes, id_digits: int, mark: bytes, length: int) -> None:
        self.size = _STAMP_BYTES + len(channel) + id_digits + len(mark) + 2 * length + 1
        self._channel = channel
        self._id_digits = id_digits
        self._mark = mark
        self._length = length

    def lines(
        self, stamps: NDArray[np.uint8], can_id: NDArray[np.uint32], data: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Return the lines as characters (N, size)."""
        count, at = len(stamps), _STAMP_BYTES
        rows = np.empty((count, self.size), np.uint8)
        rows[:, :at] = stamps
        for text in (self._channel, b"0" * self._id_digits, self._mark):
            rows[:, at : at + len(text)] = np.frombuffer(text, np.uint8)
            at += len(text)
        number = (can_id & np.uint32(CAN_EFF_MASK)).astype(">u4")
        digits = _hex(number[:, None].view(np.uint8))[:, -self._id_digits :]
        end = _STAMP_BYTES + len(self._channel) + self._id_digits
        rows[:, end - self._id_digits : end] = digits
        rows[:, at : at + 2 * self._length] = _hex(data[:, : self._length])
        rows[:, -1] = ord("\n")
        return rows


def _hex(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return hexadecimal characters (N, 2 L) for bytes (N, L)."""
    return _hex_pairs().take(data).view(np.uint8).reshape(len(data), -1)


@cache
def _four_digits() -> NDArray[np.uint32]:
    digits = (np.arange(10_000)[:, None] // (1000, 100, 10, 1) % 10 + ord("0")).astype(np.uint8)
    table: NDArray[np.uint32] = digits.view("<u4")[:, 0]
    return table


@cache
def _hex_pairs() -> NDArray[np.uint16]:
    table: NDArray[np.uint16] = np.array([b"%02X" % k for k in range(256)], "S2").view("<u2")
    return table


def _channel(name: str) -> str:
    """Return a channel's name as one ASCII word. Other log formats allow other names."""
    return re.sub(r'[^!"$-~]', "_", name)[:32] or "can0"
