"""A first-order low-pass filter for three axes, with samples at any times."""

from __future__ import annotations

import math

from imucald.model.section import ZERO, Vector3

GAP_S = 0.5
"""Gap after which a filter starts again [s]."""


class Smoothed:
    """First-order low-pass filter. The filter uses the backward Euler method, so the filter is
    stable for any time step.

    corner: corner frequency [Hz].
    """

    def __init__(self, corner: float) -> None:
        self._time = 1.0 / (2.0 * math.pi * corner)
        self.value: Vector3 = ZERO
        self._t = -math.inf

    def restart(self) -> None:
        """Forget the smoothed value after a jump of time."""
        self.value = ZERO
        self._t = -math.inf

    def push(self, t: float, v: Vector3) -> Vector3:
        """Process a sample at t [s]. Returns the smoothed sample."""
        dt = t - self._t
        self._t = t
        if not dt <= GAP_S:
            self.value = v
            return v
        part = dt / (self._time + dt)
        x, y, z = self.value
        self.value = x + part * (v[0] - x), y + part * (v[1] - y), z + part * (v[2] - z)
        return self.value
