"""Collect counts and ranges of the decoded values of routes, for `imucald check`.

A `Probe` watches a route of a router and collects statistics: frames, cycle, rejections by reason,
and the range of each signal in its own unit and in SI.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FD_BYTES
from imucald.can.dbc.bits import Columns as Bytes
from imucald.can.dbc.decode import J1939_ADDRESS_MASK
from imucald.can.dbc.message import Message, Selectors
from imucald.can.e2e.protection import DOUBLED
from imucald.can.lost_frames import lost_share
from imucald.core.arrays import Array, Index
from imucald.inputs.conversion import REASONS, Conversion
from imucald.inputs.routes import MessageRoute, SignalRoute
from imucald.inputs.taps import Columns, Tap

CYCLE_FRAMES = 5000
"""Largest number of frames that are used for the median interval (the observed cycle)."""
STOPPED_S, STOPPED_CYCLES = 10.0, 20.0
"""A message is reported as stopped if it ends this time [s] and this number of cycles before the
end of the log."""


class Range:
    """The smallest number, the mean and the largest number of all added numbers."""

    def __init__(self) -> None:
        self.count = 0
        self.least = math.inf
        self.largest = -math.inf
        self._sum = 0.0

    def add_values(self, values: Array) -> None:
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
    """Statistics of one signal of a message. rejected: number of rejected values by reason. Absent
    values are not counted."""

    def __init__(self, conversion: Conversion) -> None:
        self.conversion = conversion
        self.physical = Range()
        self.si = Range()
        self.rejected: Counter[str] = Counter()

    def add_values(self, raw: NDArray[np.generic], physical: Array) -> None:
        """Add raw and physical values (N,)."""
        values, codes = self.conversion.array(raw, physical)
        good = codes == 0
        self.physical.add_values(physical[good])
        self.si.add_values(values[good])
        for code in np.unique(codes[~good]).tolist():
            self.rejected[REASONS[code]] += int(np.count_nonzero(codes == code))


class _Times:
    """The times of the frames of a message or of one of its multiplexer groups."""

    def __init__(self) -> None:
        self._intervals: list[Array] = []
        self._count = 0
        self._lost: tuple[int, float | None] = 0, None  # share of lost frames, at this count
        self.last: float | None = None
        """Stream time of the last frame [s]."""

    def add_times(self, t: Array) -> None:
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
        """Share of lost frames, computed from the times. message: the message of these frames."""
        if self._count != self._lost[0]:
            self._lost = self._count, lost_share(np.concatenate(self._intervals), message)
        return self._lost[1]


class Probe:
    """Statistics of the frames of a route."""

    def __init__(self, route: SignalRoute) -> None:
        self.route = route
        self.name, self.match, self.taps = route.name, route.match, route.taps
        self.sender, self.stated_cycle = route.sender, route.stated_cycle
        self.frames = 0
        """Number of all frames of the route, including rejected frames."""
        self.shortest = FD_BYTES
        """Length of the shortest frame [bytes]."""
        self.rejected: Counter[str] = Counter()
        """Number of completely rejected frames, by reason."""
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
    def can_id(self) -> int:
        """Identifier of the used frames, with the flag for 29 bits. A J1939 identifier has the
        sender's address; with several used senders or none, the address of the database."""
        senders = self.addresses if self.sender is None else {self.sender.address}
        address = next(iter(senders)) if len(senders) == 1 else None
        if address is None:
            return self.match.can_id
        return self.match.can_id & ~J1939_ADDRESS_MASK | address

    @property
    def refused(self) -> Counter[str]:
        """`rejected` without copied frames: the other frame of each copied pair is accepted, so no
        data is lost."""
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
        """Return the `cycle` of the signals of one channel. In a message with multiplexer groups,
        this is the cycle of the slowest group of the channel."""
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
        """Return the time of the last frame if a cyclic message (or multiplexer group) stopped
        before `end`; else None."""
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

        A counter does not show a gap in which it wraps. None if the message is not cyclic and has
        no counter, or if there are several senders.
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

    def see_frames(
        self,
        t: Array,
        data: Bytes,
        length: NDArray[np.uint8],
        bad: Mapping[str, Index],
        rejected: Mapping[str, Index],
    ) -> None:
        """Count frames and rejections."""
        for reason, rows in rejected.items():
            self.rejected[reason] += len(rows)
        self.frames += len(t)
        self.shortest = min(self.shortest, int(length.min(initial=FD_BYTES)))
        own = np.ones(len(t), dtype=bool)
        if DOUBLED in bad:  # the original frame has the same time
            own[bad[DOUBLED]] = False
        self._times.add_times(t[own])
        if isinstance(self.route, MessageRoute):
            presence = self.route.plan.presence(data, length)
            for selectors, present in presence.items():
                self._of_groups.setdefault(selectors, _Times()).add_times(t[own & present])

    def see_values(self, columns: Columns) -> None:
        """Add values to the ranges of the signals."""
        for tap in self.taps:
            for component, slot in zip(tap.components, tap.slots, strict=True):
                raw, physical, present = columns[component.index]
                if present is not None:
                    raw, physical = raw[present], physical[present]
                self.signals[tap.channel, tap.rank, slot].add_values(raw, physical)
