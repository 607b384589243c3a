"""From ticks to even signals: force, rate, speed, dv/dt and yaw rate on one 10 Hz grid.

Works in blocks of `BLOCK_TICKS` ticks, `LAG` ticks late, so that signals slower than the grid can
be interpolated between samples on both sides. Says for every tick whether it may be learnt from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from msgspec import Struct, field
from msgspec.structs import replace
from numpy.typing import NDArray

from imucald.motion import ticks as tk
from imucald.motion.signal_health import SignalHealth
from imucald.motion.standstill import (
    DRIVING_SPEED,
    ROLLING_SPEED,
    STEADY_TICKS,
    ZERO_SPEED,
    is_parked,
)
from imucald.motion.straight import yaw_rate_with_understeer
from imucald.motion.ticks import TICK_S, TickRow, empty_rows
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.gyro_walk import sampling_walk
from imucald.mount.offsets import Offsets

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

BLOCK_TICKS = 64
"""Ticks per block: 6.4 s between two looks at the data, whose cost is per look."""
BLOCK_S = BLOCK_TICKS * TICK_S
LAG = 16
"""Ticks the work runs behind: a speed of 1 Hz with jitter must have come."""
BEFORE = 24
"""Ticks of context in front of a block."""
KEEP = BEFORE + LAG
ACCEL_GAP = 0.35
"""Longest hole bridged in accelerometer or gyroscope [s]; 5 Hz with one loss."""
SPEED_GAP = 2.3
"""Longest hole bridged in speed [s]; 1 Hz with one loss."""
YAW_GAP = 0.5
REST_TICKS = 12
"""Speed must have been zero that long before it counts as rest: braking jerk dies out."""
NOMINAL_SPEED = 12.0
"""Where there is no speed signal, v r is taken with this [m/s]; its gain is free."""
BLOCKS_WITHOUT_SPEED = 4
"""Hops without any speed after which the estimator does without (26 s)."""


class SignalBlock(Struct):
    """One block, N = BLOCK_TICKS; where a flag is False, values are finite and mean nothing."""

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
    sided: Mapping[str, tuple[Array, Flags]] = field(default_factory=dict)
    # What else knows left from right: lateral_accel (N,) [m/s^2], heading (N,) [rad] as it comes,
    # without jumps at north; each with where it is known.
    rate_walk: Array = field(default_factory=lambda: np.zeros((3, 3)))
    # what samples that come seldom add to the angle, sensor axes [rad^2/s], see `gyro_walk`
    least_speed: float = 0.0  # up to so much the vehicle may creep while its speed is zero [m/s]

    def with_gyro_bias(self, gyro_bias: Array) -> SignalBlock:
        """The same block as if that gyro bias [rad/s] (3,) had been known."""
        rate = self.rate + (self.gyro_bias - gyro_bias)
        return replace(self, rate=rate, ok_rate=self.had_rate, gyro_bias=gyro_bias)


def bridged(at: Array, times: Array, values: Array, longest: float) -> tuple[Array, Flags]:
    """Interpolate samples (M,) or (M, w) at times (N,); False where the hole is too long."""
    if len(times) < 1:
        return np.zeros((len(at), *values.shape[1:])), np.zeros(len(at), dtype=bool)
    after = np.searchsorted(times, at)
    m = len(times)
    low, high = np.maximum(after - 1, 0), np.minimum(after, m - 1)
    right, left = times[high], times[low]
    width = right - left
    ok = width <= longest
    if after[0] == 0 or after[-1] == m:  # before the first sample, or after the last
        ends = (after == 0) | (after == m)
        ok[ends] = np.abs(at - left)[ends] <= 0.3 * longest
    if values.ndim == 1:
        return np.interp(at, times, values), ok
    if width.min() <= 0.0:
        width[width <= 0.0] = math.inf
    part = (at - left) / width
    before = values[low]
    out: Array = before + part[:, None] * (values[high] - before)
    return out, ok


class SignalBlockMaker:
    """Keeps the last ticks and cuts them into blocks."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._rows = empty_rows(KEEP + BLOCK_TICKS)
        self._n = KEEP
        self.offsets = Offsets()
        self.steering_offset = 0.0
        self._reverse = 0.0
        self._rest_run = 0
        self._rate_walk = np.zeros((3, 3))
        self._least_speed = DRIVING_SPEED
        new = slice(BEFORE, BEFORE + BLOCK_TICKS)
        self.health = SignalHealth(new, settings.calibration.full_scale, settings.vehicle.track)
        self.seen: set[str] = set()
        self.blocks = 0
        self.stuck: Mapping[str, bool] = {}
        """Of the vehicle's signals, whether any tick of the last block was stuck."""

    @property
    def without_speed(self) -> bool:
        """Whether there has been no speed signal, for long enough to do without."""
        return self.blocks > BLOCKS_WITHOUT_SPEED and "speed" not in self.seen

    def push(self, tick: TickRow) -> bool:
        """Take a tick; True when a block is complete and `block` is to be called."""
        self._rows[self._n] = tick
        self._n += 1
        return self._n == KEEP + BLOCK_TICKS

    @property
    def until_block(self) -> int:
        """Ticks until a block is complete."""
        return KEEP + BLOCK_TICKS - self._n

    def push_all(self, ticks: Array) -> None:
        """Take ticks (n, COLUMNS), fewer than `until_block`."""
        self._rows[self._n : self._n + len(ticks)] = ticks
        self._n += len(ticks)

    def restart(self) -> None:
        """Forget the kept ticks: time jumped."""
        self._rows[:] = empty_rows(1)
        self._n = KEEP
        self._rest_run = 0
        self.health.restart()

    def block(self) -> SignalBlock:
        """Return the signals of the next block."""
        rows = self._rows
        self.health.drop_impossible(rows[KEEP:])
        part = slice(BEFORE - 1, BEFORE + BLOCK_TICKS + 1)  # one more at both ends, for dv/dt
        end = rows[-1, tk.T]
        t = end + (np.arange(len(rows)) - (len(rows) - 1)) * TICK_S
        at = t[part] - 0.5 * TICK_S
        mid = slice(1, BLOCK_TICKS + 1)
        force, ok_force = self._vector(t, at, "accel", tk.ACCEL)
        rate, ok_rate = self._vector(t, at, "gyro", tk.GYRO)
        self.blocks += 1
        speed, ok_speed = self._speed(t, at)
        self._silence_parked(speed, ok_speed, force, rate if ok_rate.any() else None)
        yaw_rate, ok_yaw = self._yaw_rate(t, at, speed)
        accel = (speed[2:] - speed[:-2]) / (2.0 * TICK_S)
        rest = self._rest(speed[mid], ok_speed[mid], force[mid], rate[mid], ok_rate[mid])
        curve = np.maximum(np.abs(yaw_rate), np.sqrt((rate * rate).sum(axis=1)) * ok_rate)
        bad = self.health.untrusted(rows[part], force, ok_force, speed, ok_speed, curve)
        prepared = SignalBlock(
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
            gyro_bias=self.offsets.gyro_bias,
            sided=self._sided(t, at[mid]),
            rate_walk=self._rate_walk,
            least_speed=self._least_speed,
        )
        if self.without_speed:
            prepared.speed = np.where(rest, 0.0, NOMINAL_SPEED)
            prepared.accel = np.zeros(BLOCK_TICKS)
            prepared.ok_speed = prepared.ok_force
        self._take_offsets(prepared)
        self.stuck = dict(self.health.stuck_now)
        rows[:KEEP] = rows[BLOCK_TICKS:].copy()
        self._n = KEEP
        return prepared

    def _vector(
        self, t: Array, at: Array, signal: str, columns: tk.AccelColumns | tk.GyroColumns
    ) -> tuple[Array, Flags]:
        rows = self._rows
        has = (rows[:, columns.n] > 0) & ~self.health.stuck(signal, rows)
        mean = slice(columns.x, columns.z + 1)
        if has.all():
            times = t - rows[:, columns.age]
            values = rows[:, mean]
        else:
            times = t[has] - rows[has, columns.age]
            values = rows[has, mean]
        if signal == "gyro":
            self._rate_walk = sampling_walk(times, values, ACCEL_GAP)
        return bridged(at, times, values, ACCEL_GAP)

    def _speed(self, t: Array, at: Array) -> tuple[Array, Flags]:
        rows = self._rows
        has = rows[:, tk.SPEED.n] > 0
        if np.count_nonzero(has):
            self.seen.add("speed")
        has &= ~self.health.stuck("speed", rows)
        self._follow_least_speed(np.abs(rows[has, tk.SPEED.mean]))
        speed, ok = bridged(
            at, t[has] - rows[has, tk.SPEED.age], rows[has, tk.SPEED.mean], SPEED_GAP
        )
        known = rows[:, tk.REVERSE]
        if not np.isnan(known).all():
            self.seen.add("reverse")
        if self._reverse or np.count_nonzero(known > 0.5):
            reverse = self._held(known)[BEFORE - 1 : BEFORE + BLOCK_TICKS + 1]
            speed = np.where(reverse > 0.5, -speed, speed)
        return speed, ok

    def _silence_parked(self, speed: Array, ok: Flags, force: Array, rate: Array | None) -> None:
        """Where a speed is noise and the sensor as still as a parked vehicle's: zero.

        Wheels that turn so slowly may be silent (`DRIVING_SPEED`): who creeps rests by them too.
        """
        sizes = np.abs(speed)
        if self._reverse or not ok.all() or sizes.min() > ROLLING_SPEED:
            return
        end = len(speed) - 1
        for first in range(1, end, STEADY_TICKS):
            part = slice(first, first + STEADY_TICKS)
            if not ZERO_SPEED < float(sizes[part].mean()) < ROLLING_SPEED:
                continue
            if is_parked(force[part], None if rate is None else rate[part]).all():
                speed[first - (first == 1) : part.stop + (part.stop == end)] = 0.0

    def _follow_least_speed(self, sizes: Array) -> None:
        """The least that the speed showed between two other speeds; a tick may be half zero."""
        moves = sizes > ZERO_SPEED
        between = moves[1:-1] & moves[:-2] & moves[2:]
        if np.count_nonzero(between):
            self._least_speed = min(self._least_speed, float(sizes[1:-1][between].min()))

    def _held(self, known: Array) -> Array:
        """Reverse gear, the last known value held; remembers the one at the block's start."""
        out = np.empty(len(known))
        value = self._reverse
        for i, k in enumerate(known.tolist()):
            if not math.isnan(k):
                value = k
            out[i] = value
            if i == BLOCK_TICKS - 1:
                self._reverse = value
        return out

    def _yaw_rate(self, t: Array, at: Array, speed: Array) -> tuple[Array, Flags]:
        rows = self._rows
        has = rows[:, tk.STEERING.n] > 0
        angle, ok_angle = np.zeros(len(at)), np.zeros(len(at), dtype=bool)
        if np.count_nonzero(has):
            self.seen.add("steering")
            angle, ok_angle = bridged(
                at, t[has] - 0.5 * TICK_S, rows[has, tk.STEERING.mean], YAW_GAP
            )
        self._steering = angle, ok_angle
        has = rows[:, tk.YAW_RATE.n] > 0
        if np.count_nonzero(has):
            self.seen.add("yaw_rate")
            has &= ~self._stuck_yaw_rate()
            return bridged(at, t[has] - 0.5 * TICK_S, rows[has, tk.YAW_RATE.mean], YAW_GAP)
        s = self._settings
        if not s.uses_steering or not np.count_nonzero(ok_angle):
            return np.zeros(len(at)), np.zeros(len(at), dtype=bool)
        steered, vehicle = angle - self.steering_offset, s.vehicle
        turning = (vehicle.steering_ratio, vehicle.wheelbase, s.understeer)
        return yaw_rate_with_understeer(speed, steered, *turning), ok_angle

    def _stuck_yaw_rate(self) -> Flags:
        """Ticks of the rows at which the yaw rate stands still and steering or gyroscope does not.

        Where there is steering it alone is asked: a sensor that is turned by hand turns too.
        """
        rows, v = self._rows, self._settings.vehicle
        speed = np.where(rows[:, tk.SPEED.n] > 0, rows[:, tk.SPEED.mean], 0.0)
        if "steering" in self.seen:
            known = rows[:, tk.STEERING.n] > 0
            angle = np.where(known, rows[:, tk.STEERING.mean] - self.steering_offset, 0.0)
            turning = (v.steering_ratio, v.wheelbase, self._settings.understeer)
            turns = yaw_rate_with_understeer(speed, angle, *turning)
        else:
            known = (rows[:, tk.GYRO.n] > 0) & (rows[:, tk.ACCEL.n] > 0)
            force = rows[known, tk.ACCEL.x : tk.ACCEL.z + 1].sum(axis=0)
            up = force / max(math.sqrt(force @ force), 1.0)
            rate = rows[:, tk.GYRO.x : tk.GYRO.z + 1] @ up
            turns = np.where(known, rate, 0.0)
        return self.health.stuck_yaw_rate(rows, turns, known & (np.abs(speed) > DRIVING_SPEED))

    def _sided(self, t: Array, at: Array) -> dict[str, tuple[Array, Flags]]:
        """Lateral acceleration and heading at times (N,), where they come."""
        rows, found = self._rows, {}
        has = rows[:, tk.LATERAL_ACCEL.n] > 0
        if np.count_nonzero(has):
            values = rows[has, tk.LATERAL_ACCEL.mean]
            found["lateral_accel"] = bridged(at, t[has] - 0.5 * TICK_S, values, YAW_GAP)
        has = ~np.isnan(rows[:, tk.HEADING])
        if np.count_nonzero(has):
            values = np.unwrap(rows[has, tk.HEADING])
            found["heading"] = bridged(at, t[has] - 0.5 * TICK_S, values, SPEED_GAP)
        self.seen.update(found)
        return found

    def _rest(self, speed: Array, ok: Flags, force: Array, rate: Array, ok_rate: Flags) -> Flags:
        """At rest: speed zero (where there is one) and the force still."""
        rest = np.zeros(len(speed), dtype=bool)
        if np.count_nonzero(ok):
            still = ok & (np.abs(speed) < ZERO_SPEED)
        else:
            still = is_parked(force, rate if ok_rate.any() else None)
        run = self._rest_run
        if not np.count_nonzero(still):
            self._rest_run = 0
            return rest
        for i, s in enumerate(still.tolist()):
            run = run + 1 if s else 0
            rest[i] = run > REST_TICKS
        self._rest_run = run
        return rest

    def _take_offsets(self, p: SignalBlock) -> None:
        """Learn the offsets at rest and take them off."""
        offsets = self.offsets
        use = p.rest & p.ok_rate & p.learn
        if np.count_nonzero(use):
            offsets.learn_gyro(p.rate[use], p.force[use])
        use = p.rest & p.ok_yaw
        if np.count_nonzero(use) and "yaw_rate" in self.seen:
            offsets.learn_yaw_rate(p.yaw_rate[use])
        if offsets.gyro_ticks == 0.0:
            use = p.ok_rate & p.learn
            if not offsets.guess_gyro(p.rate[use], p.force[use]):
                p.ok_rate = np.zeros_like(p.ok_rate)
        p.gyro_bias = offsets.gyro_bias.copy()
        p.rate -= p.gyro_bias
        p.yaw_rate -= offsets.yaw_rate
