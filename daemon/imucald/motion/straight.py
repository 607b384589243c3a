"""Straight-line motion: the recognisers of method A (step 4), and the source of the yaw rate.

Each recogniser can be used alone. A limit on the yaw rate alone is not enough at speed: at 2 deg/s
and 20 m/s the centripetal acceleration is 0.7 m/s^2. A limit on the lateral acceleration v*r is
therefore added to the published recognisers.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imucald.motion.standstill import MAX_ZERO_OFFSET
from imucald.motion.ticks import GYRO, STEERING, YAW_RATE, TickRow

OFFSET_MEMORY = 600
"""Largest weight of an offset, in ticks at rest. Older data are forgotten, because the offset
drifts with temperature."""
MAX_HOLD_TICKS = 10
"""Number of ticks for which the last value of a slow signal is used as the present value."""


def angles_agree(angles: ArrayLike, spread: float) -> bool:
    """Return whether angles (N,) [rad] lie in an arc of `spread` [rad], anywhere on the circle."""
    a = np.sort(np.mod(np.asarray(angles, dtype=float), 2.0 * math.pi))
    if len(a) < 2:
        return len(a) == 1
    widest_hole = max(float(np.max(np.diff(a))), float(a[0] + 2.0 * math.pi - a[-1]))
    return 2.0 * math.pi - widest_hole <= spread


def yaw_rate_from_steering(
    speed: float, steering: float, steering_ratio: float, wheelbase: float
) -> float:
    """Return the yaw rate [rad/s] of a vehicle that rolls without slip: r = v tan(delta / n) / L.

    speed [m/s], steering-wheel angle delta [rad], steering ratio n, wheelbase L [m].
    """
    return speed * math.tan(steering / steering_ratio) / wheelbase


def yaw_rate_with_understeer(
    speed: NDArray[np.float64],
    steering: NDArray[np.float64],
    steering_ratio: float,
    wheelbase: float,
    understeer: float,
) -> NDArray[np.float64]:
    """Return the yaw rate (N,) [rad/s] with tyre slip in bends, for small steering angles.

    r = v delta / (n L (1 + K v^2 / L)), with understeer K [rad/(m/s^2)] (Gillespie, Fundamentals of
    Vehicle Dynamics, ch. 6).
    """
    bend = steering_ratio * wheelbase * (1.0 + understeer / wheelbase * speed * speed)
    result: NDArray[np.float64] = speed * steering / bend
    return result


class ZeroOffset:
    """Mean of a signal at rest. Old values are slowly forgotten."""

    def __init__(self) -> None:
        self.value = 0.0
        self._n = 0

    def add_value_at_rest(self, x: float) -> None:
        """Process the signal's value at rest."""
        self._n = min(self._n + 1, OFFSET_MEMORY)
        self.value += (x - self.value) / self._n

    @property
    def known(self) -> bool:
        """True if the signal was at rest for long enough (a second)."""
        return self._n >= 10


class YawRateSource:
    """The vehicle's yaw rate [rad/s, positive to the left] from the best available signal.

    The order of preference is: the vehicle's own yaw rate, the sensor's gyroscope about the
    vertical, the steering angle with the speed. For yaw rate and gyroscope, the offset at rest is
    subtracted.
    """

    def __init__(self, steering_ratio: float, wheelbase: float, use_steering: bool = True) -> None:
        self._ratio = steering_ratio
        self._wheelbase = wheelbase
        self._use_steering = use_steering
        self._offset = ZeroOffset()
        self._gyro_offset = (ZeroOffset(), ZeroOffset(), ZeroOffset())
        self.restart()

    def restart(self) -> None:
        """Forget held values, and keep the offsets."""
        self._rate = math.nan
        self._rate_age = MAX_HOLD_TICKS + 1
        self._gyro: tuple[float, float, float] | None = None
        self._gyro_age = MAX_HOLD_TICKS + 1
        self._steering = math.nan
        self._steering_age = MAX_HOLD_TICKS + 1
        self.source = ""

    @property
    def steering(self) -> float:
        """Present steering-wheel angle [rad]; NaN if it is not known."""
        return self._steering if self._steering_age <= MAX_HOLD_TICKS else math.nan

    def take_tick(
        self,
        tick: TickRow,
        up: tuple[float, float, float] | None,
        speed: float,
        at_rest: bool,
    ) -> float:
        """Process a tick and return the yaw rate [rad/s], or NaN.

        up: unit vector up in sensor axes. speed: [m/s] or NaN. at_rest: the vehicle stands now.
        """
        self._take(tick, at_rest)
        if self._rate_age <= MAX_HOLD_TICKS:
            self.source = "yaw_rate"
            return self._rate - self._offset.value
        if self._gyro is not None and self._gyro_age <= MAX_HOLD_TICKS and up is not None:
            self.source = "gyro"
            (x, y, z), (ox, oy, oz) = self._gyro, self._gyro_offset
            return (x - ox.value) * up[0] + (y - oy.value) * up[1] + (z - oz.value) * up[2]
        steering = self.steering
        if self._use_steering and not (math.isnan(steering) or math.isnan(speed)):
            self.source = "steering"
            return yaw_rate_from_steering(speed, steering, self._ratio, self._wheelbase)
        self.source = ""
        return math.nan

    def _take(self, tick: TickRow, at_rest: bool) -> None:
        if tick[YAW_RATE.n] > 0.0:
            self._rate, self._rate_age = tick[YAW_RATE.mean], 0
            if at_rest and abs(self._rate) < MAX_ZERO_OFFSET:
                self._offset.add_value_at_rest(self._rate)
        else:
            self._rate_age += 1
        if tick[GYRO.n] > 0.0 and tick[GYRO.bad] == 0.0:
            self._gyro = (tick[GYRO.x], tick[GYRO.y], tick[GYRO.z])
            self._gyro_age = 0
            if at_rest and max(map(abs, self._gyro)) < MAX_ZERO_OFFSET:
                for offset, value in zip(self._gyro_offset, self._gyro, strict=True):
                    offset.add_value_at_rest(value)
        else:
            self._gyro_age += 1
        if tick[STEERING.n] > 0.0:
            self._steering, self._steering_age = tick[STEERING.mean], 0
        else:
            self._steering_age += 1
