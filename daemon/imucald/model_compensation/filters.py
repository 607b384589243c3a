"""Recursive filters of the compensation: force on a gyroscope, yaw acceleration, lean of the body.

Samples may come at any times. Each filter uses an implicit rule, which is stable for any time step,
and starts again after a gap.

Pitch and roll of the body respond to the force along the road as second-order systems with the
model's frequency and damping (the same equation as in the simulation). The accelerometer leans with
the body and also measures gravity, f_body = f_road + g * lean. The equation of the lean is then:

    lean'' + 2 d w lean' + w^2 (1 + g k) lean = w^2 k f_body

Far above its natural frequency of about 2 Hz, the system does not respond, so vibration causes no
lean.
"""

from __future__ import annotations

import math

from imucald.core.samples import GRAVITY
from imucald.model.section import ZERO, Vector3
from imucald.model_compensation.terms import SuspensionTerms

GAP_S = 0.5
"""Gap after which a filter starts again [s]. After such a gap, the body is assumed to be at rest on
its springs."""
MAX_ANGLE = 0.15
"""Largest lean of a car [rad]."""
YAW_CORNER_HZ, YAW_DAMPING = 4.0, 0.7
"""Corner frequency and damping of the observer for the yaw acceleration, chosen with simulated
drives. With 3 to 5 Hz, the error of dr/dt times a lever arm of 1.5 m is smallest: 0.035 of 0.11
m/s^2 rms. A lower corner frequency gives a larger delay, and a higher one passes more noise."""

SuspensionAttitude = tuple[float, float, float, float]
"""Roll and pitch [rad], and their rates [rad/s], by ISO 8855: roll positive left side up, pitch
positive nose down."""
UPRIGHT: SuspensionAttitude = (0.0, 0.0, 0.0, 0.0)


class Smoothed:
    """First-order low-pass filter for three axes. corner: corner frequency [Hz]."""

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


class YawAcceleration:
    """Observer of second order for the yaw rate and its derivative, which has less noise than a
    difference quotient.

    Body pitch and roll on a rough road are too fast for any causal filter with such noise, so their
    acceleration is not observed.
    """

    def __init__(self) -> None:
        omega = 2.0 * math.pi * YAW_CORNER_HZ
        self._square = omega * omega
        self._drag = 2.0 * YAW_DAMPING * omega
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


class _Axis:
    """One axis as a second-order system. The axis has one gradient for a positive force and another
    for a negative force."""

    def __init__(self, positive: float, negative: float, hz: float, damping: float) -> None:
        omega = 2.0 * math.pi * hz
        self._drag = 2.0 * damping * omega
        self._square = omega * omega
        self._gradients = positive, negative
        self.angle = self.rate = 0.0

    def settle(self, force: float) -> None:
        """Set the steady state for this force [m/s^2]."""
        gradient = self._gradients[0] if force > 0.0 else self._gradients[1]
        self.angle = gradient * force / (1.0 + GRAVITY * gradient)
        self.rate = 0.0

    def push(self, dt: float, force: float) -> None:
        """Advance by dt [s] with the body's force [m/s^2], by the trapezoidal rule, which is always
        stable."""
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
    """Receives forces in vehicle (body) axes and returns the attitude of the body."""

    def __init__(self, terms: SuspensionTerms) -> None:
        self._roll = _Axis(terms.roll, terms.roll, terms.roll_hz, terms.roll_damping)
        # the axis is driven by -f_x, which is positive while braking
        self._pitch = _Axis(terms.dive, terms.squat, terms.pitch_hz, terms.pitch_damping)
        self.attitude: SuspensionAttitude = UPRIGHT
        """Attitude with the newest force."""
        self.t = -math.inf
        """Time of the newest force [s]."""

    def restart(self) -> None:
        """Delete the state after a jump of time or a change of the axes."""
        self.t = -math.inf
        self.attitude = UPRIGHT

    def at(self, t: float) -> SuspensionAttitude:
        """Return the attitude of the body at t [s]; zero if the newest force is too old."""
        return self.attitude if t - self.t <= GAP_S else UPRIGHT

    def push(self, t: float, x: float, y: float) -> SuspensionAttitude:
        """Process the force along and across the vehicle at t [s]. NaN restarts the filter."""
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
