"""Attitude of a carried terminal: the rotation from terminal axes to earth axes, sample by sample.

The gyroscope gives the attitude, and the accelerometer levels it slowly (a complementary filter as
in Mahony, Hamel and Pflimlin, IEEE Trans. Automatic Control 53, 2008). North comes from
`NorthFilter` or from a compass signal.
"""

from __future__ import annotations

import math

from imucald.config.attitude import AlternativeSettings
from imucald.core.rotations import (
    IDENTITY,
    Quaternion,
    Rows,
    Vector,
    cross,
    levelling_rotation,
    quaternion_from_rotation,
    quaternion_from_vector,
    quaternion_product,
    quaternion_turned,
    rows_from_quaternion,
    times,
)
from imucald.motion.lost_time import LostTime
from imucald.motion.standstill import is_terminal_at_rest
from imucald.travel_direction.certainty import COMPASS_STD, MIN_HORIZONTAL
from imucald.travel_direction.north import NorthFilter

GAP_S = 0.5
"""Time between samples above which they are not a steady stream [s]."""
REST_S = 1.0


class TerminalAttitude:
    """Rotation from terminal axes to the level frame P, and the direction of north in P."""

    def __init__(self, settings: AlternativeSettings) -> None:
        self.settings = settings
        self.north = NorthFilter()
        self.zero_error: Vector = (0.0, 0.0, 0.0)
        """Zero error of the gyroscope, measured at rest [rad/s]."""
        self._lost_time = LostTime()
        self.restart()

    def restart(self) -> None:
        """Begin again, because time has jumped."""
        self.q: Quaternion = IDENTITY
        """Rotation from the terminal to P."""
        self.level: Rows = rows_from_quaternion(IDENTITY)
        self.turned = 0.0
        """Total turn about the vertical from the gyroscope, clockwise seen from above [rad]."""
        self.ready = False
        self.north.restart()
        self._signal_yaw: float | None = None
        self._t_gyro = self._t_accel = self._t_signal = -math.inf
        self.rate: Vector = (0.0, 0.0, 0.0)
        """Newest angular rate minus the zero error, in terminal axes [rad/s]."""
        self._age = self._signal_age = 0.0
        self._rest_begin()

    def gyro(self, t: float, raw: Vector) -> None:
        """Process an angular rate [rad/s].

        The frame P restarts after a time in which the rotation of the terminal was not measured.
        """
        dt = t - self._t_gyro
        is_lost = 0.0 <= dt < math.inf and self._lost_time.take_time_step(dt) > 0.0
        self._rest(t, raw)
        b = self.zero_error
        rate = (raw[0] - b[0], raw[1] - b[1], raw[2] - b[2])
        if dt > GAP_S or is_lost:
            if self.ready:
                self.restart()
        elif dt > 0.0:
            k = 0.5 * dt
            last = self.rate
            v = (k * (rate[0] + last[0]), k * (rate[1] + last[1]), k * (rate[2] + last[2]))
            self.turned -= times(self.level, v)[2]
            self._set(quaternion_turned(self.q, *v))
        self._t_gyro, self.rate = t, rate

    def accel(self, t: float, force: Vector) -> None:
        """Process a specific force [m/s^2], which levels the attitude."""
        size = math.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
        dt = min(t - self._t_accel, GAP_S)
        self._t_accel = t
        if size < 1.0 or dt <= 0.0:
            return
        if not self.ready:
            self._set(quaternion_from_rotation(levelling_rotation(force)))
            self.ready, self._age = True, 0.0
            return
        self._age += dt
        x, y, z = times(self.level, force)
        part = dt / (min(self.settings.gravity_time, self._age) + dt)
        ex, ey, _ = cross((x / size, y / size, z / size), (0.0, 0.0, 1.0))
        self._set(quaternion_product(quaternion_from_vector(ex * part, ey * part, 0.0), self.q))

    def mag(self, t: float, field: Vector) -> None:
        """Process a magnetic field [T]."""
        if self.ready:
            self.north.add_field(t, field, self.level)

    def compass(self, t: float, heading: float) -> None:
        """Process a heading of the y axis from another source, clockwise from north [rad]."""
        if not self.ready:
            return
        x, y, _ = times(self.level, (0.0, 1.0, 0.0))
        if math.hypot(x, y) < MIN_HORIZONTAL:
            return
        yaw = math.atan2(x, y) - heading
        dt = min(max(t - self._t_signal, 0.0), 2.0)
        self._t_signal = t
        if self._signal_yaw is None:
            self._signal_yaw, self._signal_age = yaw, 0.0
            return
        if dt <= 0.0:  # from the same snapshot: it has no weight
            return
        self._signal_age += dt
        part = dt / (min(self.settings.compass_time, self._signal_age) + dt)
        self._signal_yaw += part * math.remainder(yaw - self._signal_yaw, math.tau)

    @property
    def yaw(self) -> float | None:
        """Rotation about the vertical from P to the earth [rad]; None if north is not known."""
        return self._signal_yaw if self._signal_yaw is not None else self.north.yaw

    @property
    def yaw_std(self) -> float:
        """Deviation of `yaw` [rad]."""
        return COMPASS_STD if self._signal_yaw is not None else self.north.std

    def _set(self, q: Quaternion) -> None:
        self.q = q
        self.level = rows_from_quaternion(q)

    def _rest_begin(self) -> None:
        self._rest_start = math.nan
        self._low = [math.inf] * 3
        self._high = [-math.inf] * 3
        self._total = [0.0] * 3
        self._n = 0

    def _rest(self, t: float, raw: Vector) -> None:
        """Use the mean rate over a second without any turn as the gyroscope's zero error."""
        if math.isnan(self._rest_start):
            self._rest_start = t
        self._n += 1
        for i, w in enumerate(raw):
            self._low[i] = min(self._low[i], w)
            self._high[i] = max(self._high[i], w)
            self._total[i] += w
        if t - self._rest_start < REST_S:
            return
        x, y, z = self._total
        mean = x / self._n, y / self._n, z / self._n
        spread = max(high - low for high, low in zip(self._high, self._low, strict=True))
        if is_terminal_at_rest(spread, mean):
            self.zero_error = mean
            self.north.rested()
        self._rest_begin()
