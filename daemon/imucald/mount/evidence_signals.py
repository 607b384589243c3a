"""From ticks to even signals: force, rate, speed, dv/dt and yaw rate on one 10 Hz grid.

Works in hops of `HOP` ticks, `LAG` ticks late, so that signals slower than the grid can be
interpolated between samples on both sides. Says for every tick whether it may be learnt from.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from imucald.motion import ticks as tk
from imucald.motion.ticks import TICK_S, TickRow
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.samples import GRAVITY

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

HOP = 32
"""Ticks per hop: 3.2 s between two looks at the data."""
LAG = 16
"""Ticks the work runs behind: a speed of 1 Hz with jitter must have come."""
BEFORE = 24
"""Ticks of context in front of a hop."""
KEEP = BEFORE + LAG
ACCEL_GAP = 0.35
"""Longest hole bridged in accelerometer or gyroscope [s]; 5 Hz with one loss."""
SPEED_GAP = 2.3
"""Longest hole bridged in speed [s]; 1 Hz with one loss."""
YAW_GAP = 0.5
REST_SPEED = 0.05
"""A speed below is standstill [m/s]."""
REST_TICKS = 12
"""Speed must have been zero that long before it counts as rest: braking jerk dies out."""
STUCK_TICKS = 12
"""Identical accelerometer means for that long are a stuck signal: noise always moves."""
FORCE_LOW, FORCE_HIGH = 0.5 * GRAVITY, 1.7 * GRAVITY
"""Mean specific force outside is no road vehicle on a road."""
SPREAD_FLOOR, SPREAD_SLOPE = 0.6, 0.03
"""Wheel speeds may differ by this [m/s] and this share of the speed, beyond the curve."""
REST_MEMORY = 250.0
"""Ticks at rest after which a gyro bias is forgotten: it wanders with temperature."""
GUESS_TICKS = 250
"""Ticks of driving from which a gyro bias can be guessed without a rest."""
NOMINAL_SPEED = 12.0
"""Where there is no speed signal, v r is taken with this [m/s]; its gain is free."""
HOPS_WITHOUT_SPEED = 8
"""Hops without any speed after which the estimator does without (26 s)."""
HOLD_TICKS = 10
"""Ticks around a wheel-slip or saturation event that are not learnt from either."""


@dataclass
class Prepared:
    """One hop of signals; N = HOP. Values where a flag is False are finite but meaningless."""

    t: Array
    force: Array  # (N, 3) [m/s^2] sensor axes
    rate: Array  # (N, 3) [rad/s] sensor axes, gyro bias removed
    speed: Array  # (N,) [m/s], negative in reverse
    accel: Array  # (N,) dv/dt [m/s^2]
    yaw_rate: Array  # (N,) of the vehicle bus or from steering [rad/s], offset removed
    ok_force: Flags
    ok_rate: Flags
    ok_speed: Flags
    ok_yaw: Flags
    rest: Flags
    learn: Flags  # nothing forbids to learn
    steering: Array  # (N,) steering-wheel angle as it comes [rad]
    ok_steering: Flags
    had_rate: Flags  # as ok_rate, but also while the bias was not known
    gyro_bias: Array  # (3,) what was taken off the rate

    def with_gyro_bias(self, gyro_bias: Array) -> Prepared:
        """The same hop as if that gyro bias [rad/s] (3,) had been known."""
        rate = self.rate + (self.gyro_bias - gyro_bias)
        return replace(self, rate=rate, ok_rate=self.had_rate, gyro_bias=gyro_bias)


def empty_rows(n: int) -> Array:
    """Rows of ticks without any sample, (n, COLUMNS)."""
    accumulator = tk.TickAccumulator()
    return np.tile(np.array(accumulator.close(0)), (n, 1))


_EMPTY = empty_rows(1)[0]


def bridged(at: Array, times: Array, values: Array, longest: float) -> tuple[Array, Flags]:
    """Interpolate samples (M,) or (M, w) at times (N,); False where the hole is too long."""
    if len(times) < 1:
        return np.zeros((len(at), *values.shape[1:])), np.zeros(len(at), dtype=bool)
    after = np.searchsorted(times, at)
    m = len(times)
    right = times[np.minimum(after, m - 1)]
    left = times[np.maximum(after - 1, 0)]
    hole = np.where(after == 0, right - at, np.where(after == m, at - left, right - left))
    ends = (after == 0) | (after == m)
    ok = hole <= np.where(ends, 0.3 * longest, longest)
    if values.ndim == 1:
        return np.interp(at, times, values), ok
    out = np.empty((len(at), values.shape[1]))
    for i in range(values.shape[1]):
        out[:, i] = np.interp(at, times, values[:, i])
    return out, ok


def spread_out(flags: Flags, ticks: int) -> Flags:
    """Flags widened by that many ticks to both sides."""
    if not flags.any():
        return flags
    out = flags.copy()
    for i in np.flatnonzero(flags):
        out[max(0, i - ticks) : i + ticks + 1] = True
    return out


class SignalPreparer:
    """Keeps the last ticks and cuts them into hops."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._rows = np.tile(_EMPTY, (KEEP + HOP, 1))
        self._n = KEEP
        self.gyro_bias = np.zeros(3)
        self.gyro_bias_weight = 0.0
        self.yaw_offset = 0.0
        self.yaw_offset_weight = 0.0
        self.steering_offset = 0.0
        self.frozen: Counter[str] = Counter()
        self._reverse = 0.0
        self._rest_run = 0
        self._moving_n = 0
        self._moving_rate = np.zeros(3)
        self._moving_force = np.zeros(3)
        self._moving_turns: list[float] = []
        self.seen: set[str] = set()
        self.hops = 0

    @property
    def without_speed(self) -> bool:
        """Whether there has been no speed signal, for long enough to do without."""
        return self.hops > HOPS_WITHOUT_SPEED and "speed" not in self.seen

    def push(self, tick: TickRow) -> bool:
        """Take a tick; True when a hop is complete and `hop` is to be called."""
        self._rows[self._n] = tick
        self._n += 1
        return self._n == KEEP + HOP

    def restart(self) -> None:
        """Forget the kept ticks: time jumped."""
        self._rows[:] = _EMPTY
        self._n = KEEP
        self._rest_run = 0

    def hop(self) -> Prepared:
        """Return the signals of the next hop."""
        rows = self._rows
        part = slice(BEFORE - 1, BEFORE + HOP + 1)  # one more at both ends, for dv/dt
        end = rows[-1, tk.T]
        t = end + (np.arange(len(rows)) - (len(rows) - 1)) * TICK_S
        at = t[part] - 0.5 * TICK_S
        mid = slice(1, HOP + 1)
        force, ok_force = self._vector(t, at, tk.ACCEL_N, tk.ACCEL_X, tk.ACCEL_AGE, ACCEL_GAP)
        rate, ok_rate = self._vector(t, at, tk.GYRO_N, tk.GYRO_X, tk.GYRO_AGE, ACCEL_GAP)
        self.hops += 1
        speed, ok_speed = self._speed(t, at)
        yaw_rate, ok_yaw = self._yaw_rate(t, at, speed)
        accel = (speed[2:] - speed[:-2]) / (2.0 * TICK_S)
        rest = self._rest(speed[mid], ok_speed[mid], force[mid], rate[mid], ok_rate[mid])
        bad = self._forbidden(force, ok_force, speed, ok_speed, yaw_rate)
        prepared = Prepared(
            t=t[part][mid],
            force=force[mid],
            rate=rate[mid],
            speed=speed[mid],
            accel=accel,
            yaw_rate=yaw_rate[mid],
            ok_force=ok_force[mid],
            ok_rate=ok_rate[mid],
            ok_speed=ok_speed[mid] & ok_speed[2:] & ok_speed[:-2],
            ok_yaw=ok_yaw[mid],
            rest=rest,
            learn=~bad[mid] & ok_force[mid],
            steering=self._steering[0][mid],
            ok_steering=self._steering[1][mid],
            had_rate=ok_rate[mid],
            gyro_bias=self.gyro_bias,
        )
        if self.without_speed:
            prepared.speed = np.where(rest, 0.0, NOMINAL_SPEED)
            prepared.accel = np.zeros(HOP)
            prepared.ok_speed = prepared.ok_force
        self._learn_offsets(prepared)
        if self.gyro_bias_weight == 0.0:
            self._guess_gyro_bias(prepared)
        prepared.gyro_bias = self.gyro_bias.copy()
        prepared.rate -= self.gyro_bias
        prepared.yaw_rate -= self.yaw_offset
        rows[:KEEP] = rows[HOP:].copy()
        self._n = KEEP
        return prepared

    def _vector(
        self, t: Array, at: Array, n: int, first: int, age: int, longest: float
    ) -> tuple[Array, Flags]:
        rows = self._rows
        has = rows[:, n] > 0
        if has.all():
            times = t - rows[:, age]
            values = rows[:, first : first + 3]
        else:
            times = t[has] - rows[has, age]
            values = rows[has, first : first + 3]
        return bridged(at, times, values, longest)

    def _speed(self, t: Array, at: Array) -> tuple[Array, Flags]:
        rows = self._rows
        has = rows[:, tk.SPEED_N] > 0
        if has.any():
            self.seen.add("speed")
        speed, ok = bridged(at, t[has] - rows[has, tk.SPEED_AGE], rows[has, tk.SPEED], SPEED_GAP)
        known = rows[:, tk.REVERSE]
        if not np.isnan(known).all():
            self.seen.add("reverse")
        if self._reverse or (known > 0.5).any():
            reverse = self._held(known)[BEFORE - 1 : BEFORE + HOP + 1]
            speed = np.where(reverse > 0.5, -speed, speed)
        return speed, ok

    def _held(self, known: Array) -> Array:
        """Reverse gear, the last known value held; remembers the one at the hop's start."""
        out = np.empty(len(known))
        value = self._reverse
        for i, k in enumerate(known.tolist()):
            if not math.isnan(k):
                value = k
            out[i] = value
            if i == HOP - 1:
                self._reverse = value
        return out

    def _yaw_rate(self, t: Array, at: Array, speed: Array) -> tuple[Array, Flags]:
        rows = self._rows
        has = rows[:, tk.STEERING_N] > 0
        angle, ok_angle = np.zeros(len(at)), np.zeros(len(at), dtype=bool)
        if has.any():
            self.seen.add("steering")
            angle, ok_angle = bridged(at, t[has] - 0.5 * TICK_S, rows[has, tk.STEERING], YAW_GAP)
        self._steering = angle, ok_angle
        has = rows[:, tk.YAW_RATE_N] > 0
        if has.any():
            self.seen.add("yaw_rate")
            return bridged(at, t[has] - 0.5 * TICK_S, rows[has, tk.YAW_RATE], YAW_GAP)
        s = self._settings
        if s.steering_ratio is None or not ok_angle.any():
            return np.zeros(len(at)), np.zeros(len(at), dtype=bool)
        bend = s.steering_ratio * s.wheelbase * (1.0 + s.understeer / s.wheelbase * speed * speed)
        return speed * (angle - self.steering_offset) / bend, ok_angle

    def _rest(self, speed: Array, ok: Flags, force: Array, rate: Array, ok_rate: Flags) -> Flags:
        """At rest: speed zero (where there is one) and the force still."""
        rest = np.zeros(len(speed), dtype=bool)
        if ok.any():
            still = ok & (np.abs(speed) < REST_SPEED)
        else:
            move = np.abs(np.diff(force, axis=0, prepend=force[:1])).max(axis=1)
            still = (move < 0.12) & (force.std(axis=0).max() < 0.06)
            if ok_rate.any():
                still &= rate.std(axis=0).max() < 0.01
        run = self._rest_run
        for i, s in enumerate(still.tolist()):
            run = run + 1 if s else 0
            rest[i] = run > REST_TICKS
        self._rest_run = run
        return rest

    def _forbidden(
        self, force: Array, ok_force: Flags, speed: Array, ok_speed: Flags, yaw_rate: Array
    ) -> Flags:
        """Ticks that nothing may be learnt from, each reason counted."""
        rows = self._rows[BEFORE - 1 : BEFORE + HOP + 1]
        s = self._settings
        size2 = (force * force).sum(axis=1)
        bad: Flags = ok_force & ((size2 < FORCE_LOW**2) | (size2 > FORCE_HIGH**2))
        if bad.any():
            self.frozen["implausible"] += int(bad.sum())
        high = 0.98 * s.accel_range
        peak = np.maximum(
            rows[:, tk.ACCEL_MAX_X : tk.ACCEL_MAX_X + 3],
            -rows[:, tk.ACCEL_MIN_X : tk.ACCEL_MIN_X + 3],
        )
        clipped = (peak > high).any(axis=1) | (rows[:, tk.ACCEL_BAD] > 0)
        if clipped.any():
            self.frozen["saturated"] += int(clipped.sum())
            bad = bad | spread_out(clipped, 3)
        same = (np.diff(force, axis=0) == 0.0).all(axis=1)
        if same.sum() >= STUCK_TICKS:
            self.frozen["stuck"] += int(same.sum())
            bad = bad | np.append(same, same[-1])
        slip = rows[:, tk.WHEELS_N] > 0
        if slip.any():
            allowed = SPREAD_FLOOR + SPREAD_SLOPE * np.abs(speed) + 1.5 * s.track * np.abs(yaw_rate)
            slip &= np.nan_to_num(rows[:, tk.WHEEL_SPREAD]) > allowed
            if slip.any():
                self.frozen["wheel_slip"] += int(slip.sum())
                bad = bad | spread_out(slip, HOLD_TICKS)
        wild = ok_speed & (np.abs(np.gradient(speed, TICK_S)) > 12.0)
        if wild.any():
            self.frozen["speed_jump"] += int(wild.sum())
            bad = bad | spread_out(wild, HOLD_TICKS)
        return bad

    def _guess_gyro_bias(self, p: Prepared) -> None:
        """Before the first rest: about the level axes the mean rate, about the vertical the median.

        A road vehicle neither pitches nor rolls on and on, and drives straight most of the time.
        Until that holds the gyroscope is not used.
        """
        use = p.ok_rate & p.learn
        n = int(use.sum())
        if n:
            self._moving_n += n
            self._moving_rate += p.rate[use].sum(axis=0)
            self._moving_force += p.force[use].sum(axis=0)
            up = self._moving_force / np.sqrt(self._moving_force @ self._moving_force)
            self._moving_turns.append(float(np.median(p.rate[use] @ up)))
            mean = self._moving_rate / self._moving_n
            self.gyro_bias = mean + up * (float(np.median(self._moving_turns)) - mean @ up)
        p.had_rate = p.ok_rate
        if self._moving_n < GUESS_TICKS:
            p.ok_rate = np.zeros_like(p.ok_rate)

    def _learn_offsets(self, p: Prepared) -> None:
        """Gyro bias and yaw-rate offset at rest: means, slowly forgetting."""
        use = p.rest & p.ok_rate & p.learn
        n = float(use.sum())
        if n >= 8:
            mean = p.rate[use].mean(axis=0)
            if np.abs(p.rate[use] - mean).max() < 0.05:
                self.gyro_bias_weight = min(self.gyro_bias_weight + n, REST_MEMORY)
                self.gyro_bias = self.gyro_bias + (mean - self.gyro_bias) * (
                    n / self.gyro_bias_weight
                )
        use = p.rest & p.ok_yaw
        n = float(use.sum())
        if n >= 8 and "yaw_rate" in self.seen:
            self.yaw_offset_weight = min(self.yaw_offset_weight + n, REST_MEMORY)
            gain = n / self.yaw_offset_weight
            self.yaw_offset += (float(p.yaw_rate[use].mean()) - self.yaw_offset) * gain
