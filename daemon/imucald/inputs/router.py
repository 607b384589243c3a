"""Convert frames to samples. A router is compiled from the configuration and the databases.

A `Router` receives single frames (live) or columns of frames (replay). The router returns samples
by channel (see `core.samples`). The samples are the same in both cases. The router counts
rejections by reason.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Collection, Hashable, Iterable, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import KNOWN_IDS, FrameColumns, IdMatch
from imucald.can.dbc.bits import Columns as Bytes
from imucald.can.e2e.protection import DOUBLED, OK
from imucald.can.e2e.protection import REASONS as FRAME_REASONS
from imucald.core.arrays import distinct
from imucald.core.samples import speed_of_wheels, speeds_of_wheels, width_of
from imucald.inputs.column_samples import (
    ColumnSamples,
    Routed,
    SourceSelector,
    TapSamples,
    TriadAssembler,
    assembled,
    joined,
    rows_of,
)
from imucald.inputs.conversion import REASONS
from imucald.inputs.routes import NOT_OURS, MessageRoute, SignalRoute
from imucald.inputs.sender_choice import Asked, taken
from imucald.inputs.sender_choice import joined as joined_senders
from imucald.inputs.taps import Columns, Physical, Raw, Tap

OF_SENSOR = frozenset(("accel", "gyro", "mag"))
"""Channels of the sensor that is calibrated."""

Sample = tuple[str, Sequence[float]]
"""Channel and values."""
Rows = NDArray[np.int64]


class RouteWatcher(Protocol):
    """Receives the frames and values of a route in columns, for statistics."""

    def see_frames(
        self,
        t: NDArray[np.float64],
        data: Bytes,
        length: NDArray[np.uint8],
        bad: Mapping[str, Rows],
        rejected: Mapping[str, Rows],
    ) -> None:
        """Process the frames of the route. bad: rows of the frames that the route's own check
        rejected, by reason. rejected: these frames and the frames that exceed the allowed rate."""

    def see_values(self, columns: Columns) -> None:
        """Process the values of accepted frames."""


class Router:
    """Converts frames to samples.

    routes: one for each used message (or raw expression), see `routes`. Routes with sign signals
    for other routes are first.
    derive_speed: whether the speed is computed from the wheels. derive_reverse: whether a negative
    speed means reverse.
    """

    def __init__(
        self,
        routes: Sequence[SignalRoute],
        derive_speed: bool = False,
        derive_reverse: bool = False,
    ) -> None:
        self.routes = tuple(routes)
        self.watchers: Sequence[RouteWatcher] = ()
        """One watcher for each route, or an empty sequence."""
        self.rejected: Counter[str] = Counter()
        """Number of rejected frames and samples, by reason."""
        self.used = 0
        """Number of accepted frames."""
        self.sample_counts: Counter[str] = Counter()
        """Number of accepted samples, by channel."""
        self._join_senders()
        self._known: dict[int, tuple[SignalRoute, ...]] = {}
        self._signs = [s for r in routes if isinstance(r, MessageRoute) for s in r.given.values()]
        self._derive_speed = derive_speed
        self._derive_reverse = derive_reverse
        ranks: dict[str, int] = {}
        for tap in self._taps():
            ranks[tap.channel] = max(ranks.get(tap.channel, 0), tap.rank + 1)
        self._selectors = {c: SourceSelector(n) for c, n in ranks.items() if n > 1}
        self._assemblers: dict[tuple[str, int], TriadAssembler] = {
            (tap.channel, tap.rank): TriadAssembler(width_of(tap.channel))
            for tap in self._taps()
            if not tap.complete
        }

    def _join_senders(self) -> None:
        """Make all messages of the sensor use the same sender. Each parallel sensor has its own
        sender."""
        joined_senders(
            route.sender
            for route in self.routes
            if route.sender is not None and any(tap.channel in OF_SENSOR for tap in route.taps)
        )

    def _taps(self) -> Iterable[Tap]:
        return (tap for route in self.routes for tap in route.taps)

    @property
    def matches(self) -> list[IdMatch]:
        """Filters of the identifiers that bus links and log readers must accept."""
        return list(dict.fromkeys(route.match for route in self.routes))

    @property
    def stated_cycles(self) -> list[tuple[IdMatch, float]]:
        """Filters of the identifiers whose cycle is stated, each with this cycle [s]."""
        return [(r.match, r.stated_cycle) for r in self.routes if r.stated_cycle is not None]

    @property
    def channels(self) -> frozenset[str]:
        """The channels for which the configuration gives samples."""
        found = {tap.channel for tap in self._taps()}
        if self._derive_speed:
            found.add("speed")
        if self._derive_reverse:
            found.add("reverse")
        return frozenset(found)

    @property
    def measured_axes(self) -> dict[str, int]:
        """Number of measured axes of each channel. A planar accelerometer has two."""
        return {t.channel: width_of(t.channel) - (t.third is not None) for t in self._taps()}

    def resolution(self, channel: str) -> float:
        """Largest resolution step of a channel's axes in SI; 0 if not known."""
        taps = (tap for tap in self._taps() if tap.channel == channel)
        return max((c.conversion.step for tap in taps for c in tap.components), default=0.0)

    def cycles(self, channel: str) -> list[float | None]:
        """Return the stated cycles [s] of the routes of a channel."""
        return [
            route.stated_cycle
            for route in self.routes
            if any(tap.channel == channel for tap in route.taps)
        ]

    # replacing another router ---------------------------------------------------------------

    def source(self, channel: str) -> Hashable:
        """Return a key of all settings that determine the values of a channel."""
        if channel == "speed" and self._derive_speed:
            return channel, self.source("wheel_speeds")
        if channel == "reverse" and self._derive_reverse:
            return channel, self.source("speed")
        return frozenset(
            route.source_of(tap)
            for route in self.routes
            for tap in route.taps
            if tap.channel == channel
        )

    def same_sources(self, former: Router) -> frozenset[str]:
        """Return the channels of both routers for which equal frames give equal values."""
        both = self.channels & former.channels
        return frozenset(c for c in both if self.source(c) == former.source(c))

    def go_on_from(self, former: Router, same: Collection[str]) -> None:
        """Continue with the state of another router: counts, and the state of routes with unchanged
        senders. same: the result of `same_sources`.
        """
        before: dict[Hashable, deque[SignalRoute]] = {}
        for route in former.routes:
            before.setdefault(route.frame_key, deque()).append(route)
        for route in self.routes:  # several routes may use the same frames
            if known := before.get(route.frame_key):
                route.go_on_from(known.popleft())
        self._join_senders()
        for channel, selector in former._selectors.items():
            if channel in same:
                self._selectors[channel] = selector
        for key, assembler in former._assemblers.items():
            if key[0] in same:
                self._assemblers[key] = assembler
        self.rejected, self.used = former.rejected, former.used
        counted = former.sample_counts.items()
        self.sample_counts = Counter({c: n for c, n in counted if c in self.channels})

    # one frame -----------------------------------------------------------------------------

    def frame(
        self, t: float, can_id: int, data: bytes
    ) -> tuple[list[Sample], list[str], list[str]]:
        """Process one frame. Return its samples and two lists of channels with a rejected sample.

        The first list contains the channels of all rejected samples. The second list contains only
        the channels of samples that were rejected for their value. The lists differ because a
        completely rejected frame is a gap like a lost frame, but a sample rejected for its value
        may have been a large value. t: stream time [s]. can_id: with the flag for 29 bits. The
        configured channels of a recording are ignored, because a live bus is a single bus.
        """
        samples: list[Sample] = []
        refused: list[Tap] = []
        values: list[Tap] = []
        found: list[tuple[Tap, Raw, Physical]] = []
        accepted = 0
        for route in self._routes_of(can_id):
            if route.sender is not None and not route.sender.takes(t, can_id, data):
                continue
            reason = route.check(t, data)
            if reason is None:
                continue
            reason = route.guard.judge(t, reason)
            if reason:
                self.rejected[reason] += 1
                if reason != DOUBLED:  # the original frame was checked; nothing is lost
                    refused += route.taps
                continue
            accepted += 1
            raw, physical = route.numbers(t, data)
            found += [(tap, raw, physical) for tap in route.taps]
        if accepted > 1:  # preferred sources first, on any route
            found.sort(key=lambda one: one[0].rank)
        self.used += accepted > 0
        self._take(t, found, samples, refused, values)
        return (
            samples,
            [tap.channel for tap in refused if self._selects(t, tap)],
            [tap.channel for tap in values if self._selects(t, tap)],
        )

    def _selects(self, t: float, tap: Tap) -> bool:
        """True if the samples of a tap would be used at time t. If not, a rejected sample is no
        loss."""
        selector = self._selectors.get(tap.channel)
        return selector is None or selector.selects(t, tap.rank)

    def _take(
        self,
        t: float,
        found: Iterable[tuple[Tap, Raw, Physical]],
        samples: list[Sample],
        refused: list[Tap],
        refused_values: list[Tap],
    ) -> None:
        for tap, raw, physical in found:
            values: Sequence[float] | None
            values, code = tap.scalar(raw, physical)
            if code < 0:
                continue
            if code:
                self.rejected[REASONS[code]] += 1
            if not tap.complete:
                values, bad = self._assemblers[tap.channel, tap.rank].add_parts(
                    t, tap.slots, None if code else values
                )
                if bad:
                    refused.append(tap)
                    if code:
                        refused_values.append(tap)
                if values is None:
                    continue
            elif code:
                refused.append(tap)
                refused_values.append(tap)
                continue
            selector = self._selectors.get(tap.channel)
            if selector is not None and not selector.accept(t, tap.rank):
                continue
            self._finish(tap.channel, values, samples)

    def _finish(self, channel: str, values: Sequence[float], samples: list[Sample]) -> None:
        if channel == "speed":
            if self._derive_reverse:
                samples.append(("reverse", (1.0 if values[0] < 0.0 else 0.0,)))
            values = (abs(values[0]),)
        samples.append((channel, values))
        self.sample_counts[channel] += 1
        if channel == "wheel_speeds" and self._derive_speed:
            samples.append(("speed", (speed_of_wheels(values),)))
            self.sample_counts["speed"] += 1

    def _routes_of(self, can_id: int) -> tuple[SignalRoute, ...]:
        routes = self._known.get(can_id)
        if routes is None:
            routes = tuple(
                r for r in self.routes if not (can_id ^ r.match.can_id) & r.match.full_mask
            )
            if len(self._known) < KNOWN_IDS:
                self._known[can_id] = routes
        return routes

    # columns -------------------------------------------------------------------------------

    def columns(self, t: NDArray[np.float64], frames: FrameColumns) -> Routed:
        """Return the samples of a chunk of frames; t: (N,) stream times of the frames [s]."""
        found = [rows_of(route.match, frames) for route in self.routes]
        used = np.zeros(len(frames), dtype=bool)
        parts: dict[str, list[TapSamples]] = {}
        refused: list[tuple[Tap, Rows]] = []
        values: list[tuple[Tap, Rows]] = []
        events: list[Rows] = []
        for selector in self._selectors.values():
            selector.begin_chunk()
        for sign in self._signs:
            sign.begin_chunk()
        for k, rows in enumerate(self._chosen(t, frames, found)):
            if not len(rows):
                continue
            route, times = self.routes[k], t.take(rows)
            data, length = frames.data.take(rows, axis=0), frames.length.take(rows)
            codes = route.check_columns(times, data, length)
            ours = codes != NOT_OURS
            if not ours.all():
                rows, times, codes = rows[ours], times[ours], codes[ours]  # noqa: PLW2901
                data, length = data.compress(ours, axis=0), length[ours]
            ok = codes == OK
            others = [] if ok.all() else distinct(codes[~ok]).tolist()
            bad = {FRAME_REASONS[code]: np.flatnonzero(codes == code) for code in others}
            rejected = {**bad, **route.guard.judge_columns(times, ok, bad)}
            if self.watchers:
                self.watchers[k].see_frames(times, data, length, bad, rejected)
            for reason, at in rejected.items():
                ok[at] = False
                self.rejected[reason] += len(at)
                events.append(rows[at])
                if reason == DOUBLED:
                    continue
                refused += [(tap, rows[at]) for tap in route.taps]
            if rejected:
                rows, times = rows[ok], times[ok]  # noqa: PLW2901
                data, length = data.compress(ok, axis=0), length[ok]
            used[rows] = True
            columns = route.number_columns(times, rows, data, length)
            if self.watchers:
                self.watchers[k].see_values(columns)
            self._take_columns(route, times, rows, columns, parts, values, events)
        self.used += int(np.count_nonzero(used))
        samples = {c: self._joined(c, of, refused, values) for c, of in parts.items()}
        self._finish_columns(samples)
        return Routed(
            samples,
            self._rejected_rows(t, refused + values),
            self._rejected_rows(t, values),
            t[np.sort(np.concatenate(events))] if events else np.zeros(0),
        )

    def _chosen(
        self, t: NDArray[np.float64], frames: FrameColumns, found: Sequence[Rows]
    ) -> Sequence[Rows]:
        """Return the rows of each route. If a message has several senders, only the rows of the
        chosen sender are returned."""
        asked = {
            k: Asked(route.sender, found[k], t.take(found[k]))
            for k, route in enumerate(self.routes)
            if route.sender is not None and len(found[k])
        }
        if not asked:
            return found
        chosen = list(found)
        for k, flags in zip(asked, taken(frames, list(asked.values())), strict=True):
            chosen[k] = found[k][flags]
        return chosen

    def _rejected_rows(
        self, t: NDArray[np.float64], refused: list[tuple[Tap, Rows]]
    ) -> dict[str, Rows]:
        found: dict[str, list[Rows]] = {}
        for tap, rows in refused:
            selector = self._selectors.get(tap.channel)
            if selector is not None:
                rows = rows[selector.selects_columns(t[rows], rows, tap.rank)]  # noqa: PLW2901
            if len(rows):
                found.setdefault(tap.channel, []).append(rows)
        return {channel: np.sort(np.concatenate(rows)) for channel, rows in found.items()}

    def _take_columns(
        self,
        route: SignalRoute,
        times: NDArray[np.float64],
        rows: Rows,
        columns: Columns,
        parts: dict[str, list[TapSamples]],
        refused: list[tuple[Tap, Rows]],
        events: list[Rows],
    ) -> None:
        for tap in route.taps:
            values, codes = tap.array(columns)
            part = TapSamples(tap, times, rows, values, codes)
            if not codes.any():
                parts.setdefault(tap.channel, []).append(part)
                continue
            bad = codes > 0
            if bad.any():
                events.append(rows[bad])
                for code in distinct(codes[bad]).tolist():
                    self.rejected[REASONS[code]] += int(np.count_nonzero(codes == code))
                if tap.complete:
                    refused.append((tap, rows[bad]))
            keep = codes == 0 if tap.complete else codes >= 0
            if not keep.all():
                part = part.take(keep)
            parts.setdefault(tap.channel, []).append(part)

    def _joined(
        self,
        channel: str,
        found: list[TapSamples],
        refused: list[tuple[Tap, Rows]],
        values: list[tuple[Tap, Rows]],
    ) -> ColumnSamples:
        selector = self._selectors.get(channel)
        if all(part.tap.complete for part in found):
            return joined(found, selector)
        return assembled(channel, found, selector, self._assemblers, refused, values)

    def _finish_columns(self, samples: dict[str, ColumnSamples]) -> None:
        for channel in [c for c, s in samples.items() if not len(s.t)]:
            del samples[channel]
        for channel, series in samples.items():
            self.sample_counts[channel] += len(series.t)
        speed = samples.get("speed")
        if speed is not None:
            if self._derive_reverse:
                backwards = (speed.values < 0.0).astype(np.float64)
                samples["reverse"] = ColumnSamples(speed.t, backwards, speed.row)
            samples["speed"] = ColumnSamples(speed.t, np.abs(speed.values), speed.row)
        wheels = samples.get("wheel_speeds")
        if wheels is not None and self._derive_speed:
            speeds = speeds_of_wheels(wheels.values)
            samples["speed"] = ColumnSamples(wheels.t, speeds, wheels.row)
            self.sample_counts["speed"] += len(speeds)
