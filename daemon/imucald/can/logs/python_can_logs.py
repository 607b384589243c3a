"""Logs in other formats (ASC, BLF, TRC, CSV, MF4, SQLite), through python-can's readers."""

from __future__ import annotations

import logging
import math
import os
import re
import sqlite3
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Final

from imucald.can.columns import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CAN_SFF_MASK,
    CLASSIC_BYTES,
    FD_BYTES,
    Channels,
    FrameColumns,
)
from imucald.can.id_filter import IdFilters
from imucald.can.logs.candump_line import MAX_LINE_BYTES, shown, words_of
from imucald.can.logs.frame_batches import FrameBatches
from imucald.can.logs.log_format import ReadStatistics
from imucald.can.logs.text_blocks import OpenLog
from imucald.can.logs.unpacking import FREE_BYTES, InPieces, plain_ending, plain_file
from imucald.can.logs.untrusted_files import blf_faults, mf4_end, why_not_stored
from imucald.core.errors import LogError
from imucald.core.libraries import how_to_install

_BEGINNINGS: Final = {
    ".blf": re.compile(rb"LOGG"),
    ".mf4": re.compile(rb"MDF     |UnFinMF "),
    ".db": re.compile(rb"SQLite format 3\0"),
    ".asc": re.compile(
        rb"(?:\xef\xbb\xbf)?\s*(?://[^\n]*\n\s*)*(?:date |base +(?:hex|dec)|Begin Triggerblock)",
        re.IGNORECASE,
    ),
    ".trc": re.compile(rb"\s*;"),
    ".csv": re.compile(rb"(?:\xef\xbb\xbf)?timestamp,arbitration_id,", re.IGNORECASE),
}
"""The beginning of files of each kind."""

_BYTE_OR_LENGTH: Final = re.compile(rb"[0-9A-Fa-f]{2}|[1-9]")

HEAD_BYTES: Final = 4096

_RELATIVE: Final = re.compile(r"\s*base\s+\w+\s+timestamps\s+relative", re.IGNORECASE)
_STAMP: Final = re.compile(r"\s*\d+\.\d+(?=\s)")
_COMMA: Final = re.compile(r"^(\s*\d+),(\d+\s)")
"""A time stamp with a decimal comma. python-can skips such a line without an error."""
_NAME: Final = re.compile(
    r"\s*\d+\.\d+\s+\d+\s+(?![0-9A-F]+x?\s)([A-Z_]\w*)\s+(?:Rx|Tx|TxRq)\s+d\s", re.IGNORECASE
)
"""A line of ASC with the name of a message instead of its id."""


class PythonCanReader:
    """Reads files of formats that python-can supports into columns."""

    endings: ClassVar[tuple[str, ...]] = (".asc", ".blf", ".trc", ".csv", ".mf4", ".db")

    @staticmethod
    def begins(head: bytes) -> bool:
        """True if the first bytes are the beginning of a file in one of these formats."""
        return any(begins.match(head) for begins in _BEGINNINGS.values())

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._statistics = statistics
        self._last: float | None = None
        self._batches = FrameBatches(filters, channels, statistics)

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in batches; `report` is called with the bytes read.

        A file that cannot be read at all raises LogError. If a file fails after some frames, one
        rejection ("unreadable") is counted and reading ends, since python-can's readers cannot
        resume.
        """
        if isinstance(path, OpenLog):
            raise LogError(f"{path}: this format is read from a file by its name, not from a pipe")
        named = Path(path)
        with plain_file(named) as (plain, damage):
            yield from self._read(named, plain, report)
        if damage:
            self._statistics.reject("damaged_file", f"{named}: reading ends here: {damage}")

    def _read(
        self, path: Path, plain: Path, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Read the uncompressed file `plain`; `path` is its original name."""
        before = self._statistics.frames_read
        kind = _kind(plain, path)
        cut = _ends_in_half_a_byte(plain, kind)
        why, end = _faults(plain, kind)
        if why:
            raise LogError(f"{path}: cannot be read: {why}")
        counted, kept, reader = before, 0, None
        try:
            with _open(plain, kind, path) as reader:
                for number, message in enumerate(self._heard(reader, path), 1):
                    # The last frame is held back, because it may have to be removed.
                    if self._batches.is_full:
                        yield self._batches.columns()
                    counted, kept = self._statistics.frames_read, len(self._batches)
                    self._judge(message, path, number)
                    if number % 20_000 == 0:
                        report(_position(reader))
            if cut and self._statistics.frames_read > counted:
                self._batches.drop_from(kept)
                self._statistics.frames_read = counted
                self._statistics.reject("cut_line", f"{path}: the last line is cut")
        except LogError:
            raise
        # python-can's readers may raise any exception for damaged files; it is not documented.
        except Exception as error:
            text = getattr(reader, "file", None)
            words = text.words() if isinstance(text, _AnyText) else str(error)
            text = f"{path}: cannot be read: {end or words or type(error).__name__}"
            if self._statistics.frames_read == before:
                raise LogError(text) from error
            self._statistics.reject("unreadable", f"{text} ({self._so_far(before)})")
            end = None
        if end:
            self._statistics.reject("cut_file", f"{path}: {end}; {self._so_far(before)}")
        yield self._batches.columns()

    def _heard(self, reader: Iterable[Any], path: Path) -> Iterator[Any]:
        """Yield the messages of a reader. The reader warns about skipped data; each warning is
        counted as a rejection."""
        warned: list[str] = []
        handler = logging.Handler(logging.WARNING)
        handler.emit = lambda record: warned.append(record.getMessage())  # type: ignore[method-assign]
        handler.addFilter(lambda record: record.name != "can.io.asc")  # its frames are not skipped
        logger, messages = logging.getLogger("can"), iter(reader)
        while True:
            logger.addHandler(handler)  # temporary: several logs may be read alternately
            try:
                message = next(messages, None)
            finally:
                logger.removeHandler(handler)
            for text in warned:
                self._statistics.reject("left_out", f"{path}: {shown(text.encode())}")
            warned.clear()
            if message is None:
                return
            yield message

    def _so_far(self, before: int) -> str:
        first, last = self._statistics.first_stamp, self._last
        seconds = "" if first is None or last is None else f", {last - first:.1f} s"
        return f"{self._statistics.frames_read - before} frames were read{seconds}"

    def _judge(self, message: Any, path: Path, number: int) -> None:
        """Count one message; keep it if it is a wanted data frame."""
        if math.isfinite(message.timestamp):
            self._statistics.stamp(message.timestamp)
            self._last = message.timestamp
        if message.is_error_frame or message.is_remote_frame:
            self._statistics.ignore("error_frame" if message.is_error_frame else "remote_frame")
            return
        reason = _fault(message)
        if not reason:
            can_id = message.arbitration_id | (CAN_EFF_FLAG if message.is_extended_id else 0)
            frame = message.timestamp, can_id, bytes(message.data), _channel_name(message.channel)
            added = self._batches.add_frame(*frame, bool(message.is_fd))
            reason = "" if added else "too_many_channels"
        if reason:
            text = f"{path}: message {number}: {words_of(reason)}"
            self._statistics.reject(reason, text)


def _kind(plain: Path, named: Path) -> str:
    """Return the suffix that fits a file's first bytes; its own suffix if they are unknown."""
    with plain.open("rb") as file:
        head = file.read(HEAD_BYTES)
    found = next((ending for ending, begins in _BEGINNINGS.items() if begins.match(head)), None)
    return found or plain_ending(named)


def _faults(plain: Path, kind: str) -> tuple[str | None, str | None]:
    """Return why a file must not be passed to a reader, and why it is incomplete; None if not."""
    if kind == ".blf":
        return blf_faults(plain)
    judges = {".mf4": mf4_end, ".db": why_not_stored}
    return (judges[kind](plain) if kind in judges else None), None


def _open(path: Path, kind: str, named: Path) -> Any:
    from imucald.can.python_can import can, with_mf4  # noqa: PLC0415 (costs 0.1 s)

    texts = {".asc": can.ASCReader, ".trc": can.TRCReader, ".csv": can.CSVReader}
    if kind in texts:
        return texts[kind](_AnyText(path, named, kind))
    if kind != ".mf4":
        return {".blf": _opened_blf, ".db": _opened_database}[kind](can, path)
    try:
        return with_mf4()(path)
    except ImportError:
        text = f"reading MF4 needs the package asammdf: {how_to_install('mf4')}"
        raise LogError(f"{named}: {text}") from None


def _opened_blf(can: Any, path: Path) -> Any:
    class Bounded(can.BLFReader):  # type: ignore[misc]
        """A BLF reader with a limit, because python-can stores incomplete objects of any length."""

        def _parse_container(self, data: bytes) -> Iterator[Any]:
            yield from super()._parse_container(data)
            if len(self._tail) > FREE_BYTES:
                raise ValueError(f"an object in the file is longer than {FREE_BYTES >> 20} MiB")

    return Bounded(InPieces(path.open("rb")))


def _opened_database(can: Any, path: Path) -> Any:
    reader = can.SqliteReader(path)
    reader._conn.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, FREE_BYTES)
    return reader


class _AnyText:
    """The lines of a text in any encoding (frames are ASCII), with a limited line length.

    Relative time stamps in ASC count from the previous line, as in asc2log of can-utils. Raises
    ValueError for a line that is too long.
    """

    def __init__(self, path: Path, named: Path, kind: str) -> None:
        self._named, self._kind = named, kind
        with path.open("rb") as file:
            is_utf16 = file.read(2) in (b"\xff\xfe", b"\xfe\xff")
        encoding = "utf-16" if is_utf16 else "latin-1"
        self._file = path.open(encoding=encoding, errors="replace")
        self.buffer = self._file.buffer
        self._number, self._now, self._are_relative = 0, 0.0, False
        self._line = ""

    def words(self) -> str:
        """Return why the reader stopped at this place."""
        if len(self._line) > MAX_LINE_BYTES:
            return f"line {self._number} is longer than {MAX_LINE_BYTES} bytes"
        line = shown(self._line.strip().encode("utf-8", "replace"))
        return f"line {self._number} is not a line of {self._kind[1:].upper()}: '{line}'"

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = self._file.readline(MAX_LINE_BYTES + 1)
        if not line:
            raise StopIteration
        self._number, self._line = self._number + 1, line
        if len(line) > MAX_LINE_BYTES:
            raise ValueError(f"line {self._number} is too long")
        if self._number == 1:
            line = line.removeprefix("\xef\xbb\xbf")
        if self._kind == ".asc":
            line = _COMMA.sub(r"\1.\2", line)
        if not self._are_relative:
            self._are_relative = _RELATIVE.match(line) is not None
        elif stamp := _STAMP.match(line):
            self._now += float(stamp[0])
            line = f"{self._now:.9f}{line[stamp.end() :]}"
        if name := _NAME.match(line):
            raise LogError(
                f"{self._named}:{self._number}: '{name[1][:60]}' is a name, but an id is "
                "needed: export the log with numeric ids"
            )
        return line

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _ends_in_half_a_byte(path: Path, kind: str) -> bool:
    """Return whether a text log was cut within its last data byte. python-can's readers read the
    remaining digit as the whole byte. Any other cut makes the data too short.
    """
    if kind not in (".asc", ".trc"):
        return False
    with path.open("rb") as file:
        # the last line is shorter
        file.seek(-min(1024, path.stat().st_size), os.SEEK_END)
        last_line = file.read().rpartition(b"\n")[2]
    tokens = last_line.split()
    # words of a line before its first data byte
    if len(tokens) <= 6 or not last_line.endswith(tokens[-1]):
        return False
    # One digit that does not follow a byte or the length is the length of an empty frame.
    return len(tokens[-1]) == 1 and _BYTE_OR_LENGTH.fullmatch(tokens[-2]) is not None


def _fault(message: Any) -> str:
    """Return why a message cannot be a real frame; empty if it can."""
    if not math.isfinite(message.timestamp):
        return "bad_timestamp"
    if message.timestamp < 0:
        return "negative_timestamp"
    if (
        not 0
        <= message.arbitration_id
        <= (CAN_EFF_MASK if message.is_extended_id else CAN_SFF_MASK)
    ):
        return "bad_id"
    if len(message.data) > (FD_BYTES if message.is_fd else CLASSIC_BYTES):
        return "too_long"
    if not message.is_fd and len(message.data) == CLASSIC_BYTES < message.dlc:
        return ""  # a raw length code of 9 to 15, which means eight bytes in classic CAN
    return "bad_length" if len(message.data) != message.dlc else ""


def _channel_name(channel: object) -> str:
    """Return the name that python-can's own candump writer gives to a channel."""
    if channel is None:
        return "can0"
    return f"can{channel}" if isinstance(channel, int) else str(channel)


def _position(reader: Any) -> int:
    file: Any = getattr(reader, "file", None)
    try:
        return int(getattr(file, "buffer", file).tell())
    except (AttributeError, OSError, ValueError):
        return 0


FORMAT = PythonCanReader
