"""Read candump's screen output (without -L or -l), also if copied from a terminal.

    (1436509052.249713)  can0  044   [5]  2A 36 6C 2B BA      -t a
    (2015-07-10 08:17:32.249713)  can0  044   [5]  ...        -t A, taken as UTC
    (000.010250)  can0  044   [5]  ...                        -t z since the start, -t d differences
    can0  TX B -  200  [12]  11 22 ...                        -x; [two digits] is CAN FD

The options -a (text), -c (colours), -i (binary digits) and -S (last byte first) are accepted too.
Lines without time stamps and lines in cansend's form (044#2A366C2BBA) are accepted. Time is then
counted from a message with a stated cycle. If no such message is in the file, the file is refused
with a remedy.
"""

from __future__ import annotations

import itertools
import re
from calendar import timegm
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from time import strptime
from typing import ClassVar, Final

from imucald.can.columns import CAN_EFF_MASK, CLASSIC_BYTES, FD_BYTES, Channels, FrameColumns
from imucald.can.id_filter import IdFilters
from imucald.can.logs.candump_line import REASONS, Line, parse_line, shown
from imucald.can.logs.frame_batches import FrameBatches, read_lines
from imucald.can.logs.log_format import Cycles, ReadStatistics
from imucald.can.logs.recorder_clock import DELTA_SHARE
from imucald.can.logs.text_blocks import OpenLog
from imucald.core.errors import LogError

REMEDY: Final = "record with: candump -l can0"

OTHER_LINES: Final = 64
"""This number of consecutive lines with another form of stamps means another recording, not
damage."""

_WORDS: Final = REASONS | {
    "not_candump": "not a line that candump prints",
    "bad_hex": "the line does not have the stated number of data bytes",
    "bad_timestamp": "the time stamp is missing, or is not one of candump",
    "other_timestamp": "the time stamp has another form than in the lines before",
}

_COLOUR: Final = re.compile(rb"\x1b\[[0-9;]*m")
_PRINTED: Final = re.compile(
    rb"""[ ]*(?:\((?P<stamp>[0-9][0-9 .:-]{4,30})\)[ ]+)?
    (?P<channel>[!"$-~]{1,32})[ ]+
    (?:[RT]X[ ][B-][ ][E-][ ]+)?
    (?P<id>[0-9A-F]{3}|[0-9A-F]{8})[ ]+\[(?P<length>[0-9]{1,2})\](?P<rest>(?:[ ].*)?)""",
    re.VERBOSE,
)
_AS_CANSEND: Final = re.compile(rb"\s*[0-9A-Fa-f]{3,8}#(?:#?[0-9A-Fa-f]|R|\s|$)")


def _frame_of(text: bytes, match: re.Match[bytes] | None) -> Line | str:
    """Return the frame of a line, at time 0, or the name of the reason why it has none.

    The line is written as a line of ``candump -L``, and then parsed as such. match: match of the
    line with `_PRINTED`; None if the line does not have this form.
    """
    if match is None:
        if not _AS_CANSEND.match(text):
            return "not_candump"
        return parse_line(b"(0.0) can0 " + text.strip()) or "not_candump"
    channel, can_id, length, rest = match.group("channel", "id", "length", "rest")
    rest = rest.strip()
    if rest.startswith(b"remote request"):
        return parse_line(b"(0.0) %s %s#R" % (channel, can_id)) or "not_candump"
    data = _data(rest, int(length))
    mark, longest = (b"##0", FD_BYTES) if len(length) == 2 else (b"#", CLASSIC_BYTES)
    if data is None or len(data) > longest:
        return "bad_hex"
    line = b"(0.0) %s %s%s%s" % (channel, can_id, mark, data.hex().encode())
    return parse_line(line) or "not_candump"


def _data(rest: bytes, length: int) -> bytes | None:
    """Return the bytes of a frame, printed in one of four forms; None if the number of bytes is
    wrong."""
    if not length:
        return b""
    end = 3 * length - 1
    if rest[2:end:3] == b" " * (length - 1) and rest[end : end + 1] in b" ":  # the usual form
        try:
            data = bytes.fromhex(rest[:end].decode("ascii"))
        except ValueError:
            return None
        if len(data) == length:
            return data
    reverse = b"`" in rest[:9]
    words = rest.partition(b"   ")[0].split(b"`" if reverse else None)[:length]
    base = 2 if len(words[0]) == 8 else 16
    if len(words) != length or any(len(w) != (8 if base == 2 else 2) for w in words):
        return None
    try:
        data = bytes(int(w, base) for w in words)
    except ValueError:
        return None
    return data[::-1] if reverse else data


class _StampedTimes:
    """Time stamps [s] of one file: absolute, since the start, or differences."""

    def __init__(self, first: list[bytes]) -> None:
        """Find the form of the stamps. first: the first stamps of the file."""
        # One of the three may be damaged.
        self._are_absolute = sorted(_is_absolute(stamp) for stamp in first[:3])[len(first[:3]) // 2]
        small = [float(s) for s in first if re.fullmatch(rb"[0-9]{1,9}\.[0-9]+", s)]
        back = sum(b < a for a, b in itertools.pairwise(small))
        back_often = len(small) > 1 and back > DELTA_SHARE * (len(small) - 1)
        self._are_steps = back_often and not self._are_absolute
        self._others = self._last_other = 0
        self._now = 0.0

    def time(self, stamp: bytes, name: str, line: int) -> float | str:
        """Return the time of a line [s], or the name of the reason why its stamp gives none.

        A time difference is added even if the rest of the line is not used. Raises LogError if too
        many stamps in a row have another form than the first ones.
        """
        if _is_absolute(stamp) != self._are_absolute:
            self._count_other(name, line)
            return "other_timestamp"
        value = _seconds(stamp)
        if value is None:
            return "bad_timestamp"
        if not self._are_steps:
            return value
        self._now += value
        return self._now

    def _count_other(self, name: str, line: int) -> None:
        self._others = self._others + 1 if line == self._last_other + 1 else 1
        self._last_other = line
        if self._others >= OTHER_LINES:
            kinds = "a date or seconds since 1970", "since the start or differences"
            before, after = kinds if self._are_absolute else kinds[::-1]
            raise LogError(
                f"{name}:{line - OTHER_LINES + 1}: from here on the time stamps have another "
                f"form ({before} before, {after} now): put each recording into a file of its "
                "own"
            )


def _seconds(stamp: bytes) -> float | None:
    """Convert a stamp (a number or a date) to seconds; None if it is neither."""
    try:
        if b":" not in stamp:
            return float(stamp)
        whole, _, part = stamp.partition(b".")
        return _seconds_of_date(whole) + (float(b"0." + part) if part.isdigit() else 0.0)
    except ValueError:
        return None


@lru_cache(maxsize=1)
def _seconds_of_date(text: bytes) -> int:
    """Convert a date with time of day (UTC) to seconds since 1970. Raises ValueError."""
    return timegm(strptime(text.decode(), "%Y-%m-%d %H:%M:%S"))


def _is_absolute(stamp: bytes) -> bool:
    """True if a stamp is a date or counts from 1970: with ten digits before the point
    (``%010llu``), also if the clock was never set. Other forms have three, or as many as needed."""
    return b":" in stamp or len(stamp.partition(b".")[0]) >= 10


class _CountedTimes:
    """Time counted from the frames of one cyclic message [s].

    The frames between two frames of this message are spread evenly over the cycle between them.
    """

    def __init__(self, can_id: int, channel: str, cycle: float) -> None:
        self._sender = can_id, channel
        self._cycle = cycle
        self._cycles = self._open = 0
        self._waiting: list[tuple[int, Line]] = []
        self.first: float | None = None
        """Time of the first frame in the file [s], known once its cycle has ended."""

    def take_frame(self, frame: Line, is_wanted: bool) -> list[Line]:
        """Process the next frame. Return the wanted frames whose time is now known."""
        self._open += 1
        if is_wanted:
            self._waiting.append((self._open, frame))
        return self.end() if (frame.can_id, frame.channel) == self._sender else []

    def end(self) -> list[Line]:
        """End the last cycle, and return its wanted frames."""
        start, step = self._cycles * self._cycle, self._cycle / max(self._open, 1)
        if self._open and self.first is None:
            self.first = step
        timed = [frame._replace(t=start + place * step) for place, frame in self._waiting]
        self._waiting, self._open, self._cycles = [], 0, self._cycles + 1
        return timed


class CandumpScreenReader:
    """Reads files of candump's screen output into columns, line by line."""

    endings: ClassVar[tuple[str, ...]] = ()

    @staticmethod
    def begins(head: bytes) -> bool:
        """True if one of the first lines has the form of candump's output or of cansend's input."""
        lines = _COLOUR.sub(b"", head).splitlines()
        return any(
            _PRINTED.fullmatch(line.rstrip()) or _AS_CANSEND.match(line) for line in lines[:50]
        )

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._channels = channels
        self._statistics = statistics
        self._batches = FrameBatches(filters, channels, statistics)
        self._time: _StampedTimes | _CountedTimes | None = None
        self.cycles: Cycles = ()

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in batches, see `LogFormat.read`."""
        self._time = None  # each file may have another form of stamps
        yield from read_lines(path, self._batches, self._statistics, report, self._take)
        if isinstance(self._time, _CountedTimes):
            self._add_counted(self._time, self._time.end())
            yield self._batches.columns()

    def _take(self, lines: list[bytes], name: str, before: int, last: bool) -> None:
        lines = [_COLOUR.sub(b"", line).rstrip() for line in lines]
        if self._time is None:
            self._time = self._look(lines[:200], name)
        for number, line in enumerate(lines, before + 1):
            if line and not line.startswith(b"\t"):  # explanation of an error frame (-e)
                reason = self._line(self._time, line, name, number)
                if reason:
                    reason = "cut_line" if last else reason
                    words = f"{_WORDS[reason]}: {shown(line)}"
                    reason = reason.replace("other_timestamp", "bad_timestamp")
                    self._statistics.reject_line(reason, name, number, words)

    def _line(
        self, time: _StampedTimes | _CountedTimes, line: bytes, name: str, number: int
    ) -> str:
        """Process one line. Return the reason why it cannot be used; empty if it is good."""
        match = _PRINTED.fullmatch(line)
        stamp = None if match is None else match["stamp"]
        t: float | str = 0.0
        if isinstance(time, _StampedTimes):
            t = "bad_timestamp" if stamp is None else time.time(stamp, name, number)
        frame = _frame_of(line, match)
        if isinstance(frame, str):
            return frame
        if frame.kind != "data":
            self._statistics.ignore(frame.kind)
            return ""
        if isinstance(t, str):
            return t
        index = self._channels.index(frame.channel)
        if index is None:
            return "too_many_channels"
        if isinstance(time, _CountedTimes):
            is_wanted = self._batches.is_wanted(index, frame.can_id, frame.channel)
            self._statistics.frames_read += not is_wanted
            self._add_counted(time, time.take_frame(frame, is_wanted))
        else:
            self._batches.add_frame(t, frame.can_id, frame.data, frame.channel, frame.fd)
        return ""

    def _add_counted(self, time: _CountedTimes, frames: list[Line]) -> None:
        if time.first is not None:
            self._statistics.stamp(time.first)
        for frame in frames:
            self._batches.add_frame(frame.t, frame.can_id, frame.data, frame.channel, frame.fd)

    def _look(self, first: list[bytes], name: str) -> _StampedTimes | _CountedTimes:
        """Find the form of a file's time stamps.

        Raises LogError if it has no time stamps and no message to count time from.
        """
        matches = [_PRINTED.fullmatch(line) for line in first]
        stamps = [m["stamp"] for m in matches if m is not None and m["stamp"] is not None]
        if stamps:
            return _StampedTimes(stamps)
        parsed = [_frame_of(line, m) for line, m in zip(first, matches, strict=True)]
        known = [
            (cycle, frame.can_id, frame.channel)
            for frame in parsed
            if isinstance(frame, Line) and frame.kind == "data"
            for match, cycle in self.cycles
            if match.matches(frame.can_id, frame.channel)
        ]
        if not known:
            text = "its frames have no time stamps, and no message in it has a stated cycle"
            raise LogError(f"{name}: {text}; {REMEDY}")
        cycle, can_id, channel = min(known)
        self._statistics.note(
            f"{name}: the log has no time stamps. The time is counted by id "
            f"0x{can_id & CAN_EFF_MASK:X}, which should come every {1e3 * cycle:g} ms, and is "
            f"only roughly right; {REMEDY}"
        )
        return _CountedTimes(can_id, channel, cycle)


FORMAT = CandumpScreenReader
