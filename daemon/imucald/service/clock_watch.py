"""Notices that the system's clock was set, by a clock that nobody sets."""

from __future__ import annotations

import time
from collections.abc import Callable

MAX_SLEW = 0.1
"""A clock that is led to the right time is faster or slower by no more: adjtimex(2), `tick`."""
LEAST_S = 0.1
"""A smaller step is not told from slewing between two looks a second apart."""


def steady_clock() -> float:
    """Seconds since the boot, those of a suspend among them where the system says so."""
    return time.clock_gettime(getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC))


class ClockWatch:
    """Compares wall clock and steady clock; both in seconds."""

    def __init__(
        self, wall: Callable[[], float] = time.time, steady: Callable[[], float] = steady_clock
    ) -> None:
        self._wall, self._steady = wall, steady
        self.count = 0
        """How often the clock was set."""
        self._low, self._high, self._at = self._ahead()

    def _ahead(self) -> tuple[float, float, float]:
        """Bounds of wall less steady clock (the process may be held up within), and the latter."""
        before = self._steady()
        wall = self._wall()
        after = self._steady()
        return wall - after, wall - before, after

    def look(self) -> float | None:
        """By how much the clock was set since the last look [s]; None: it was not."""
        low, high, at = self._ahead()
        slewed = max(MAX_SLEW * (at - self._at), LEAST_S)
        forward, back = low - self._high, high - self._low
        self._low, self._high, self._at = low, high, at
        if forward <= slewed and back >= -slewed:
            return None
        self.count += 1
        return forward if forward > slewed else back
