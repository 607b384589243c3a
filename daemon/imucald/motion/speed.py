"""Compute dv/dt from a speed signal that may be slow, coarse and late, and pair it with the
accelerometer.

Between two speed samples, (v1 - v0) / (t1 - t0) is exactly the mean of dv/dt over the interval, at
any sample rate. No smoothing is therefore needed. The accelerometer is averaged over the same
interval, shifted by the speed's delay. A `SpeedInterval` contains both means. Coarse steps of the
speed then only add noise to dv/dt, which does not correlate with the accelerometer.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from imucald.config.base import MAX_SPEED_DELAY, MIN_SPEED_DELAY
from imucald.core.errors import EstimateError
from imucald.motion.ticks import TICK_S

HISTORY_TICKS = 64
"""Number of ticks whose running sums are kept. This number is enough for any delay and an interval
of up to 4 s."""


class SpeedInterval(NamedTuple):
    """Motion over an interval. All values are means over the interval; NaN if not known.

    t0, t1: begin and end in accelerometer time [s]. fx, fy, fz: specific force, sensor axes
    [m/s^2]. speed: [m/s], negative in reverse. dvdt: [m/s^2]. yaw_rate: [rad/s]. clean: True if no
    sample was rejected.
    """

    t0: float
    t1: float
    fx: float
    fy: float
    fz: float
    speed: float
    dvdt: float
    yaw_rate: float
    clean: bool


class _Sums(NamedTuple):
    t: float
    x: float
    y: float
    z: float
    yaw: float
    bad: float
    yaw_unknown: float


class SpeedIntervalMaker:
    """Divides the ticks into intervals: at speed samples, or by time if there is no speed.

    block_s: shortest interval [s]. delay: delay of the speed against the accelerometer [s]; it is
    negative if the speed leads. timeout: time without speed [s] after which the speed is unknown.
    """

    def __init__(self, block_s: float, delay: float, timeout: float) -> None:
        if not MIN_SPEED_DELAY <= delay <= MAX_SPEED_DELAY:
            raise EstimateError(
                f"a speed delay of {delay} s is not possible: it must be "
                f"{MIN_SPEED_DELAY} to {MAX_SPEED_DELAY} s"
            )
        self._block_s = block_s
        self._delay = delay
        self._timeout = timeout
        self.restart()

    def restart(self) -> None:
        """Forget everything, because time has jumped."""
        self._rows: deque[_Sums] = deque(maxlen=HISTORY_TICKS)
        self._last = _Sums(-math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._pending: deque[tuple[float, float]] = deque(maxlen=HISTORY_TICKS)
        self._knot: _Sums | None = None
        self._knot_speed = math.nan
        self._speed_seen = -math.inf

    def add_speed(self, t: float, speed: float) -> None:
        """Process a signed speed sample [m/s] with the stream time t [s]."""
        self._pending.append((t - self._delay, speed))
        self._speed_seen = t

    def take_tick(
        self, t: float, fx: float, fy: float, fz: float, yaw_rate: float, clean: bool
    ) -> SpeedInterval | None:
        """Process the tick that ends at t [s].

        Returns an interval that is now complete, or None.
        """
        _, x, y, z, yaw, bad, unknown = self._last
        known = not math.isnan(yaw_rate)
        last = self._last = _Sums(
            t,
            x + fx * TICK_S,
            y + fy * TICK_S,
            z + fz * TICK_S,
            yaw + yaw_rate * TICK_S if known else yaw,
            bad if clean else bad + 1.0,
            unknown if known else unknown + 1.0,
        )
        self._rows.append(last)
        if t - self._speed_seen > self._timeout:
            self._pending.clear()
            if self._knot is None or t - self._knot.t >= self._block_s - 0.5 * TICK_S:
                return self._cut(last, math.nan)
            return None
        while self._pending and self._pending[0][0] <= t:
            at, speed = self._pending.popleft()
            if self._knot is None or at - self._knot.t >= self._block_s - 0.5 * TICK_S:
                return self._cut(self._at(at), speed)
        return None

    def _at(self, t: float) -> _Sums | None:
        """Return the interpolated running sums at time t; None before the history begins."""
        rows = self._rows
        back = int((rows[-1].t - t) / TICK_S)
        if back + 2 > len(rows):
            return None
        a, b = rows[-2 - back], rows[-1 - back]
        part = (t - a.t) / (b.t - a.t)
        return _Sums(
            t,
            a.x + part * (b.x - a.x),
            a.y + part * (b.y - a.y),
            a.z + part * (b.z - a.z),
            a.yaw + part * (b.yaw - a.yaw),
            b.bad,
            b.yaw_unknown,
        )

    def _cut(self, knot: _Sums | None, speed: float) -> SpeedInterval | None:
        before, speed_before = self._knot, self._knot_speed
        self._knot, self._knot_speed = knot, speed
        if before is None or knot is None:
            return None
        dt = knot.t - before.t
        if dt > self._timeout + self._block_s or dt <= 0.0:
            return None
        return SpeedInterval(
            t0=before.t,
            t1=knot.t,
            fx=(knot.x - before.x) / dt,
            fy=(knot.y - before.y) / dt,
            fz=(knot.z - before.z) / dt,
            speed=0.5 * (speed + speed_before),
            dvdt=(speed - speed_before) / dt,
            yaw_rate=(knot.yaw - before.yaw) / dt
            if knot.yaw_unknown == before.yaw_unknown
            else math.nan,
            clean=knot.bad == before.bad,
        )
