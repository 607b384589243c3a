"""Step cycles: each full sine period of the vertical acceleration is one step cycle (method D, step
1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imucald.config.attitude import StepSettings
from imucald.core.arrays import Array
from imucald.core.rotations import Vector

POINTS = 64
"""Number of equal parts into which a cycle is resampled."""
MAX_SAMPLES = 4096
"""Largest number of stored samples of one cycle."""
GAP_S = 0.25
"""Time between two samples above which they do not belong to one cycle [s]."""
SOFT_SHARE = 0.4
"""Largest ratio of the threshold to the rms of the vertical acceleration while walking."""
MIN_SAMPLES = 6
"""Smallest number of samples of a sine period."""


@dataclass(frozen=True)
class StepCycle:
    """One step: its begin and end [s], and the acceleration (POINTS, 3) in equal parts of this time
    [m/s^2].

    The acceleration `accel` is in terminal axes. level: acceleration in the level frame. turning:
    (POINTS, 2) angular rate about the horizontal axes of the level frame [rad/s].
    """

    t0: float
    t1: float
    accel: Array
    level: Array
    turning: Array

    @property
    def duration(self) -> float:
        """Duration of the step [s]."""
        return self.t1 - self.t0


class StepCycles:
    """Divides the stream of accelerometer samples into step cycles.

    The low-pass filtered acceleration shows the vertical. A cycle begins when the vertical
    acceleration rises through its mean, and ends at the next such rise. In between, the vertical
    acceleration must fall below minus the threshold.
    """

    def __init__(self, settings: StepSettings) -> None:
        self.settings = settings
        self.steps = 0
        """Number of complete cycles so far."""
        self.restart()

    def restart(self) -> None:
        """Begin again, because time has jumped."""
        self._t = -math.inf
        self._g = (0.0, 0.0, 0.0)
        self._warm = 0.0
        self._square = 0.0
        self._mean = 0.0
        self._slow = [0.0, 0.0]
        self._before = 0.0
        self._armed = False
        self._high = False
        self._start = math.nan
        self._samples: list[tuple[float, ...]] = []

    def add_sample(
        self,
        t: float,
        accel: Vector,
        level: Vector = (0.0, 0.0, 0.0),
        turning: tuple[float, float] = (0.0, 0.0),
        up: float | None = None,
    ) -> StepCycle | None:
        """Process a sample [m/s^2] at t [s]. Returns the cycle that ends with this sample, or None.

        level, turning: acceleration and angular rate in a level frame; they are stored with the
        cycle. up: vertical acceleration, if an attitude is known. Without an attitude, the low-pass
        filtered acceleration shows the vertical.
        """
        dt = t - self._t
        if dt <= 0.0:
            return None
        if dt > GAP_S:
            self.restart()
            self._t, self._g = t, accel
            self._mean = math.sqrt(accel[0] ** 2 + accel[1] ** 2 + accel[2] ** 2)
            return None
        self._t = t
        vertical = self._vertical(dt, accel, up)
        if len(self._samples) < MAX_SAMPLES:
            self._samples.append((t, *accel, *level, *turning))
        before, self._before = self._before, vertical
        s = self.settings
        threshold = self._threshold(dt, vertical)
        if vertical < -threshold:
            self._armed = True
        elif vertical > threshold:
            self._high = True
        if not self._armed or not before < 0.0 <= vertical:
            if t - self._start > s.longest:
                self._start = math.nan  # nobody walks
            if math.isnan(self._start):
                self._samples = self._samples[-1:]
            return None
        part = -before / (vertical - before)
        return self._crossing(t - dt + part * dt)

    def _crossing(self, t: float) -> StepCycle | None:
        s = self.settings
        start, duration = self._start, t - self._start
        if duration < s.shortest:
            self._armed = False
            return None
        whole = self._high and duration <= s.longest and len(self._samples) >= MIN_SAMPLES
        cycle = self._cut(start, t) if whole else None
        self._start = t
        self._armed = self._high = False
        self._samples = self._samples[-2:]
        if cycle is not None:
            self.steps += 1
        return cycle

    def _cut(self, t0: float, t1: float) -> StepCycle:
        columns = np.array(self._samples)
        grid = t0 + (t1 - t0) * (np.arange(POINTS) / POINTS)
        made = np.column_stack([np.interp(grid, columns[:, 0], c) for c in columns.T[1:]])
        return StepCycle(t0, t1, made[:, :3], made[:, 3:6], made[:, 6:])

    def _threshold(self, dt: float, vertical: float) -> float:
        """Return the threshold of the vertical acceleration [m/s^2].

        The threshold is lower while a person walks softly, because a swinging arm makes every
        second step weaker.
        """
        top = self.settings.threshold
        part = 1.0 - math.exp(-dt / self.settings.gravity_time)
        self._square += part * (vertical * vertical - self._square)
        rms = math.sqrt(self._square)
        return top if rms < 0.8 * top else min(top, max(SOFT_SHARE * rms, 0.5 * top))

    def _vertical(self, dt: float, accel: Vector, up: float | None) -> float:
        """Return the vertical acceleration, filtered with two low-pass filters [m/s^2]."""
        s = self.settings
        self._warm += dt
        part = 1.0 - math.exp(-dt / min(s.gravity_time, max(self._warm, dt)))
        x, y, z = (g + part * (a - g) for g, a in zip(self._g, accel, strict=True))
        self._g = (x, y, z)
        size = math.sqrt(x * x + y * y + z * z)
        if size < 1.0:
            return 0.0
        if up is None:
            up = (accel[0] * x + accel[1] * y + accel[2] * z) / size
        self._mean += part * (up - self._mean)
        along = up - self._mean
        part = 1.0 - math.exp(-dt * 2.0 * math.pi * s.corner_hz)
        slow = self._slow
        slow[0] += part * (along - slow[0])
        slow[1] += part * (slow[0] - slow[1])
        return slow[1]
