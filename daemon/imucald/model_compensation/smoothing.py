"""A first-order low-pass for three axes, with samples at any times."""

from __future__ import annotations

import math

from imucald.model.section import ZERO, Vector3

GAP_S = 0.5
"""After a longer gap [s] a filter starts again."""


class Smoothed:
    """First-order low-pass; backward Euler, so it is stable for any time step.

    corner: [Hz].
    """

    def __init__(self, corner: float) -> None:
        self._time = 1.0 / (2.0 * math.pi * corner)
        self.value: Vector3 = ZERO
        self._t = -math.inf

    def restart(self) -> None:
        """Delete the state after a time jump."""
        self.value = ZERO
        self._t = -math.inf

    def push(self, t: float, v: Vector3) -> Vector3:
        """Take a sample at t [s]; return the smoothed one."""
        dt = t - self._t
        self._t = t
        if not dt <= GAP_S:
            self.value = v
            return v
        part = dt / (self._time + dt)
        x, y, z = self.value
        self.value = x + part * (v[0] - x), y + part * (v[1] - y), z + part * (v[2] - z)
        return self.value
