"""Collect counts and ranges of the decoded values of routes, for `imucald check`.

A `Probe` replaces a route in a router. It passes everything on unchanged and collects statistics:
frames, cycle, rejections by reason, and the range of each signal in its own unit and in SI.
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
from imucald.inputs.taps import Columns, Physical, Raw, Tap

CYCLE_FRAMES = 5000
"""Largest number of frames for the median that gives the observed cycle."""
STOPPED_S, STOPPED_CYCLES = 10.0, 20.0
"""A message is reported as stopped if it ends this time [s] and this number of cycles before the
end of the log."""


class Range:
    """Smallest, mean and largest of numbers that are added in pieces."""

    def __init__(self) -> None:
        self.count = 0
        self.least = math.inf
        self.largest = -math.inf
        self._sum = 0.0

    def add(self, values: Array) -> None:
        """Add finite values (N,)."""
        if not len(values):
            return
        self.count += len(values)
        self.least = min(self.least, float(values.min()))
        self.largest = max(self.largest, float(values.max()))
        self._sum += float(values.sum())

    @property
    def mean(self) -> float:
        """The mean; NaN if there is no value."""
        return self._sum / self.count if self.count else math.nan

    def as_dict(self) -> dict[str, float | None]:
        """Return the three values for JSON."""
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
    """Statistics of one signal of a tap. rejected: numbers by reason, without absent values."""

    def __init__(self, conversion: Conversion) -> None:
        self.conversion = conversion
        self.physical = Range()
        self.si = Range()
        self.rejected: Counter[str] = Counter()

    def add(self, raw: NDArray[np.generic], physical: Array) -> None:
        """Add raw and physical values (N,)."""
        values, codes = self.conversion.array(raw, physical)
        good = codes == 0
        self.physical.add(physical[good])
        self.si.add(values[good])
        for code in np.unique(codes[~good]).tolist():
            self.rejected[REASONS[code]] += int(np.count_nonzero(codes == code))


class _CountingGuard:
    """Wraps the guard of a route, and counts its rejections by reason."""

    def __init__(self, guard: JudgesRate, refused: Counter[str]) -> None:
        self._guard = guard
        self._refused = refused

    def judge(self, t: float, reason: str) -> str:
        """Call the guard; not counted."""
        return self._guard.judge(t, reason)

    def judge_columns(
        self, t: Array, good: NDArray[np.bool_], reasons: Mapping[str, Rows]
    ) -> dict[str, Rows]:
        """Call the guard, and count its rejections."""
        found = self._guard.judge_columns(t, good, reasons)
        for reason, rows in found.items():
            self._refused[reason] += len(rows)
        return found


class _Times:
    """The times of the frames of one kind."""

    def __init__(self) -> None:
        self._intervals: list[Array] = []
        self._count = 0
        self.last: float | None = None
        """Stream time of the last frame [s]."""

    def add(self, t: Array) -> None:
        """Add the times (N,) of the next frames."""
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
        """Median time between two frames [s]."""
        return float(np.median(np.concatenate(self._intervals))) if self._count else None

    def lost_share(self, message: Message | None = None) -> float | None:
        """Share of lost frames, from the times. message: the message of all these frames."""
        return lost_share(np.concatenate(self._intervals), message) if self._count else None


class Probe:
    """A route that collects statistics of its frames (only for columns)."""

    def __init__(self, route: SignalRoute) -> None:
        self.route = route
        self.frames = 0
        """Number of frames of this kind, good or not."""
        self.shortest = FD_BYTES
        """Length of the shortest frame [bytes]."""
        self.rejected: Counter[str] = Counter()
        """Number of completely rejected frames, by reason."""
        self.guard: JudgesRate = _CountingGuard(route.guard, self.rejected)
        self.signals = {
            (tap.channel, tap.rank, slot): SignalStatistics(component.conversion)
            for tap in route.taps
            for component, slot in zip(tap.components, tap.slots, strict=True)
        }
        self._times = _Times()
        self._of_groups: dict[Selectors, _Times] = {}
        """Times of the frames of each multiplexer group, because each group has its own cycle."""
        self.addresses: set[int] = set()
        """J1939 source addresses with accepted frames. Each sender has its own cycle."""

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
        """The route's frame key."""
        return self.route.frame_key

    def source_of(self, tap: Tap) -> Hashable:
        """Call the route's method."""
        return self.route.source_of(tap)

    def go_on_from(self, former: SignalRoute) -> None:
        """Call the route's method; the statistics are kept."""
        self.route.go_on_from(former)

    @property
    def refused(self) -> Counter[str]:
        """`rejected` without copies: one frame of each copied pair is accepted, so none is lost."""
        return Counter({reason: n for reason, n in self.rejected.items() if reason != DOUBLED})

    @property
    def cycle(self) -> float | None:
        """Usual time between frames [s]; None with less than two frames or several senders."""
        return None if len(self.addresses) > 1 else self._times.cycle

    @property
    def cycles(self) -> tuple[float, ...]:
        """`cycle`, or the cycle of each used multiplexer group, the slowest first."""
        if not self._of_groups:
            return () if self.cycle is None else (self.cycle,)
        found = {self._cycle_of(tap) for tap in self.taps} - {None}
        return tuple(sorted((c for c in found if c is not None), reverse=True))

    def cycle_of(self, channel: str) -> float | None:
        """`cycle` of the signals for one channel; with groups, that of the slowest group."""
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
        """Return the time of the last frame if a regular message (or group) stopped early."""
        for times in self._of_groups.values() if self._of_groups else (self._times,):
            usual, last = times.cycle, times.last
            if usual is None or last is None:
                continue
            if end - last > max(STOPPED_S, STOPPED_CYCLES * usual):
                return last
        return None

    @property
    def lost_share(self) -> float | None:
        """Share of lost frames, from the times or from the counter, whichever is larger.

        A counter does not show a gap in which it wraps. None for a message that is not cyclic and
        has no counter, and for several senders.
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
        """Call the route's method, and count frames and rejections."""
        ok, reasons = self.route.check_columns(t, frames)
        for reason, rows in reasons.items():
            self.rejected[reason] += len(rows)
        ours = ok.copy()
        for rows in reasons.values():
            ours[rows] = True
        self.frames += int(np.count_nonzero(ours))
        if len(frames) and ours.any():
            self.shortest = min(self.shortest, int(frames.length[ours].min()))
        if DOUBLED in reasons:  # the original frame has the same time
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
