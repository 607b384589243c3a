"""Ends of intervals: at averaged speeds, or after a fixed time if there is no speed."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator

from imucald.attitude.interval import Endpoint
from imucald.attitude.motion_compensation import AverageSpeed, SpeedAverager
from imucald.attitude.propagation import IntegralSnapshot, Propagator
from imucald.config.attitude import MotionCompensationSettings

MAX_ENDPOINTS = 64
"""Largest number of averaged speeds that wait for the accelerometer. A speed that leads is ahead of
the accelerometer by up to a second."""
RECENT_S = 1.0
"""Time over which the change of the speed is computed for an extrapolation [s]. If the previous
speed is older, the change since the previous speed is used."""
SLACK_S = 1e-6
"""Rounding error of times that are a second apart [s]."""


class EndpointMaker:
    """Makes pairs of endpoints from samples. Each pair is an interval between two averaged
    speeds."""

    def __init__(self, settings: MotionCompensationSettings, propagator: Propagator) -> None:
        self._settings = settings
        self._propagator = propagator
        self.restart()

    def restart(self) -> None:
        """Forget everything, because time has jumped."""
        self._average = SpeedAverager(self._settings)
        self._waiting: deque[AverageSpeed] = deque(maxlen=MAX_ENDPOINTS)
        self._open: Endpoint | None = None
        self._heard = -math.inf
        self._last = -math.inf
        self._recent: deque[AverageSpeed] = deque(maxlen=MAX_ENDPOINTS)
        self._piece: IntegralSnapshot | None = None
        self.has_pieces = False
        """True if `piece` returned pieces within the open interval, or within the interval that has
        just closed."""

    def speed(self, t: float, speed: float) -> None:
        """Process a speed [m/s], negative in reverse, that was received at t [s]."""
        self._heard = t
        average = self._average.add_speed(t, speed)
        recent = self._recent
        if not recent or average.t > recent[-1].t:
            recent.append(average)
        while len(recent) > 2 and average.t - recent[1].t >= RECENT_S:
            recent.popleft()
        spacing = self._settings.interval
        if not self._last - spacing <= average.t < self._last + spacing - SLACK_S:
            self._last = average.t
            self._waiting.append(average)

    def complete(self) -> Iterator[tuple[Endpoint | None, Endpoint]]:
        """Yield begin and end of the intervals that are complete.

        The first endpoint after a restart has no begin: the first interval starts there.
        """
        newest = self._propagator.newest
        if newest is None:
            return
        if self._open is not None and self._open.snapshot.t < self._propagator.segment_start:
            self._open = None
        if newest.t - self._heard > self._settings.timeout:
            self._waiting.clear()
            if self._open is None or newest.t - self._open.snapshot.t >= self._settings.interval:
                yield self._next(Endpoint(newest, math.nan))
            return
        while self._waiting and self._waiting[0].t <= newest.t:
            average = self._waiting.popleft()
            snapshot = self._propagator.at(average.t)
            if snapshot is None:
                self._open = None
            else:
                yield self._next(Endpoint(snapshot, average.speed))

    def piece(self) -> tuple[Endpoint, Endpoint] | None:
        """Return both ends of a piece of the interval's length that ends now; None: no piece is
        complete.

        Pieces are made if at least two of them fit between two speeds. The speed at both ends is
        the latest speed, extrapolated with its change in the second before. The endpoints also
        contain the age of the latest speed.
        """
        newest, recent = self._propagator.newest, self._recent
        if newest is None or newest.t - self._heard > self._settings.timeout:
            self._piece = None
            recent.clear()
            return None
        first = self._piece
        if first is None or first.t < self._propagator.segment_start:
            self._piece = newest
            return None
        if newest.t - first.t < self._settings.interval - SLACK_S:
            return None
        self._piece = newest
        if len(recent) < 2 or 2.0 * self._settings.interval > recent[-1].t - recent[-2].t:
            return None
        self.has_pieces = True
        before, latest = recent[0], recent[-1]
        rise = (latest.speed - before.speed) / (latest.t - before.t)
        ages = (first.t - latest.t, newest.t - latest.t)
        a, b = (latest.speed + rise * age for age in ages)
        return Endpoint(first, a, abs(ages[0])), Endpoint(newest, b, abs(ages[1]))

    def _next(self, endpoint: Endpoint) -> tuple[Endpoint | None, Endpoint]:
        first, self._open = self._open, endpoint
        if first is not None and endpoint.snapshot.t <= first.snapshot.t:
            first = None
        return first, endpoint
