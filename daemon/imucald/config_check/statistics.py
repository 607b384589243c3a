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

from imucald.can.columns import FD_BYTES, IdMatch
from imucald.can.dbc.message import Message, Selectors
from imucald.can.e2e.protection import DOUBLED
from imucald.can.lost_frames import lost_share
from imucald.core.arrays import Array
from imucald.inputs.conversion import REASONS, Conversion
from imucald.inputs.rate_guard import JudgesRate, Rows
from imucald.inputs.routes import Carried, MessageRoute, SignalRoute
from imucald.inputs.sender_choice import SenderChoice
from imucald.inputs.taps import Columns, Physical, Raw, Tap, TapColumns, arrays_of

CYCLE_FRAMES = 5000
"""The cycle seen is the median over so many frames at most."""
STOPPED_S, STOPPED_CYCLES = 10.0, 20.0
"""A message that stops so long before the end [s], and so many of its cycles, is reported."""


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


class _Times:
    """When frames of one kind came."""

    def __init__(self) -> None:
        self._intervals: list[Array] = []
        self._count = 0
        self.last: float | None = None
        """Stream time of the last frame [s]."""

    def add(self, t: Array) -> None:
        """Take the times (N,) of the next frames."""
        if not len(t):
            return
        if self._count < CYCLE_FRAMES:
            before = [] if self.last is None else [self.last]
            intervals = np.diff(np.concatenate([before, t]))[: CYCLE_FRAMES - self._count]
            self._intervals.append(intervals)
            self._count += len(intervals)
        self.last = float(t[-1])

    @property
    def cycle(self) -> float | None:
        """Median time between two of them [s]."""
        return float(np.median(np.concatenate(self._intervals))) if self._count else None

    def lost_share(self, message: Message | None = None) -> float | None:
        """Share of them that did not come, by the times; message: whose they are, all together."""
        return lost_share(np.concatenate(self._intervals), message) if self._count else None


class Probe:
    """A route that keeps figures of what passes through it (columns only)."""

    def __init__(self, route: SignalRoute) -> None:
        self.route = route
        self.frames = 0
        """Frames of this kind, good or not."""
        self.shortest = FD_BYTES
        """Bytes of the shortest of them."""
        self.rejected: Counter[str] = Counter()
        """Frames rejected whole, by reason."""
        self.guard: JudgesRate = _CountingGuard(route.guard, self.rejected)
        self.signals = {
            (tap.channel, tap.rank, slot): SignalStatistics(component.conversion)
            for tap in route.taps
            for component, slot in zip(tap.components, tap.slots, strict=True)
        }
        self._times = _Times()
        self._of_groups: dict[Selectors, _Times] = {}
        """The same of the frames that carry a signal of a multiplexer: groups have their cycles."""
        self.addresses: set[int] = set()
        """J1939 source addresses whose frames are all taken: of several, each has its own cycle."""

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
    def sender(self) -> SenderChoice | None:
        """The route's choice among senders."""
        return self.route.sender

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
        """Usual time between frames [s], None before two of them and for several senders."""
        return None if len(self.addresses) > 1 else self._times.cycle

    @property
    def cycles(self) -> tuple[float, ...]:
        """`cycle`, or that of each group of the multiplexer that is used, the slowest first."""
        if not self._of_groups:
            return () if self.cycle is None else (self.cycle,)
        found = {self._cycle_of(tap) for tap in self.taps} - {None}
        return tuple(sorted((c for c in found if c is not None), reverse=True))

    def cycle_of(self, channel: str) -> float | None:
        """`cycle` of the signals for one channel: of its slowest one where there are groups."""
        found = [self._cycle_of(tap) for tap in self.taps if tap.channel == channel]
        return max((c for c in found if c is not None), default=None)

    def _cycle_of(self, tap: Tap) -> float | None:
        times = [self._of_groups.get(s) for s in self._selectors(tap)]
        groups = [one.cycle for one in times if one is not None]
        return max((c for c in groups if c is not None), default=self.cycle)

    def _selectors(self, tap: Tap) -> list[Selectors]:
        route = self.route
        if not isinstance(route, MessageRoute):
            return []
        return [route.plan.signals[component.index].selectors for component in tap.components]

    def has_stopped(self, end: float) -> float | None:
        """When what came regularly, or a group of it, came last, if that is long before the end."""
        for times in self._of_groups.values() if self._of_groups else (self._times,):
            usual, last = times.cycle, times.last
            if usual is None or last is None:
                continue
            if end - last > max(STOPPED_S, STOPPED_CYCLES * usual):
                return last
        return None

    @property
    def lost_share(self) -> float | None:
        """Share of the frames that did not come: by the times, or by the counter if that is more.

        A counter does not tell a hole in which it went round. None for a message that is not sent
        in cycles and has no counter, and of several senders.
        """
        if len(self.addresses) > 1:
            return None
        route = self.route if isinstance(self.route, MessageRoute) else None
        message = None if route is None else route.plan.message
        checker = None if route is None else route.checker
        shares = [one.lost_share() for one in self._of_groups.values()]
        if not self._of_groups:
            shares = [self._times.lost_share(message)]
        if checker is not None and checker.spec.counter is not None and self.frames:
            shares.append(checker.lost / (checker.lost + self.frames))
        return max((share for share in shares if share is not None), default=None)

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
        if len(frames) and ours.any():
            self.shortest = min(self.shortest, int(frames.length[ours].min()))
        if DOUBLED in reasons:  # their original has the time
            ours[reasons[DOUBLED]] = False
        self._times.add(t[ours])
        if isinstance(self.route, MessageRoute):
            presence = self.route.plan.presence(frames.data, frames.length)
            for selectors, present in presence.items():
                self._of_groups.setdefault(selectors, _Times()).add(t[ours & present])
        return ok, reasons

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
