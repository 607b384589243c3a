"""When the frames of candump's screen output were: by their stamps, or counted from a message."""

from __future__ import annotations

import itertools
import re
from calendar import timegm
from time import strptime
from typing import Final

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, concatenate
from imucald.can.logs.ascii_columns import Index
from imucald.can.logs.recorder_clock import DELTA_SHARE
from imucald.core.errors import LogError

SECONDS_DIGITS: Final = 10
"""Digits before the point with which candump prints seconds since 1970 (``%010llu``), also those of
a clock that was never set; others have three, or as many as they need."""
OTHER_LINES: Final = 64
"""So many lines in a row with stamps of another form are no damage: another recording follows."""


class StampedTimes:
    """Time stamps [s] of one file: absolute, since the start, or differences."""

    def __init__(self, first: list[bytes]) -> None:
        """first: the first stamps of the file."""
        # One of three may be damaged.
        self._are_absolute = sorted(_is_absolute(stamp) for stamp in first[:3])[len(first[:3]) // 2]
        small = [float(s) for s in first if re.fullmatch(rb"[0-9]{1,9}\.[0-9]+", s)]
        back = sum(b < a for a, b in itertools.pairwise(small))
        back_often = len(small) > 1 and back > DELTA_SHARE * (len(small) - 1)
        self._are_steps = back_often and not self._are_absolute
        self._others = self._last_other = 0
        self._now = 0.0
        self._days: dict[bytes, int] = {}

    def fits(self, stamp: bytes | None) -> bool:
        """Whether a stamp, if there is one, has the form of the file's first ones: time of day, or
        not."""
        return stamp is None or _is_absolute(stamp) == self._are_absolute

    def other(self, name: str, line: int) -> None:
        """Take note of a line whose stamp does not fit. Raises LogError where all do from one on.

        name: of the file; line: its number.
        """
        self._others = self._others + 1 if line == self._last_other + 1 else 1
        self._last_other = line
        if self._others >= OTHER_LINES:
            kinds = "seconds since 1970 or a date", "since the start or differences"
            before, after = kinds if self._are_absolute else kinds[::-1]
            raise LogError(
                f"{name}:{line - OTHER_LINES + 1}: from here on the time stamps have another form "
                f"({before} before, {after} now): give each recording in a file of its own"
            )

    def value(self, text: bytes) -> float | None:
        """The number or the date [s] that a stamp spells; None where it is neither."""
        whole, _, part = text.partition(b".")
        if b":" not in text:
            try:
                return float(text)
            except ValueError:
                return None
        date = self.date(whole)
        if date is None:
            return None
        return date + (float(b"0." + part) if part.isdigit() else 0.0)

    def date(self, text: bytes) -> int | None:
        """Seconds since 1970 of a date and time of day, in UTC; None where it is none."""
        if text not in self._days:
            try:
                self._days = {text: timegm(strptime(text.decode(), "%Y-%m-%d %H:%M:%S"))}
            except (ValueError, UnicodeDecodeError):
                return None
        return self._days[text]

    def times(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """When lines were printed, from what their stamps spell (NaN: none); both (N,).

        Differences count whatever else the line holds.
        """
        if not self._are_steps:
            return values
        missing = np.isnan(values)
        steps = np.where(missing, 0.0, values)
        t = np.add.accumulate(np.concatenate([[self._now], steps]))[1:]
        self._now = float(t[-1]) if len(t) else self._now
        t[missing] = np.nan
        return t


def _is_absolute(stamp: bytes) -> bool:
    """Whether a stamp is a date or counts from 1970."""
    return b":" in stamp or len(stamp.partition(b".")[0]) >= SECONDS_DIGITS


class CountedTimes:
    """Time counted from the frames of one message that comes in cycles [s].

    The frames between two of them are spread over the cycle that the second one ends.
    """

    def __init__(self, can_id: int, channel: str, cycle: float) -> None:
        self.can_id = can_id
        self.channel = channel
        self._cycle = cycle
        self._cycles = 0
        self._open = 0
        self._waiting: FrameColumns | None = None
        self._places: Index = np.zeros(0, np.intp)
        self.first: float | None = None
        """Of the first frame of all [s], once its cycle has ended."""

    def take(self, frames: FrameColumns, places: Index, ends: Index, count: int) -> FrameColumns:
        """Take the next `count` frames; return those whose time is known now, with it.

        frames: the wanted ones, W of them, without time; places: (W,) their numbers among all;
        ends: (E,) the numbers of the message's frames.
        """
        if self._waiting is not None:
            frames = concatenate([self._waiting, frames])
        places = np.concatenate([self._places, places + self._open])
        ends, count = ends + self._open, count + self._open
        starts = np.concatenate([[-1], ends])
        cycle = np.searchsorted(ends, places)
        known = cycle < len(ends)
        self._waiting, self._places = frames.take(~known), places[~known] - (starts[-1] + 1)
        self._open = count - (int(starts[-1]) + 1)
        frames, places, cycle = frames.take(known), places[known], cycle[known]
        if len(ends) and self.first is None:
            self.first = self._cycle / int(ends[0] + 1)
        t = np.zeros(0)
        if len(ends):
            step = self._cycle / np.diff(starts)[cycle]
            t = (self._cycles + cycle) * self._cycle + (places - starts[cycle]) * step
        self._cycles += len(ends)
        return frames.at(t)

    def rest(self) -> FrameColumns | None:
        """All wanted frames that wait, with their times."""
        waiting, self._waiting = self._waiting, None
        if waiting is None:
            return None
        step = self._cycle / max(self._open, 1)
        if self._open and self.first is None:
            self.first = step
        t = np.float64(self._cycles * self._cycle) + (self._places + 1) * step
        self._places, self._open, self._cycles = self._places[:0], 0, self._cycles + 1
        return waiting.at(t)
