"""Slope of the road, computed from the pitch of the body without the effect of the suspension, and
smoothed."""

from __future__ import annotations

import math

from imucald.attitude.interval import Interval

SUSPENSION_STD = math.radians(0.5)
"""Deviation of the pitch from the springs of the suspension [rad], if no data about the springs are
known."""


class GradeFilter:
    """Slope of the road, tangent, positive uphill.

    squat: nose-up pitch per forward specific force [rad/(m/s^2)]. time: time constant of the
    smoothing [s].
    """

    def __init__(self, squat: float, time: float) -> None:
        self._squat = squat
        self._time = time
        self.restart()

    def restart(self) -> None:
        """Begin again."""
        self.grade = math.nan
        self.spread = SUSPENSION_STD
        """Standard deviation that is added to the deviation of the pitch [rad]."""
        self._angle = math.nan

    def take_interval(self, interval: Interval, nose_up: float) -> None:
        """Process an interval and the pitch of the body at its end [rad], nose up positive."""
        angle = nose_up - self._squat * interval.forward_acceleration
        if math.isnan(self._angle):
            self._angle = angle
        part = 1.0 - math.exp(-interval.duration / self._time)
        self._angle += part * (angle - self._angle)
        self.grade = math.tan(self._angle)
