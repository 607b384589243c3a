"""Decide which intervals of motion the published solver may learn from (step 4 of method A, with
additions).
"""

from __future__ import annotations

import math
from collections import deque
from math import isnan

import numpy as np

from imucald.core.rotations import Matrix3, Vector
from imucald.motion.speed import SpeedInterval
from imucald.motion.straight import angles_agree
from imucald.motion.ticks import TICK_S
from imucald.mount.method_a.settings import PublishedSettings

OFFSET_SETTLED_S = 2.0
"""Duration of straight motion [s] after which the offset is good. The duration is shorter if the
time constant of the offset is short."""
OFFSET_INTERVALS = 4.0
"""Smallest time constant of the offset, in intervals: a speed of 1 Hz makes intervals of 1 s."""
OFFSET_LOST_SPEED_S = 2.0
"""Smallest time constant of the offset [s] where the speed is lost for a while. With a shorter
constant, the mean would absorb part of the manoeuvre.
"""
OFFSET_WITHOUT_SPEED_S = 30.0
"""Smallest time constant of the offset [s] without any speed. With a shorter constant, the mean
would absorb all manoeuvres, because the mean of dv/dt is unknown. Slopes last as long
(`LongRunLevel.CORRELATION_S`).
"""
OFFSET_FADE_S = 15.0
"""Time constant with which the offset's weight decreases while the motion is not straight [s]."""
UNEXPLAINED_NOISE = 0.4
"""Horizontal force [m/s^2] that remains unexplained on a straight road. The causes are the road and
a slow speed signal.
"""
TURN_FACTOR = 1.5
"""Factor on a limit above which motion counts as a turn. Noise alone does not exceed the limit by
this factor."""


class WanderingOffset:
    """Exponentially fading mean of the force and of (dv/dt, v r), with speed v and yaw rate r, over
    straight motion.

    Slope, bank and bias wander slowly. The mean force is subtracted from the force, and the mean
    motion is subtracted from the motion. The subtraction removes slope, bank and bias, and keeps
    the relation between force and motion. tau: time constant [s]; 0: nothing is subtracted.
    without_speed: smallest time constant while dv/dt is not known [s].
    """

    def __init__(self, tau: float, without_speed: float = OFFSET_LOST_SPEED_S) -> None:
        self._tau = tau
        self._without_speed = without_speed
        self.restart()

    def restart(self) -> None:
        """Forget the mean: later motion is not continuous with earlier motion."""
        self._sums = [0.0] * 5
        self._weight = 0.0

    @property
    def ready(self) -> bool:
        """True if the mean contains enough straight motion."""
        return self._weight >= min(OFFSET_SETTLED_S, 0.6 * self._tau)

    def mean(self) -> list[float]:
        """Return the means of fx, fy, fz, dv/dt and v r (speed times yaw rate) [m/s^2]."""
        if self._weight <= 0.0:
            return [0.0] * 5
        return [s / self._weight for s in self._sums]

    def add_interval(
        self, interval: SpeedInterval, dvdt: float, lateral: float, with_speed: bool
    ) -> None:
        """Process a straight interval with its dv/dt and v r (speed times yaw rate) [m/s^2]."""
        if self._tau > 0.0:
            dt = interval.t1 - interval.t0
            least = OFFSET_INTERVALS * dt if with_speed else self._without_speed
            keep = math.exp(-dt / max(self._tau, least))
            values = (interval.fx, interval.fy, interval.fz, dvdt, lateral)
            self._sums = [s * keep + v * dt for s, v in zip(self._sums, values, strict=True)]
            self._weight = self._weight * keep + dt

    def fade(self, dt: float) -> None:
        """Process an interval that is not straight: the weight of the offset decreases."""
        keep = math.exp(-dt / OFFSET_FADE_S)
        self._sums = [s * keep for s in self._sums]
        self._weight *= keep


class StraightGate:
    """Decides whether an interval is straight motion.

    The decision is made by the first recogniser, or group of recognisers, whose signals are
    available. The limit on the lateral acceleration must also hold. The lateral acceleration is v r
    (speed times yaw rate) if both factors are known, otherwise the vehicle's own lateral
    acceleration, otherwise the horizontal force that dv/dt does not explain.
    """

    def __init__(self, settings: PublishedSettings, offset: WanderingOffset) -> None:
        self._limits = settings.calibration.straight
        self._smoothing = max(1, round(self._limits.consistency_mean / TICK_S))
        self._offset = offset
        self.restart()

    def restart(self) -> None:
        """Forget the window of angles."""
        kept = self._limits.consistency_window + self._smoothing
        self._recent: deque[Vector] = deque(maxlen=kept)

    def push(self, force: Vector) -> None:
        """Process a tick's specific force (3,), sensor axes [m/s^2]."""
        self._recent.append(force)

    def is_straight(
        self, interval: SpeedInterval, steering: float, own_lateral: float, level: Matrix3
    ) -> bool:
        """Return True if the interval is straight.

        steering: steering wheel angle [rad] or NaN. own_lateral: the vehicle's lateral acceleration
        [m/s^2] or NaN. level: rotation sensor -> level (3, 3).
        """
        lateral = interval.speed * interval.yaw_rate
        if not self._lateral_is_small(interval, lateral, own_lateral, level):
            return False
        s = self._limits
        measured = {
            "yaw_rate": (interval.yaw_rate, self._yaw_rate_limit(lateral)),
            "steering": (steering, s.steering_limit),
        }
        for group in s.groups:
            signals = [measured[name] for name in group if name in measured]
            if any(isnan(value) for value, _ in signals):
                continue
            agree = "consistency" not in group or self._window_agrees(level)
            return agree and all(abs(value) <= most for value, most in signals)
        return False

    def is_turning(self, interval: SpeedInterval) -> bool:
        """True if an interval clearly exceeds the limit of yaw rate or lateral acceleration."""
        s = self._limits
        lateral = abs(interval.speed * interval.yaw_rate)
        if lateral > TURN_FACTOR * s.lateral_limit > 0.0:
            return True
        return abs(interval.yaw_rate) > TURN_FACTOR * self._yaw_rate_limit(lateral)

    def _yaw_rate_limit(self, lateral: float) -> float:
        """Return the limit on the yaw rate.

        The wider limit applies to motion whose v r (speed times yaw rate) is known and has a limit
        too.
        """
        s = self._limits
        gated = s.lateral_limit > 0.0 and not isnan(lateral)
        return s.yaw_rate_limit if gated else s.yaw_rate_limit_without_speed

    def _lateral_is_small(
        self, interval: SpeedInterval, lateral: float, own_lateral: float, level: Matrix3
    ) -> bool:
        limit = self._limits.lateral_limit
        if limit <= 0.0:
            return True
        if not isnan(lateral):
            return abs(lateral) <= limit
        if not isnan(own_lateral):
            return abs(own_lateral) <= limit
        return self._unexplained(interval, level) <= limit + UNEXPLAINED_NOISE

    def _unexplained(self, interval: SpeedInterval, level: Matrix3) -> float:
        """Return the horizontal force that dv/dt does not explain [m/s^2]; 0 if dv/dt is not
        known."""
        if isnan(interval.dvdt) or not self._offset.ready:
            return 0.0
        mx, my, mz, m_dvdt, _ = self._offset.mean()
        x, y, _ = (
            level @ np.array((interval.fx - mx, interval.fy - my, interval.fz - mz))
        ).tolist()
        along = interval.dvdt - m_dvdt
        return math.sqrt(max(x * x + y * y - along * along, 0.0))

    def _window_agrees(self, level: Matrix3) -> bool:
        """Recogniser 3: return True if the smoothed angles of the last window agree. The offset is
        removed first.

        Motion at constant speed shows no target angle, but counts as straight, so that the offset
        can be estimated. Such motion is too weak to give a target angle.
        """
        n = self._smoothing
        if len(self._recent) <= n:
            return False
        forces = np.array(self._recent)
        if self._offset.ready:
            forces = forces - np.array(self._offset.mean()[:3])
        sums = np.cumsum(forces, axis=0)
        smooth = ((sums[n:] - sums[:-n]) / n) @ level.T
        sizes = np.hypot(smooth[:, 0], smooth[:, 1])
        least = self._limits.min_speed_change
        if not self._offset.ready or float(sizes.max()) < least:
            return True
        strong = sizes >= 0.5 * least
        angles = np.arctan2(smooth[strong, 1], smooth[strong, 0])
        return angles_agree(angles, self._limits.consistency_range)
