"""Counts and ranges of what routes decode, taken on the way, for `imucald check`.

A `Probe` stands in a router in a route's place. It hands everything on unchanged and keeps the
figures: frames, cycle, rejections by reason, and range of each signal in its own unit and in SI.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Hashable, Mapping

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import IdMatch
from imucald.can.e2e.protection import DOUBLED
from imucald.inputs.conversion import REASONS, Conversion
from imucald.inputs.rate_guard import JudgesRate, Rows
from imucald.inputs.routes import Carried, SignalRoute
from imucald.inputs.taps import Columns, Physical, Raw, Tap, TapColumns, arrays_of

Array = NDArray[np.float64]

CYCLE_FRAMES = 5000
"""The cycle seen is the median over so many frames at most."""


class Range:
    """Least, mean and largest of numbers that come in pieces."""

    def __init__(self) -> None:
        self.count = 0
        self.least = math.inf
        self.largest = -math.inf
        self._sum = 0.0

    def add(self, values: Array) -> None:
        """Take finite values (N,)."""
        if not len(values):
            return
        self.count += len(values)
        self.least = min(self.least, float(values.min()))
        self.largest = max(self.largest, float(values.max()))
        self._sum += float(values.sum())

    @property
    def mean(self) -> float:
        """Their mean; NaN without any."""
        return self._sum / self.count if self.count else math.nan

    def as_dict(self) -> dict[str, float | None]:
        """The three figures, for JSON."""
        if not self.count:
            return {"min": None, "mean": None, "max": None}
        return {
            "min": _figure(self.least),
            "mean": _figure(self.mean),
            "max": _figure(self.largest),
        }


def _figure(value: float) -> float:
    return float(f"{value:.6g}")


class SignalStatistics:
    """One signal of one tap. rejected: values by reason; absent ones (multiplexer) do not count."""

    def __init__(self, conversion: Conversion) -> None:
        self.conversion = conversion
        self.physical = Range()
        self.si = Range()
        self.rejected: Counter[str] = Counter()

    def add(self, raw: NDArray[np.generic], physical: Array) -> None:
        """Take raw and physical values (N,)."""
        values, codes = self.conversion.array(raw, physical)
        good = codes == 0
        self.physical.add(physical[good])
        self.si.add(values[good])
        for code in np.unique(codes[~good]).tolist():
            self.rejected[REASONS[code]] += int(np.count_nonzero(codes == code))


class _CountingGuard:
    """A route's guard; counts what it refuses, by reason."""

    def __init__(self, guard: JudgesRate, refused: Counter[str]) -> None:
        self._guard = guard
        self._refused = refused

    def judge(self, t: float, reason: str) -> str:
        """As the guard; not counted."""
        return self._guard.judge(t, reason)

    def judge_columns(
        self, t: Array, good: NDArray[np.bool_], reasons: Mapping[str, Rows]
    ) -> dict[str, Rows]:
        """As the guard; counted."""
        found = self._guard.judge_columns(t, good, reasons)
        for reason, rows in found.items():
            self._refused[reason] += len(rows)
        return found


class Probe:
    """A route that keeps figures of what passes through it (columns only)."""

    def __init__(self, route: SignalRoute) -> None:
        self.route = route
        self.frames = 0
        """Frames of this kind, good or not."""
        self.rejected: Counter[str] = Counter()
        """Frames rejected whole, by reason."""
        self.guard: JudgesRate = _CountingGuard(route.guard, self.rejected)
        self.signals = {
            (tap.channel, tap.rank, slot): SignalStatistics(component.conversion)
            for tap in route.taps
            for component, slot in zip(tap.components, tap.slots, strict=True)
        }
        self._intervals: list[Array] = []
        self._interval_count = 0
        self.last: float | None = None
        """Stream time of the last frame [s]."""

    @property
    def name(self) -> str:
        """The route's name."""
        return self.route.name

    @property
    def match(self) -> IdMatch:
        """The route's frames."""
        return self.route.match

    @property
    def taps(self) -> tuple[Tap, ...]:
        """The route's taps."""
        return self.route.taps

    @property
    def stated_cycle(self) -> float | None:
        """The route's cycle [s], as stated."""
        return self.route.stated_cycle

    @property
    def frame_key(self) -> Hashable:
        """The route's."""
        return self.route.frame_key

    def source_of(self, tap: Tap) -> Hashable:
        """As the route."""
        return self.route.source_of(tap)

    def go_on_from(self, former: SignalRoute) -> None:
        """As the route; the figures stay."""
        self.route.go_on_from(former)

    @property
    def refused(self) -> Counter[str]:
        """The same without copies: of a frame that came twice one is taken, and nothing is lost."""
        return Counter({reason: n for reason, n in self.rejected.items() if reason != DOUBLED})

    @property
    def cycle(self) -> float | None:
        """Median time between frames [s], None before two of them."""
        if not self._interval_count:
            return None
        return float(np.median(np.concatenate(self._intervals)))

    def check(self, t: float, data: bytes) -> str | None:
        """As the route; not counted."""
        return self.route.check(t, data)

    def numbers(self, data: bytes) -> tuple[Raw, Physical]:
        """As the route; not counted."""
        return self.route.numbers(data)

    def check_columns(
        self, t: Array, frames: Carried
    ) -> tuple[NDArray[np.bool_], Mapping[str, NDArray[np.int64]]]:
        """As the route; counted."""
        ok, reasons = self.route.check_columns(t, frames)
        for reason, rows in reasons.items():
            self.rejected[reason] += len(rows)
        ours = ok.copy()
        for rows in reasons.values():
            ours[rows] = True
        self.frames += int(np.count_nonzero(ours))
        if DOUBLED in reasons:  # their original has the time
            ours[reasons[DOUBLED]] = False
        self._time(t[ours])
        return ok, reasons

    def _time(self, t: Array) -> None:
        if not len(t):
            return
        if self._interval_count < CYCLE_FRAMES:
            before = [] if self.last is None else [self.last]
            intervals = np.diff(np.concatenate([before, t]))[: CYCLE_FRAMES - self._interval_count]
            self._intervals.append(intervals)
            self._interval_count += len(intervals)
        self.last = float(t[-1])

    def number_columns(self, frames: Carried) -> Columns:
        """As the route; ranges are taken."""
        columns = self.route.number_columns(frames)
        for tap in self.route.taps:
            for component, slot in zip(tap.components, tap.slots, strict=True):
                raw, physical, present = columns[component.index]
                if present is not None:
                    raw, physical = raw[present], physical[present]
                self.signals[tap.channel, tap.rank, slot].add(raw, physical)
        return columns

    def tap_columns(self, frames: Carried) -> TapColumns:
        """As the route; ranges are taken."""
        return arrays_of(self.route.taps, self.number_columns(frames))
