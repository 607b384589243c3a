"""Convert ticks to signals on an even 10 Hz grid: force, rate, speed, dv/dt and yaw rate.

The conversion is done in blocks of `BLOCK_TICKS` ticks, with a delay of `LAG` ticks. With this
delay, signals slower than the grid can be interpolated between samples on both sides. Every tick
has a flag that says whether the tick is usable.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping

import numpy as np
from msgspec import Struct, field

from imucald.core.arrays import Array, Flags
from imucald.core.samples import GRAVITY
from imucald.motion import ticks as tk
from imucald.motion.signal_health import HOLD_TICKS, SignalFault, SignalHealth, spread_out
from imucald.motion.standstill import DRIVING_SPEED
from imucald.motion.straight import yaw_rate_with_understeer
from imucald.motion.stuck import SeenForward
from imucald.motion.ticks import TICK_S, TickRow, empty_rows
from imucald.mount.block_speed import BlockSpeed
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.even_signals import (
    ACCEL_GAP,
    BEFORE,
    BLOCK_TICKS,
    KEEP,
    LAG,
    MID,
    PART,
    ROWS,
    SPEED_GAP,
    bridged,
    sampling_walk,
    times_of,
)
from imucald.mount.offsets import Offsets

__all__ = [
    "ACCEL_GAP",
    "BEFORE",
    "BLOCK_S",
    "BLOCK_TICKS",
    "KEEP",
    "LAG",
    "SPEED_GAP",
    "SignalBlock",
    "SignalBlockMaker",
]


BLOCK_S = BLOCK_TICKS * TICK_S
NO_SAMPLES = "no valid samples"
"""Cause of ticks that were not used."""
NEIGHBOUR_TICKS = 2
"""Number of ticks before and after a stuck tick that also have no value or no slope."""
YAW_GAP = 0.5
NOMINAL_SPEED = 12.0
"""Speed [m/s] that is used for v r (speed times yaw rate) if there is no speed signal.

The gain of v r is then estimated."""
DRIFT, DRIFT_NO_GYRO = 0.3, 1.0
"""Lasting error of the forward force [m/s^2]. First value: the vertical is integrated with a
gyroscope. Second value: there is no gyroscope, and roads have slopes up to 10 %.
"""
BLOCKS_WITHOUT_SPEED = 4
"""Number of blocks (26 s) without a speed after which the estimator works without speed."""


class SignalBlock(Struct):
    """One block, N = BLOCK_TICKS. If a flag is False, its value is finite but meaningless."""

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
    learn: Flags  # the tick may be used for learning
    steering: Array  # (N,) steering-wheel angle as received [rad]
    ok_steering: Flags
    had_rate: Flags  # as ok_rate, but also True while the bias was not known
    gyro_bias: Array  # (3,) bias that was subtracted from the rate [rad/s]
    sided: Mapping[str, tuple[Array, Flags]] = field(default_factory=dict)
    # Other signals that distinguish left from right: lateral_accel (N,) [m/s^2], and heading (N,)
    # [rad] as received, without jumps at north. Each has flags (N,) of the known values.
    rate_walk: Array = field(default_factory=lambda: np.zeros((3, 3)))
    # Growth of the variance of the integrated angle if samples are seldom, sensor axes [rad^2/s],
    # see `gyro_walk`.
    least_speed: float = 0.0  # the vehicle may creep this fast at a speed signal of zero [m/s]
    speed_knots: Array | None = None  # (K,) times of known speeds [ticks since the block began]
    has_speed: bool = True  # False: no speed was ever received, `nominal_speed` is used
    turn_zero_std: float = 0.0  # deviation of gyro_bias about the vertical [rad/s]
    direction: float = 1.0  # -1 while the reverse gear is engaged

    @property
    def nominal_speed(self) -> Array:
        """Assumed speed (N,) [m/s] of a vehicle without a speed signal: zero at rest, negative in
        reverse gear."""
        return np.where(self.rest, 0.0, self.direction * NOMINAL_SPEED)


class MountSoFar(Struct, frozen=True):
    """Forward and up direction (3,) in sensor axes, delay of the speed, and deviation of this delay
    [s]."""

    forward: Array
    up: Array
    late: float
    late_std: float


class SignalBlockMaker:
    """Keeps the last ticks and divides them into blocks."""

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self._rows = empty_rows(ROWS)
        self._n = KEEP
        self._begins = True
        """True if the next block includes ticks before the first tick. No data were lost in such
        ticks."""
        self.offsets = Offsets()
        self.steering_offset = 0.0
        new = slice(BEFORE, BEFORE + BLOCK_TICKS)
        self.health = SignalHealth(new, settings.calibration.full_scale, settings.vehicle.track)
        self.seen: set[str] = set()
        self._speed = BlockSpeed(self.health, self.seen)
        self.blocks = 0
        self._mount: MountSoFar | None = None
        self.left_out: Counter[tuple[str, str]] = Counter()
        """Number of ticks that were not used, by signal and cause."""
        self.stuck: Mapping[str, bool] = {}
        """True or False for each vehicle signal: whether any tick of the last block was stuck."""

    def take_mount(self, known: MountSoFar | None) -> None:
        """Use the mount at the end of the last block; None: the mount is not known well enough."""
        self._mount = known

    @property
    def without_speed(self) -> bool:
        """True if no speed signal has come for long enough to work without speed."""
        return self.blocks > BLOCKS_WITHOUT_SPEED and "speed" not in self.seen

    def push(self, tick: TickRow) -> bool:
        """Process a tick.

        Returns True when a block is complete. The caller must then call `block`.
        """
        self._rows[self._n] = tick
        self._n += 1
        return self._n == ROWS

    @property
    def until_block(self) -> int:
        """Number of ticks until a block is complete."""
        return ROWS - self._n

    def push_all(self, ticks: Array) -> None:
        """Process ticks (n, COLUMNS). n must be smaller than `until_block`."""
        self._rows[self._n : self._n + len(ticks)] = ticks
        self._n += len(ticks)

    def restart(self) -> None:
        """Forget the stored ticks, because time jumped."""
        self._rows[:] = empty_rows(1)
        self._n = KEEP
        self._begins = True
        self._speed.restart()
        self.health.restart()

    def block(self) -> SignalBlock:
        """Return the signals of the next block."""
        rows = self._rows
        self.health.drop_impossible(rows[KEEP:])
        t = times_of(float(rows[-1, tk.T]))
        at = t[PART] - 0.5 * TICK_S
        force, ok_force = self._sensed(t, at, tk.ACCEL, "accel")[:2]
        rate, ok_rate, sampled = self._sensed(t, at, tk.GYRO, "gyro")
        self.blocks += 1
        speed, ok_speed = self._speed.speed_in_block(rows, t, at, self._seen_forward)
        self._speed.silence_parked(speed, ok_speed, force, rate if ok_rate.any() else None)
        of_turns = speed, ok_speed
        if self.without_speed:
            of_turns = np.full(len(speed), NOMINAL_SPEED), np.ones(len(speed), dtype=bool)
        yaw_rate, ok_yaw = self._yaw_rate(t, at, *of_turns)
        rest = self._speed.rest(speed[MID], ok_speed[MID], force[MID], rate[MID], ok_rate[MID])
        turning = np.maximum(np.abs(yaw_rate), np.sqrt((rate * rate).sum(axis=1)) * ok_rate)
        bad = self.health.untrusted(rows[PART], force, ok_force, speed, ok_speed, turning)
        learn = ~bad[MID] & ok_force[MID]
        prepared = SignalBlock(
            t=t[PART][MID],
            force=force[MID],
            rate=rate[MID],
            speed=speed[MID],
            accel=(speed[2:] - speed[:-2]) / (2.0 * TICK_S),
            yaw_rate=yaw_rate[MID],
            ok_force=ok_force[MID],
            ok_rate=ok_rate[MID],
            ok_speed=ok_speed[MID] & ok_speed[2:] & ok_speed[:-2],
            ok_yaw=ok_yaw[MID],
            rest=rest,
            learn=learn,
            steering=self._steering[0][MID],
            ok_steering=self._steering[1][MID],
            had_rate=ok_rate[MID],
            gyro_bias=self.offsets.gyro_bias,
            sided=self._sided(t, at[MID]),
            rate_walk=sampling_walk(*sampled, ACCEL_GAP),
            least_speed=self._speed.least,
            speed_knots=self._speed_knots(float(t[PART][1])),
            direction=self._speed.direction,
        )
        if self.without_speed:
            prepared.speed = prepared.nominal_speed
            prepared.accel = np.zeros(BLOCK_TICKS)
            prepared.ok_speed = prepared.ok_force
            prepared.has_speed = False
        self._note_left_out(prepared)
        self._take_offsets(prepared)
        self.stuck = dict(self.health.stuck_now)
        rows[:KEEP] = rows[BLOCK_TICKS:].copy()
        self._n = KEEP
        self._begins = False
        return prepared

    def _speed_knots(self, first_end: float) -> Array | None:
        """Return the times at which the speed is known in a block [ticks since the block began];
        None: in each tick. first_end: end of the block's first tick [s].
        """
        if self._speed.knots is None:
            return None
        knots = (self._speed.knots - first_end) / TICK_S + 1.0
        return knots[(knots >= 0.0) & (knots < BLOCK_TICKS)]

    def _note_left_out(self, p: SignalBlock) -> None:
        """Count the ticks that are not used, by signal and cause."""
        open_ticks = ~(p.learn & p.ok_force & p.ok_speed)
        if self._begins:
            open_ticks[: KEEP - BEFORE] = False
        if not np.count_nonzero(open_ticks):
            return
        found = self.health.found
        reasons = [("accel", SignalFault.STUCK, ~p.ok_force)]
        reasons += [(signal, fault, ~p.learn) for signal, fault in found if fault in HOLD_TICKS]
        reasons += [("speed", SignalFault.STUCK, ~p.ok_speed)]
        for signal, fault, lacks in reasons:
            if (flags := found.get((signal, fault))) is None:
                continue
            ticks = np.any(flags, axis=1) if flags.ndim > 1 else flags
            own = spread_out(ticks, HOLD_TICKS.get(fault, NEIGHBOUR_TICKS))
            first = (len(own) - BLOCK_TICKS) // 2 if len(own) < ROWS else BEFORE
            self._leave_out(signal, fault.value, open_ticks, lacks & own[first:][:BLOCK_TICKS])
        self._leave_out("accel", NO_SAMPLES, open_ticks, ~p.ok_force)
        if "speed" in self.seen:
            self._leave_out("speed", NO_SAMPLES, open_ticks, ~p.ok_speed)

    def _leave_out(self, signal: str, cause: str, open_ticks: Flags, flags: Flags) -> None:
        """Count the ticks that are both open and flagged, and remove them from the open ticks
        (N,)."""
        own = open_ticks & flags
        if count := int(np.count_nonzero(own)):
            self.left_out[signal, cause] += count
            open_ticks &= ~own

    def _sensed(
        self, t: Array, at: Array, columns: tk.AccelColumns | tk.GyroColumns, name: str
    ) -> tuple[Array, Flags, tuple[Array, Array, Array]]:
        """Return the samples of a sensor at times `at` (N + 2, 3), and flags of the known values.

        Also return times (M,) [s], means (M, 3) and numbers of samples (M,) of the ticks that have
        samples.
        """
        rows = self._rows
        has = (rows[:, columns.n] > 0) & ~self.health.stuck(name, rows)
        known = rows[has]
        times, values = t[has] - known[:, columns.age], known[:, columns.x : columns.z + 1]
        return *bridged(at, times, values, ACCEL_GAP), (times, values, known[:, columns.n])

    def _mean(
        self, t: Array, at: Array, column: tk.SignalColumns, has: Flags
    ) -> tuple[Array, Flags]:
        """Return a signal of the vehicle at times `at`, and flags of the known values. has: ticks
        that have samples."""
        return bridged(at, t[has] - 0.5 * TICK_S, self._rows[has, column.mean], YAW_GAP)

    def _seen_forward(self) -> SeenForward | None:
        """Return the speed changes that the accelerometer shows, for all ticks; None if the mount
        is not known."""
        known = self._mount
        if known is None:
            return None
        rows = self._rows
        turns = rows[:, tk.GYRO.n] > 0
        rate = np.where(turns[:, None], rows[:, tk.GYRO.x : tk.GYRO.z + 1], 0.0)
        rate -= turns[:, None] * self.offsets.gyro_bias
        # du/dt = u x rate, in small rotations from the block's beginning.
        turned = np.cumsum(rate, axis=0) * TICK_S
        turned -= turned[BEFORE - 1]
        tilted = GRAVITY * (known.up + np.cross(known.up, turned))
        has = (rows[:, tk.ACCEL.n] > 0)[:, None]
        force = np.where(has, rows[:, tk.ACCEL.x : tk.ACCEL.z + 1] - tilted, 0.0)
        drift = DRIFT if np.count_nonzero(turns) > 0.5 * len(rows) else DRIFT_NO_GYRO
        ahead, hidden = force @ known.forward, self._speed.least
        return SeenForward(ahead, known.late, known.late_std, drift, hidden)

    def _yaw_rate(self, t: Array, at: Array, speed: Array, ok_speed: Flags) -> tuple[Array, Flags]:
        rows = self._rows
        has = rows[:, tk.STEERING.n] > 0
        if np.count_nonzero(has):
            self.seen.add("steering")
        self._steering = angle, ok_angle = self._mean(t, at, tk.STEERING, has)
        has = rows[:, tk.YAW_RATE.n] > 0
        if np.count_nonzero(has):
            self.seen.add("yaw_rate")
            return self._mean(t, at, tk.YAW_RATE, has & ~self._stuck_yaw_rate())
        s = self._settings
        if not s.uses_steering or not np.count_nonzero(ok_angle):
            return np.zeros(len(at)), np.zeros(len(at), dtype=bool)
        steered, vehicle = angle - self.steering_offset, s.vehicle
        turning = (vehicle.steering_ratio, vehicle.wheelbase, s.understeer)
        return yaw_rate_with_understeer(speed, steered, *turning), ok_angle & ok_speed

    def _stuck_yaw_rate(self) -> Flags:
        """Return the ticks at which the yaw rate stays constant while the steering angle or the
        gyroscope changes.

        If there is a steering angle, the gyroscope is not used, because a sensor that is turned by
        hand also turns the gyroscope.
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
        """Return lateral acceleration and heading at times (N,), if the vehicle sends them."""
        rows, found = self._rows, {}
        if np.count_nonzero(has := rows[:, tk.LATERAL_ACCEL.n] > 0):
            found["lateral_accel"] = self._mean(t, at, tk.LATERAL_ACCEL, has)
        if np.count_nonzero(has := ~np.isnan(rows[:, tk.HEADING])):
            values = np.unwrap(rows[has, tk.HEADING])
            found["heading"] = bridged(at, t[has] - 0.5 * TICK_S, values, SPEED_GAP)
        self.seen.update(found)
        return found

    def _take_offsets(self, p: SignalBlock) -> None:
        """Estimate the offsets at rest and subtract them."""
        offsets = self.offsets
        use = p.rest & p.ok_rate & p.learn
        if np.count_nonzero(use):
            offsets.learn_gyro(p.rate[use], p.force[use])
        use = p.rest & p.ok_yaw
        if np.count_nonzero(use) and "yaw_rate" in self.seen:
            offsets.learn_yaw_rate(p.yaw_rate[use])
        p.yaw_rate -= offsets.yaw_rate
        if offsets.gyro_ticks == 0.0:
            use = p.ok_rate & p.learn
            turn = np.where(p.ok_yaw, p.yaw_rate, 0.0)
            if not offsets.guess_gyro(p.rate[use], p.force[use], turn[use]):
                p.ok_rate = np.zeros_like(p.ok_rate)
        p.gyro_bias, p.turn_zero_std = offsets.gyro_bias.copy(), offsets.turn_zero_std
        p.rate -= p.gyro_bias
