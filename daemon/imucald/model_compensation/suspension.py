"""How the body leans against the road on its springs, from the force that it feels.

Pitch and roll answer the force along the road as second-order systems with the model's frequency
and damping (the same equation as the simulation's). The accelerometer leans with the body and feels
gravity too, f_body = f_road + g * lean, so the loop is closed over it:

    lean'' + 2 d w lean' + w^2 (1 + g k) lean = w^2 k f_body

Above its frequency of about 2 Hz it follows nothing: vibration makes no lean.
"""

from __future__ import annotations

import math

from imucald.core.samples import GRAVITY
from imucald.model_compensation.terms import SuspensionTerms

GAP_S = 0.5
"""A force older than that shows no lean; after such a hole the body is taken to be at rest on its
springs [s]."""
MAX_ANGLE = 0.15
"""No car leans further [rad]."""

SuspensionAttitude = tuple[float, float, float, float]
"""Roll, pitch [rad] and their rates [rad/s]; ISO 8855: roll positive left side up, pitch nose
down."""
UPRIGHT: SuspensionAttitude = (0.0, 0.0, 0.0, 0.0)


class _Axis:
    """One axis: second order; the gradient where the force is positive and where it is not."""

    def __init__(self, positive: float, negative: float, hz: float, damping: float) -> None:
        omega = 2.0 * math.pi * hz
        self._drag = 2.0 * damping * omega
        self._square = omega * omega
        self._gradients = positive, negative
        self.angle = self.rate = 0.0

    def settle(self, force: float) -> None:
        """Be at rest under the force [m/s^2]."""
        gradient = self._gradients[0] if force > 0.0 else self._gradients[1]
        self.angle = gradient * force / (1.0 + GRAVITY * gradient)
        self.rate = 0.0

    def push(self, dt: float, force: float) -> None:
        """Move on by dt [s] under the body's force [m/s^2]; trapezoidal, always stable."""
        angle, rate = self.angle, self.rate
        gradient = self._gradients[0] if force - GRAVITY * angle > 0.0 else self._gradients[1]
        square = self._square
        stiffness = square * (1.0 + GRAVITY * gradient)
        m = 0.5 * dt * (self._drag + 0.5 * dt * stiffness)
        push = dt * (square * gradient * force - stiffness * angle)
        self.rate = (rate * (1.0 - m) + push) / (1.0 + m)
        angle += 0.5 * dt * (rate + self.rate)
        self.angle = min(max(angle, -MAX_ANGLE), MAX_ANGLE)


class SuspensionFilter:
    """Takes forces in vehicle (body) axes, shows how the body leans."""

    def __init__(self, terms: SuspensionTerms) -> None:
        self._roll = _Axis(terms.roll, terms.roll, terms.roll_hz, terms.roll_damping)
        # the axis is driven by -f_x, which is positive while braking
        self._pitch = _Axis(terms.dive, terms.squat, terms.pitch_hz, terms.pitch_damping)
        self.attitude: SuspensionAttitude = UPRIGHT
        """With the newest force."""
        self.t = -math.inf
        """When that came [s]."""

    def restart(self) -> None:
        """Forget: time jumped, or the axes did."""
        self.t = -math.inf
        self.attitude = UPRIGHT

    def at(self, t: float) -> SuspensionAttitude:
        """The lean at t [s]; upright where the newest force is too old to show it."""
        return self.attitude if t - self.t <= GAP_S else UPRIGHT

    def push(self, t: float, x: float, y: float) -> SuspensionAttitude:
        """Take the force along and across the vehicle at t [s]; NaN makes it start again."""
        if math.isnan(x):
            self.restart()
            return self.attitude
        roll, pitch = self._roll, self._pitch
        dt = t - self.t
        self.t = t
        if dt <= GAP_S:
            roll.push(dt, y)
            pitch.push(dt, -x)
        else:
            roll.settle(y)
            pitch.settle(-x)
        self.attitude = roll.angle, pitch.angle, roll.rate, pitch.rate
        return self.attitude
