"""CSV of SavvyCAN and other GVRET programs. The headings identify the columns.

    Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8
    166064000,0000021A,false,Rx,0,8,FE,36,12,FE,69,05,07,AD,

Time stamps are in microseconds; ids and bytes are hexadecimal. Older files have no direction.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import ClassVar, Final

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
from imucald.can.logs.candump_line import shown, words_of
from imucald.can.logs.frame_batches import FrameBatches, read_lines
from imucald.can.logs.log_format import ReadStatistics
from imucald.can.logs.text_blocks import OpenLog
from imucald.core.errors import LogError

_HEADING: Final = re.compile(rb"(?:\xef\xbb\xbf)?\s*Time Stamp,ID,Extended,", re.IGNORECASE)


class GvretReader:
    """Reads files of GVRET CSV into columns."""

    endings: ClassVar[tuple[str, ...]] = ()

    @staticmethod
    def begins(head: bytes) -> bool:
        """True if the first line is the heading of SavvyCAN."""
        return _HEADING.match(head) is not None

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._statistics = statistics
        self._batches = FrameBatches(filters, channels, statistics)
        self._places: dict[str, int] = {}

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in batches, see `LogFormat.read`."""
        self._places = {}
        return read_lines(path, self._batches, self._statistics, report, self._take)

    def _take(self, lines: list[bytes], name: str, before: int, last: bool) -> None:
        for number, line in enumerate(lines, before + 1):
            if not self._places:
                self._places = _places(line, name)
                continue
            reason = self._line(line)
            if reason:
                reason = "cut_line" if last else reason
                text = f"{name}:{number}: {words_of(reason)}: {shown(line)}"
                self._statistics.reject(reason, text)

    def _line(self, line: bytes) -> str:
        words = line.strip().split(b",")
        if words == [b""]:
            return ""
        at = self._places
        try:
            t = int(words[at["time stamp"]]) * 1e-6
            can_id = int(words[at["id"]], 16)
            length = int(words[at["len"]])
            bus = int(words[at["bus"]])
            extended = words[at["extended"]].strip().lower() in (b"true", b"1")
            data = bytes(int(w, 16) for w in words[at["d1"] : at["d1"] + length])
        except (ValueError, IndexError, OverflowError):
            return "bad_line"
        if t < 0:
            return "negative_timestamp"
        if not 0 <= can_id <= (CAN_EFF_MASK if extended else CAN_SFF_MASK):
            return "bad_id"
        if len(data) != length or not 0 <= length <= FD_BYTES:
            return "bad_length"
        wire_id = can_id | (CAN_EFF_FLAG if extended else 0)
        added = self._batches.add_frame(t, wire_id, data, f"can{bus}", length > CLASSIC_BYTES)
        return "" if added else "too_many_channels"


def _places(line: bytes, name: str) -> dict[str, int]:
    """Return the position of each column. Raises LogError if a required column is missing."""
    words = line.decode("utf-8-sig", "replace").strip().lower().split(",")
    places = {word.strip(): i for i, word in enumerate(words)}
    missing = [
        word for word in ("time stamp", "id", "extended", "bus", "len", "d1") if word not in places
    ]
    if missing:
        raise LogError(f"{name}:1: the column {missing[0]!r} of SavvyCAN's CSV is missing")
    return places


FORMAT = GvretReader
