"""Yaw acceleration from an observer, with less noise than a difference quotient.

The observer is of second order, for the rate and its derivative, with a damping of 0.7 for both
poles. The corner frequency was chosen with simulated drives. With 3 to 5 Hz, the error of dr/dt
times a lever arm of 1.5 m is smallest: 0.035 of 0.11 m/s^2 rms. A lower corner frequency gives a
larger delay, and a higher corner frequency passes more noise of the gyroscope. The body's pitch and
roll on a rough road are too fast for any causal filter with such noise. Removing the acceleration
of pitch and roll made the force worse at every corner frequency, so this acceleration is not
removed.
"""

from __future__ import annotations

import math

CORNER_HZ = 4.0
DAMPING = 0.7
GAP_S = 0.5
"""Gap after which the observer starts again [s]."""


class YawAcceleration:
    """Receives yaw rates [rad/s] and returns their derivative. The observer uses the backward Euler
    method, which is stable for any time step."""

    def __init__(self) -> None:
        omega = 2.0 * math.pi * CORNER_HZ
        self._square = omega * omega
        self._drag = 2.0 * DAMPING * omega
        self.restart()

    def restart(self) -> None:
        """Delete the state after a jump of time or a change of the axes."""
        self._t = -math.inf
        self._rate = 0.0
        self.value = 0.0
        """Yaw acceleration [rad/s^2]."""

    def push(self, t: float, rate: float) -> float:
        """Process a rate at t [s]. Returns its derivative [rad/s^2]. NaN restarts the observer."""
        if math.isnan(rate):
            self.restart()
            return 0.0
        dt = t - self._t
        self._t = t
        if not dt <= GAP_S:
            self._rate, self.value = rate, 0.0
            return 0.0
        pull = dt * self._square
        gain = dt * (pull + self._drag)
        self._rate = (self._rate + dt * self.value + gain * rate) / (1.0 + gain)
        self.value += pull * (rate - self._rate)
        return self.value
