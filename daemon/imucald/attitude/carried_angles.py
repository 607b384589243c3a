"""Roll and pitch from the corrected accelerometer and gyroscope (method B, claim 1, last step).

The vertical is integrated with the corrected rate from sample to sample. The integrated vertical is
corrected with a time constant towards the vertical of the corrected acceleration (claims 2 and 3:
without the deflections). This algorithm is a complementary filter on the vertical, as in Mahony,
Hamel and Pflimlin, IEEE Trans. Automatic Control 53, 2008. The publication says "attitude solution"
and names no filter, so the filter is *reconstructed*.
"""

from __future__ import annotations

import math

from imucald.core.rotations import Vector, quaternion_from_vector, rows_from_quaternion, times


def vertical(pitch: float, roll: float) -> Vector:
    """Return the unit vector up in axes right, forward, up. pitch: nose up [rad]. roll: right side
    down [rad]."""
    level = math.cos(pitch)
    return -level * math.sin(roll), math.sin(pitch), level * math.cos(roll)


class CarriedAngles:
    """The vertical in body axes (right, forward, up).

    time: time constant of the correction towards the acceleration [s]. longest_step: largest time
    between two rates [s]; a longer time is a gap.
    """

    def __init__(self, time: float, longest_step: float) -> None:
        self._time = time
        self._longest_step = longest_step
        self.restart()

    def restart(self) -> None:
        """Forget everything, because time has jumped."""
        self._up: Vector | None = None
        self._rate: Vector = (0.0, 0.0, 0.0)
        self._t = self._t_force = -math.inf
        self._age = 0.0

    def turn(self, t: float, rate: Vector) -> None:
        """Process a corrected rate [rad/s] at t [s].

        The body is rotated by the mean of two successive rates.
        """
        dt, last = t - self._t, self._rate
        self._t, self._rate = t, rate
        if self._up is None or not 0.0 < dt < math.inf:
            return
        if dt > self._longest_step:
            self._up = None
            return
        k = -0.5 * dt  # the vertical turns in the body the other way
        turned = quaternion_from_vector(*(k * (a + b) for a, b in zip(rate, last, strict=True)))
        self._up = times(rows_from_quaternion(turned), self._up)

    def draw(self, t: float, pitch: float, roll: float) -> None:
        """Process pitch and roll from the corrected acceleration at t [s]."""
        seen = vertical(pitch, roll)
        dt, self._t_force = t - self._t_force, t
        if self._up is None:
            self._up, self._age = seen, 0.0
            return
        # The first samples are averaged, because one sample is worth no more than the next.
        self._age += max(dt, 0.0)
        part = dt / (min(self._time, self._age) + dt) if dt > 0.0 else 0.0
        x, y, z = (a + part * (b - a) for a, b in zip(self._up, seen, strict=True))
        size = math.sqrt(x * x + y * y + z * z)
        if size > 0.0:
            self._up = x / size, y / size, z / size

    @property
    def angles(self) -> tuple[float, float] | None:
        """Pitch (nose up) and roll (right side down) [rad]; None before the first force."""
        if self._up is None:
            return None
        x, y, z = self._up
        return math.atan2(y, math.hypot(x, z)), math.atan2(-x, z)
