"""Times of the frames in candump's screen output: from time stamps, or counted from a message."""

from __future__ import annotations

import itertools
import re
from calendar import timegm
from time import strptime
from typing import Final

from imucald.can.logs.candump_screen_line import ScreenFrame
from imucald.can.logs.recorder_clock import DELTA_SHARE
from imucald.core.errors import LogError

SECONDS_DIGITS: Final = 10
"""Number of digits before the point in candump's seconds since 1970 (``%010llu``), also if the
clock was never set. Other forms have three digits, or as many as needed."""
OTHER_LINES: Final = 64
"""This number of consecutive lines with another form of stamps means another recording, not
damage."""


class StampedTimes:
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
        self._days: dict[bytes, int] = {}

    def fits(self, stamp: bytes) -> bool:
        """True if a stamp has the form of the file's first stamps: time of day, or not."""
        return _is_absolute(stamp) == self._are_absolute

    def other(self, name: str, line: int) -> None:
        """Register a line with another form of stamp. Raises LogError if too many follow in a row.

        name: the file's name. line: the line's number.
        """
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

    def time(self, stamp: bytes) -> float | None:
        """Return the time of a line [s]; None if its stamp is neither a number nor a date.

        A time difference is added even if the rest of the line is not used.
        """
        value = self._value(stamp)
        if value is None or not self._are_steps:
            return value
        self._now += value
        return self._now

    def _value(self, text: bytes) -> float | None:
        """Convert a stamp (a number or a date) to seconds."""
        whole, _, part = text.partition(b".")
        if b":" not in text:
            try:
                return float(text)
            except ValueError:
                return None
        date = self._date(whole)
        if date is None:
            return None
        return date + (float(b"0." + part) if part.isdigit() else 0.0)

    def _date(self, text: bytes) -> int | None:
        """Convert a date with time of day (UTC) to seconds since 1970; None if it is invalid."""
        if text not in self._days:
            try:
                self._days = {text: timegm(strptime(text.decode(), "%Y-%m-%d %H:%M:%S"))}
            except (ValueError, UnicodeDecodeError):
                return None
        return self._days[text]


def _is_absolute(stamp: bytes) -> bool:
    """True if a stamp is a date or counts from 1970."""
    return b":" in stamp or len(stamp.partition(b".")[0]) >= SECONDS_DIGITS


class CountedTimes:
    """Time counted from the frames of one cyclic message [s].

    The frames between two frames of this message are spread evenly over the cycle between them.
    """

    def __init__(self, can_id: int, channel: str, cycle: float) -> None:
        self.can_id = can_id
        self.channel = channel
        self._cycle = cycle
        self._cycles = self._open = 0
        self._waiting: list[tuple[int, ScreenFrame]] = []
        self.first: float | None = None
        """Time of the first frame in the file [s], known once its cycle has ended."""

    def take_frame(self, frame: ScreenFrame, is_wanted: bool) -> list[tuple[float, ScreenFrame]]:
        """Process the next frame. Return the wanted frames whose time is now known, with times."""
        self._open += 1
        if is_wanted:
            self._waiting.append((self._open, frame))
        is_end = frame.can_id == self.can_id and frame.channel == self.channel
        return self.end() if is_end else []

    def end(self) -> list[tuple[float, ScreenFrame]]:
        """End the last cycle, and return its wanted frames with their times."""
        start, step = self._cycles * self._cycle, self._cycle / max(self._open, 1)
        if self._open and self.first is None:
            self.first = step
        timed = [(start + place * step, frame) for place, frame in self._waiting]
        self._waiting, self._open, self._cycles = [], 0, self._cycles + 1
        return timed
