"""The tilt with which the published solver levels: from the stops, or from the mean force of the
drive.
"""

from __future__ import annotations

import math
from math import isnan

import numpy as np

from imucald.core.rotations import Matrix3, Vector, levelling_rotation
from imucald.motion.ticks import TICK_S, TickRow
from imucald.mount.method_a.levelling import LongRunLevel, StopBook, Tilt
from imucald.mount.method_a.settings import PublishedSettings
from imucald.mount.method_a.static_test import StandstillDetector

UP_MEMORY_S = 20.0
"""Time constant of the vertical before the first levelling [s]."""
UP_SETTLED_TICKS = 50.0
"""Number of ticks after which the vertical is good enough to project gyroscope rates on it."""


class TiltEstimator:
    """Detects standstill and keeps the tilt.

    still: True if the vehicle stands now. departed: True if the vehicle began to move in this tick.
    tilt: known tilt, or None. level: best rotation sensor -> level (3, 3). up: unit vector up in
    sensor axes, or None. stops: number of stops seen.
    """

    def __init__(self, settings: PublishedSettings) -> None:
        s = self._settings = settings
        bias_std = s.calibration.accelerometer_bias
        self._stops = StopBook(s.slope_std, bias_std, s.calibration.static.average_stops)
        self._long_run = LongRunLevel(s.slope_std, bias_std)
        self._standstill = StandstillDetector(s.calibration.static)
        self._moved = self._moved_s = math.inf
        self._sum = (0.0, 0.0, 0.0)
        self._ticks = 0.0
        self.still = self.departed = False
        self.tilt: Tilt | None = None
        self.level: Matrix3 = np.eye(3)
        self.up: Vector | None = None
        if s.is_level:
            self._take(Tilt((0.0, 0.0, 1.0), s.level_std, 0))

    @property
    def stops(self) -> int:
        """Number of stops seen, in different places."""
        return self._stops.seen

    def restart(self) -> None:
        """Note a jump of time: an open window is dropped, and the tilt is kept."""
        self._standstill.restart()
        self.still = self.departed = False

    def take_tick(self, tick: TickRow, force: Vector, clean: bool, speed: float) -> bool:
        """Process a tick. Returns True if the tilt has changed.

        force: (3,) [m/s^2]. clean: True if the force may be used for learning. speed: [m/s] or NaN.
        """
        s = self._settings
        stopped = None if isnan(speed) else abs(speed) <= s.calibration.static.standstill_speed
        if not clean:
            self._standstill.restart()
        window = self._standstill.take_tick(tick, stopped) if clean else None
        changed = False
        if window is not None and not s.is_level:
            far = self._moved > s.place_distance
            far = far or (stopped is None and self._moved_s > s.place_seconds)
            self._stops.add_static_window((window.x, window.y, window.z), window.samples, far)
            self._moved = self._moved_s = 0.0
            changed = self._take(self._stops.tilt())
        still = self._standstill.still
        self.departed = self.still and not still
        self.still = still
        if not still:
            self._moved_s += TICK_S
            self._moved += 0.0 if stopped is None else abs(speed) * TICK_S
        if clean and not s.is_level and not self._stops.seen:
            changed = self._without_stop(force, still)
        return changed

    def _without_stop(self, force: Vector, still: bool) -> bool:
        """Update the vertical from a slow mean, and level with the mean force of a long drive."""
        keep = 1.0 - TICK_S / UP_MEMORY_S
        x, y, z = self._sum
        x, y, z = x * keep + force[0], y * keep + force[1], z * keep + force[2]
        self._sum = (x, y, z)
        self._ticks += 1.0
        if self._ticks >= UP_SETTLED_TICKS:
            norm = math.sqrt(x * x + y * y + z * z)
            self.up = (x / norm, y / norm, z / norm)
            if self.tilt is None and self._ticks % UP_SETTLED_TICKS == 0.0:
                self.level = levelling_rotation(self.up)
        if still:
            return False
        run = self._long_run
        before = int(run.seconds)
        run.add_mean_force(force[0], force[1], force[2], TICK_S)
        if run.seconds < self._settings.level_without_stop_after or int(run.seconds) == before:
            return False
        return self._take(run.tilt())

    def _take(self, tilt: Tilt | None) -> bool:
        if tilt is None:
            return False
        self.tilt, self.up = tilt, tilt.up
        self.level = levelling_rotation(tilt.up)
        return True
