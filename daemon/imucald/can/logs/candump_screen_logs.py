"""What candump prints on a screen (not -L or -l), and what people copy from there.

    (1436509052.249713)  can0  044   [5]  2A 36 6C 2B BA      -t a
    (2015-07-10 08:17:32.249713)  can0  044   [5]  ...        -t A, taken as UTC
    (000.010250)  can0  044   [5]  ...                        -t z since the start, -t d differences
    can0  TX B -  200  [12]  11 22 ...                        -x; [two digits] is CAN FD

With -a (text), -c (colours), -i (binary digits) and -S (last byte first) too. Without time stamps,
and as cansend takes it (044#2A366C2BBA), time is counted from a message whose cycle is stated;
where no such message comes, the file is refused with a remedy.
"""

from __future__ import annotations

import itertools
import re
from calendar import timegm
from collections.abc import Callable, Iterator
from pathlib import Path
from time import strptime
from typing import ClassVar, Final, NamedTuple

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
from imucald.can.logs.candump_line import MAX_LINE_BYTES, REASONS, Line, parse_line, shown
from imucald.can.logs.frame_batches import FrameBatches
from imucald.can.logs.log_format import Cycles, ReadStatistics
from imucald.can.logs.text_blocks import OpenLog, TextBlocks, open_source
from imucald.core.errors import LogError

REMEDY: Final = "record with: candump -l can0"

_LINE: Final = re.compile(
    rb"""[ ]*(?:\((?P<stamp>[0-9][0-9 .:-]{4,30})\)[ ]+)?
    (?P<channel>[!"$-~]{1,32})[ ]+
    (?:[RT]X[ ][B-][ ][E-][ ]+)?
    (?P<id>[0-9A-F]{3}|[0-9A-F]{8})[ ]+\[(?P<length>[0-9]{1,2})\](?P<rest>(?:[ ].*)?)""",
    re.VERBOSE,
)
_CANSEND: Final = re.compile(rb"\s*[0-9A-Fa-f]{3,8}#(?:#?[0-9A-Fa-f]|R|\s|$)")
_COLOUR: Final = re.compile(rb"\x1b\[[0-9;]*m")
_DELTA_SHARE: Final = 0.2
"""Part of the steps that go back from which stamps are differences: of differences half do."""
_ERROR_ID: Final = 0x2000_0000
_LOOK_LINES: Final = 200
"""First lines by which differences are separated from times since the start."""


class ScreenFrame(NamedTuple):
    """One frame; can_id with the flag for 29 bits."""

    can_id: int
    data: bytes
    channel: str
    fd: bool


class LineFault(NamedTuple):
    """Why a line cannot be used: the reason's name, and words."""

    reason: str
    text: str


class CandumpScreenReader:
    """Reads files of candump's screen output into columns."""

    endings: ClassVar[tuple[str, ...]] = ()

    @staticmethod
    def begins(head: bytes) -> bool:
        """Whether one of the first lines is printed by candump, or is as cansend takes it."""
        lines = _COLOUR.sub(b"", head).splitlines()
        return any(_LINE.fullmatch(line.rstrip()) or _CANSEND.match(line) for line in lines[:50])

    def __init__(self, filters: IdFilters, channels: Channels, statistics: ReadStatistics) -> None:
        self._statistics = statistics
        self._batches = FrameBatches(filters, channels, statistics)
        self._time: _Times | _Counted = _Times([])
        self.cycles: Cycles = ()

    def read(
        self, path: Path | str | OpenLog, report: Callable[[int], None]
    ) -> Iterator[FrameColumns]:
        """Yield the wanted frames of one file in batches, as `LogFormat.read` says."""
        name, number, first = str(path), 0, True
        with self._statistics.until_damage(path), open_source(path) as source:
            blocks = TextBlocks(source, 0, MAX_LINE_BYTES)
            for buf, size in blocks:
                lines = _COLOUR.sub(b"", buf[:size].tobytes()).splitlines()
                if first:
                    self._time, first = self._look(lines, name), False
                yield from self._lines(lines, name, number)
                number += len(lines)
                report(blocks.bytes_read)
            rest = _COLOUR.sub(b"", blocks.rest).rstrip()
            if first:
                self._time = self._look([rest], name)
            if blocks.damage:
                text = f"{name}:{number + 1}: reading ends here: {blocks.damage}"
                self._statistics.reject("damaged_file", text)
            elif rest:
                yield from self._lines([rest], name, number, last=True)
        if isinstance(self._time, _Counted):
            self._add(self._time.rest())
        yield self._batches.columns()

    def _look(self, lines: list[bytes], name: str) -> _Times | _Counted:
        """How a file's stamps are meant. Raises LogError where it has none, and nothing counts."""
        first = lines[:_LOOK_LINES]
        matches = [m for line in first if (m := _LINE.fullmatch(line.rstrip()))]
        stamps = [m["stamp"] for m in matches if m["stamp"] is not None]
        if stamps:
            return _Times(stamps)
        frames = [f for line in first if isinstance(f := _parsed(line.rstrip()), ScreenFrame)]
        known = [
            (cycle, can_id, channel)
            for can_id, _, channel, _ in frames
            for match, cycle in self.cycles
            if match.matches(can_id, channel)
        ]
        if not known:
            text = "its frames have no time stamps, and none is of a message with a stated cycle"
            raise LogError(f"{name}: {text}; {REMEDY}")
        cycle, can_id, channel = min(known)
        self._statistics.note(
            f"{name}: no time stamps: time is counted from id 0x{can_id & CAN_EFF_MASK:X}, stated "
            f"every {1e3 * cycle:g} ms, and is only as exact as that; {REMEDY}"
        )
        return _Counted(can_id, channel, cycle)

    def _lines(
        self, lines: list[bytes], name: str, before: int, last: bool = False
    ) -> Iterator[FrameColumns]:
        for number, line in enumerate(lines, before + 1):
            fault = self._line(line.rstrip())
            if fault:
                reason, text = ("cut_line", "the line is cut") if last else fault
                self._statistics.reject(reason, f"{name}:{number}: {text}: {shown(line)}")
            if self._batches.is_full:
                yield self._batches.columns()

    def _line(self, line: bytes) -> LineFault | None:
        """Take one line; the reason why it cannot be used, and its text."""
        if not line or line.startswith(b"\t"):  # what -e explains about an error frame
            return None
        t, match = None, _LINE.fullmatch(line)
        if isinstance(self._time, _Times):  # differences count whatever the line holds
            t = None if match is None or match["stamp"] is None else self._time.of(match["stamp"])
        parsed = _as_cansend(line) if match is None else _as_printed(match)
        if isinstance(parsed, str):
            self._statistics.ignore(parsed)
            return None
        if isinstance(parsed, LineFault):
            return parsed
        if isinstance(self._time, _Counted):
            return self._add(self._time.take(parsed))
        if t is None:
            return LineFault("bad_timestamp", "the time stamp is missing, or none of candump's")
        return self._add([(t, parsed)])

    def _add(self, frames: list[tuple[float, ScreenFrame]]) -> LineFault | None:
        for t, (can_id, data, channel, fd) in frames:
            if not self._batches.add(t, can_id, data, channel, fd):
                return LineFault("too_many_channels", "more than 255 channels")
        return None


def _parsed(line: bytes) -> ScreenFrame | LineFault | str:
    """The frame of a line, why it has none, or the kind of frame that carries no data."""
    match = _LINE.fullmatch(line)
    return _as_cansend(line) if match is None else _as_printed(match)


def _as_printed(match: re.Match[bytes]) -> ScreenFrame | LineFault | str:
    channel, id_text, length_text, rest = match.group("channel", "id", "length", "rest")
    can_id, length, rest = int(id_text, 16), int(length_text), rest.strip()
    is_extended = len(id_text) == 8
    if rest.startswith(b"remote request"):
        return "remote_frame"
    if is_extended and can_id >= _ERROR_ID:
        return "error_frame"
    data = _data(rest, length)
    fd = len(length_text) == 2
    if data is None or length > (FD_BYTES if fd else CLASSIC_BYTES):
        return LineFault("bad_hex", f"these are not {length} bytes")
    if not is_extended and can_id > CAN_SFF_MASK:
        return LineFault("bad_id", "the id is not 3 digits up to 7FF")
    can_id |= CAN_EFF_FLAG if is_extended else 0
    return ScreenFrame(can_id, data, channel.decode("ascii"), fd)


def _as_cansend(line: bytes) -> ScreenFrame | LineFault | str:
    if not _CANSEND.match(line):
        return LineFault("not_candump", "not a line that candump prints")
    parsed = parse_line(b"(0.0) can0 " + line.strip())
    if isinstance(parsed, Line):
        if parsed.kind != "data":
            return parsed.kind
        return ScreenFrame(parsed.can_id, parsed.data, "can0", parsed.fd)
    return LineFault(parsed or "not_candump", REASONS[parsed or "not_candump"])


def _data(rest: bytes, length: int) -> bytes | None:
    """The bytes of a frame, printed in one of four ways; None where there are not so many."""
    if not length:
        return b""
    end = 3 * length - 1
    if rest[2:end:3] == b" " * (length - 1) and rest[end : end + 1] in b" ":  # the usual way
        try:
            data = bytes.fromhex(rest[:end].decode("ascii"))
        except ValueError:
            return None
        if len(data) == length:
            return data
    reverse = b"`" in rest[:3] or b"`" in rest[:9]
    words = rest.partition(b"   ")[0].split(b"`" if reverse else None)[:length]
    if len(words) != length:
        return None
    base = 2 if len(words[0]) == 8 else 16
    try:
        if any(len(w) != (8 if base == 2 else 2) for w in words):
            return None
        data = bytes(int(w, base) for w in words)
    except ValueError:
        return None
    return data[::-1] if reverse else data


class _Times:
    """Time stamps [s] of one file: absolute, since the start, or differences."""

    def __init__(self, first: list[bytes]) -> None:
        small = [float(s) for s in first if re.fullmatch(rb"[0-9]{1,9}\.[0-9]+", s)]
        back = sum(b < a for a, b in itertools.pairwise(small))
        self._are_steps = len(small) > 1 and back > _DELTA_SHARE * (len(small) - 1)
        self._now = 0.0
        self._days: dict[bytes, int] = {}

    def of(self, text: bytes) -> float | None:
        """The time of a stamp; None where it is not one."""
        if b":" in text:
            return self._of_date(text)
        try:
            t = float(text)
        except ValueError:
            return None
        if self._are_steps:
            self._now += t
            return self._now
        return t

    def _of_date(self, text: bytes) -> float | None:
        whole, _, part = text.partition(b".")
        if whole not in self._days:
            try:
                self._days = {whole: timegm(strptime(whole.decode(), "%Y-%m-%d %H:%M:%S"))}
            except (ValueError, UnicodeDecodeError):
                return None
        return self._days[whole] + (float(b"0." + part) if part.isdigit() else 0.0)


class _Counted:
    """Time counted from the frames of one message that comes in cycles [s]."""

    def __init__(self, can_id: int, channel: str, cycle: float) -> None:
        self._clock = can_id, channel
        self._cycle = cycle
        self._cycles = 0
        self._waiting: list[ScreenFrame] = []

    def take(self, frame: ScreenFrame) -> list[tuple[float, ScreenFrame]]:
        """Frames whose times are known now: spread over the cycle that has just ended."""
        self._waiting.append(frame)
        return self.rest() if (frame.can_id, frame.channel) == self._clock else []

    def rest(self) -> list[tuple[float, ScreenFrame]]:
        """All frames that wait, with their times."""
        waiting, self._waiting = self._waiting, []
        start, step = self._cycles * self._cycle, self._cycle / max(len(waiting), 1)
        self._cycles += 1
        return [(start + (i + 1) * step, frame) for i, frame in enumerate(waiting)]


FORMAT = CandumpScreenReader
