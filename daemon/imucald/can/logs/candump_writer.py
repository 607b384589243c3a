"""Write frames as candump text, in the format of ``candump -L`` and canplayer.

Columns are written with a few array operations: each line is a row of a table of characters, and
unused places hold NUL, which is then removed.
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

ROWS: Final = 32_768
"""Number of frames formatted together, so that memory is bounded and fits the cache."""


class CandumpWriter:
    """Writes candump text to a file, a gzip file (``.gz``) or standard output ("-").

    Usable as a context manager. All methods raise LogError if the file cannot be written or a frame
    cannot be expressed as text. A regular file that cannot be written is removed, because it would
    fill a full disk.
    """

    def __init__(self, path: Path | str) -> None:
        """Open the file."""
        self.frames_written = 0
        self._name = str(path)
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
            self._put(_formatted(part, self._name), len(part))

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


def _open(name: str) -> BufferedIOBase:
    if name == "-":
        stdout = getattr(sys.stdout, "buffer", None)  # a notebook's stdout accepts only text
        if stdout is None:
            raise LogError("standard output cannot take bytes here: name a file")
        return cast("BufferedIOBase", stdout)
    if name.endswith(".gz"):
        import gzip  # noqa: PLC0415 - replay seldom writes

        return gzip.open(name, "wb", 3)  # twice as fast as the default, and 10 % larger
    return Path(name).open("wb")


def _formatted(frames: FrameColumns, name: str) -> bytes:
    length = frames.length.astype(np.intp)
    fd = length > CLASSIC_BYTES if frames.fd is None else frames.fd
    good = (frames.t >= 0) & (frames.t < MAX_SECONDS)
    good &= length <= np.where(fd, FD_BYTES, CLASSIC_BYTES)
    extended = frames.can_id >= CAN_EFF_FLAG
    good &= frames.can_id <= np.where(extended, CAN_EFF_FLAG | CAN_EFF_MASK, CAN_SFF_MASK)
    if not good.all():
        bad = int(np.argmin(good))
        raise LogError(
            f"{name}: a CAN frame cannot have these values: time {frames.t[bad]} s, "
            f"id {frames.can_id[bad]:X}, {length[bad]} bytes"
        )
    micros = np.rint(frames.t * 1e6).astype(np.int64)
    stamps = _four_digits()[micros[:, None] // (10**12, 10**8, 10**4, 1) % 10**4].view(np.uint8)
    ids = _hex((frames.can_id & np.uint32(CAN_EFF_MASK)).astype(">u4")[:, None].view(np.uint8))
    ids[~extended, :-3] = 0
    channels = _table([_channel(channel).encode("ascii") for channel in frames.channels])
    marks = _table([b"#", b"##%X" % CANFD_BRS])
    data = _hex(frames.data[:, : length.max(initial=0)])
    data[np.arange(data.shape[1]) >= 2 * length[:, None]] = 0
    columns = (
        b"(", stamps[:, :10], b".", stamps[:, 10:], b") ", channels[frames.channel], b" ", ids,
        marks[fd.astype(np.intp)], data, b"\n",
    )  # fmt: skip
    rows = [
        np.broadcast_to(_table([one]), (len(ids), len(one))) if isinstance(one, bytes) else one
        for one in columns
    ]
    return np.concatenate(rows, axis=1).tobytes().translate(None, b"\0")


def _table(texts: list[bytes]) -> NDArray[np.uint8]:
    """Return the characters of texts (N, longest), with NUL after a shorter text."""
    return np.array(texts).view(np.uint8).reshape(len(texts), -1)


def _hex(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return _hex_pairs().take(data).view(np.uint8).reshape(len(data), 2 * data.shape[1])


@cache
def _four_digits() -> NDArray[np.uint32]:
    return np.array([b"%04d" % k for k in range(10_000)]).view("<u4")


@cache
def _hex_pairs() -> NDArray[np.uint16]:
    return np.array([b"%02X" % k for k in range(256)]).view("<u2")


def _channel(name: str) -> str:
    """Return a channel's name as one ASCII word. Other log formats allow other names."""
    return re.sub(r'[^!"$-~]', "_", name)[:32] or "can0"
