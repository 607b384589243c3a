"""Logs in other formats (ASC, BLF, TRC, CSV, MF4, SQLite), through python-can's readers."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

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
from imucald.can.logs.log_format import ReadStatistics
from imucald.can.logs.text_blocks import OpenLog
from imucald.core.errors import LogError

BATCH_FRAMES: Final = 8192
"""Frames of ours gathered before they are passed on."""

PROGRESS_FRAMES: Final = 20_000
"""Frames between two reports of progress."""

MAX_IDS: Final = 65_536
"""Ids whose verdict is remembered; a log with more is damaged, and is forgotten now and then."""

SPACED_FORMATS: Final = (".asc", ".trc")
"""Formats that write data bytes apart, two digits each."""

LAST_BYTES: Final = 1024
"""The last line of such a file is shorter."""

MIN_TOKENS: Final = 6
"""Words of its lines before the first data byte."""

Frame = tuple[float, int, bytes, int, bool]
"""Time [s], id with flag, payload, channel index, CAN FD."""


class PythonCanReader:
    """Reads files of other formats than candump's into columns."""

    endings: ClassVar[tuple[str, ...]] = (".asc", ".blf", ".trc", ".csv", ".mf4", ".db")

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._filters = filters
        self._channels = channels
        self._statistics = statistics
        self._verdicts: dict[tuple[int, int], bool] = {}

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in batches; `report` gets the bytes read so far.

        A file that cannot be read at all raises LogError. One that fails after some frames counts
        as one rejection ("unreadable") and ends there, since python-can's readers cannot resume.
        """
        if isinstance(path, OpenLog):
            raise LogError(f"{path}: this format is read by its file's name only")
        path = Path(path)
        before = self._statistics.frames_read
        cut = _ends_in_half_a_byte(path)
        batch: list[Frame] = []
        frame, counted = None, before
        try:
            with _open(path) as reader:
                for number, message in enumerate(reader, 1):
                    counted = self._statistics.frames_read
                    frame = self._judge(message, path, number)
                    if frame is not None:
                        batch.append(frame)
                    # The last one stays here: it may have to be taken back.
                    if len(batch) > BATCH_FRAMES:
                        yield _columns(batch[:-1], self._channels.names)
                        batch = batch[-1:]
                    if number % PROGRESS_FRAMES == 0:
                        report(_position(reader))
            if cut and self._statistics.frames_read > counted:
                self._take_back(batch, frame, path)
        except LogError:
            raise
        # What python-can's readers raise on damaged files is not documented, and is anything.
        except Exception as error:
            text = f"{path}: cannot be read: {error or type(error).__name__}"
            if self._statistics.frames_read == before:
                raise LogError(text) from error
            read = self._statistics.frames_read - before
            self._statistics.reject("unreadable", f"{text} (after {read} frames)")
        if batch:
            yield _columns(batch, self._channels.names)

    def _take_back(self, batch: list[Frame], last: Frame | None, path: Path) -> None:
        """Reject the file's last frame."""
        if last is not None:
            batch.pop()
        self._statistics.frames_read -= 1
        self._statistics.reject("cut_line", f"{path}: the last line is cut")

    def _judge(self, message: Any, path: Path, number: int) -> Frame | None:
        """Count one message; return it if it is a wanted data frame."""
        if math.isfinite(message.timestamp):
            self._statistics.stamp(message.timestamp)
        if message.is_error_frame:
            self._statistics.ignore("error_frame")
            return None
        if message.is_remote_frame:
            self._statistics.ignore("remote_frame")
            return None
        reason = _fault(message)
        channel = _channel_name(message.channel)
        index = self._channels.index(channel)
        if reason or index is None:
            reason = reason or "too_many_channels"
            text = f"{path}: message {number}: {reason.replace('_', ' ')}"
            self._statistics.reject(reason, text)
            return None
        self._statistics.frames_read += 1
        can_id = message.arbitration_id | (CAN_EFF_FLAG if message.is_extended_id else 0)
        if not self._wanted(index, can_id, channel):
            return None
        return message.timestamp, can_id, bytes(message.data), index, bool(message.is_fd)

    def _wanted(self, index: int, can_id: int, channel: str) -> bool:
        key = index, can_id
        if key not in self._verdicts:
            if len(self._verdicts) == MAX_IDS:
                self._verdicts.clear()
            self._verdicts[key] = self._filters.of(channel).wanted(can_id)
        return self._verdicts[key]


def _open(path: Path) -> Any:
    from imucald.can.python_can import can, with_mf4  # noqa: PLC0415 (costs 0.1 s)

    if path.suffix.lower() != ".mf4":
        return can.LogReader(path)
    try:
        return with_mf4()(path)
    except ImportError as error:
        raise LogError(f"{path}: reading MF4 needs the extra 'mf4' (asammdf)") from error


def _ends_in_half_a_byte(path: Path) -> bool:
    """Say whether a text log was cut within its last data byte: python-can's readers take the
    digit that is left for the byte. Any other cut makes the data too short. Raises LogError.
    """
    try:
        with path.open("rb") as file:
            if path.suffix.lower() not in SPACED_FORMATS:
                return False
            file.seek(-min(LAST_BYTES, path.stat().st_size), os.SEEK_END)
            last_line = file.read().rpartition(b"\n")[2]
    except OSError as error:
        raise LogError(f"{path}: cannot be opened: {error.strerror}") from error
    tokens = last_line.split()
    return len(tokens) > MIN_TOKENS and len(tokens[-1]) == 1 and last_line.endswith(tokens[-1])


def _fault(message: Any) -> str:
    """Return why a message cannot have been a frame, or nothing."""
    if not math.isfinite(message.timestamp) or message.timestamp < 0:
        return "bad_timestamp"
    if (
        not 0
        <= message.arbitration_id
        <= (CAN_EFF_MASK if message.is_extended_id else CAN_SFF_MASK)
    ):
        return "bad_id"
    if len(message.data) > (FD_BYTES if message.is_fd else CLASSIC_BYTES):
        return "too_long"
    return "bad_length" if len(message.data) != message.dlc else ""


def _channel_name(channel: object) -> str:
    """Return the name that python-can's own candump writer gives to a channel."""
    if channel is None:
        return "can0"
    return f"can{channel}" if isinstance(channel, int) else str(channel)


def _position(reader: Any) -> int:
    """Return how far the reader's file has been read, 0 where it does not say."""
    file: Any = getattr(reader, "file", None)
    try:
        return int(getattr(file, "buffer", file).tell())
    except (AttributeError, OSError, ValueError):
        return 0


def _columns(batch: list[Frame], channels: tuple[str, ...]) -> FrameColumns:
    t, can_id, data, channel, fd = zip(*batch, strict=True)
    length = [len(payload) for payload in data]
    width = CLASSIC_BYTES if max(length) <= CLASSIC_BYTES else FD_BYTES
    text = b"".join(payload.ljust(width, b"\0") for payload in data)
    return FrameColumns(
        np.array(t, np.float64),
        np.array(can_id, np.uint32),
        np.array(length, np.uint8),
        np.frombuffer(text, np.uint8).reshape(len(batch), width),
        np.array(channel, np.uint8),
        channels,
        np.array(fd, np.bool_) if any(fd) else None,
    )


FORMAT = PythonCanReader
