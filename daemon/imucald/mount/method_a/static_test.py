"""Standstill: the static test of method A (step 1), on ticks.

As published, a preset number of accelerometer samples is static if max - min is at most the
threshold on each axis. Online, two rules are added. A known speed must be zero. While the speed is
zero, wider thresholds apply, because a running engine shakes a sensor more than a smooth road does.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from imucald.config.calibration import StaticTestSettings
from imucald.motion.ticks import ACCEL, TICK_S, TickRow

CONFIRM_TICKS = 5
"""Number of further quiet ticks that a window needs before it counts. A late speed signal (up to
0.4 s) is still zero when the vehicle has begun to move.
"""
MAX_HOLE_TICKS = 10
"""Number of ticks without a sample that do not end a run. A sensor that is slow or has jitter
leaves single holes."""


class StaticWindow(NamedTuple):
    """A window that passed the static test: mean specific force [m/s^2], number of samples, end
    [s]."""

    x: float
    y: float
    z: float
    samples: float
    t: float


class StandstillDetector:
    """Runs the static test on ticks. The windows follow one another without overlap.

    still: True if the vehicle stands now. A window has then passed and the run continues.
    """

    def __init__(self, settings: StaticTestSettings) -> None:
        self._settings = settings
        self._ticks_needed = max(1, round(settings.duration / TICK_S))
        self.still = False
        self._passed: deque[tuple[int, StaticWindow]] = deque()
        self._run = 0
        self.restart()

    def restart(self) -> None:
        """Begin a new run, without the earlier ticks."""
        self.still = False
        self._passed.clear()
        self._run = 0
        self._begin_window()

    def _begin_window(self) -> None:
        self._x = self._y = self._z = self._n = 0.0
        self._ticks = self._holes = 0
        self._low = [1e9, 1e9, 1e9]
        self._high = [-1e9, -1e9, -1e9]

    def take_tick(self, tick: TickRow, stopped: bool | None) -> StaticWindow | None:
        """Process a tick. Returns a window that has just been confirmed static, or None.

        stopped: True if the speed shows that the vehicle stands; None if the speed is not known.
        """
        if stopped is False or tick[ACCEL.bad] > 0.0:
            self.restart()
            return None
        n = tick[ACCEL.n]
        if n == 0.0:
            self._holes += 1
            if self._holes > MAX_HOLE_TICKS:
                self.restart()
            return None
        if not self._within(tick, stopped):
            self.restart()
            if not self._within(tick, stopped):
                self.restart()
                return None
        self._x += n * tick[ACCEL.x]
        self._y += n * tick[ACCEL.y]
        self._z += n * tick[ACCEL.z]
        self._n += n
        self._ticks += 1
        return self._advance(tick[0])

    def _within(self, tick: TickRow, stopped: bool | None) -> bool:
        settings = self._settings
        limit = settings.threshold_at_zero_speed if stopped else settings.threshold
        low, high = self._low, self._high
        lx, ly, lz = tick[ACCEL.min_x], tick[ACCEL.min_y], tick[ACCEL.min_z]
        hx, hy, hz = tick[ACCEL.max_x], tick[ACCEL.max_y], tick[ACCEL.max_z]
        if lx < low[0]:
            low[0] = lx
        if ly < low[1]:
            low[1] = ly
        if lz < low[2]:
            low[2] = lz
        if hx > high[0]:
            high[0] = hx
        if hy > high[1]:
            high[1] = hy
        if hz > high[2]:
            high[2] = hz
        return (
            high[0] - low[0] <= limit[0]
            and high[1] - low[1] <= limit[1]
            and high[2] - low[2] <= limit[2]
        )

    def _advance(self, t: float) -> StaticWindow | None:
        confirmed = None
        self._run += 1
        if self._passed and self._run >= self._passed[0][0] + CONFIRM_TICKS:
            confirmed = self._passed.popleft()[1]
        if self._ticks + self._holes >= self._ticks_needed and self._n >= self._settings.samples:
            n = self._n
            window = StaticWindow(self._x / n, self._y / n, self._z / n, n, t)
            self._passed.append((self._run, window))
            self.still = True
            self._begin_window()
        return confirmed
