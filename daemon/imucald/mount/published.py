"""Method A online: a `MountEstimator` that runs the published solver on ticks.

Static test -> tilt -> straight variable-speed motion -> target angle -> correction, as published,
with what stands on top of it since the first day: the gate on v r, v r subtracted, dv/dt from
speed for sign and weight, several stops combined, and the wandering offset removed.
Bad samples are never learnt from: a block that holds one is dropped whole.
"""

from __future__ import annotations

import math
from collections import deque
from math import isnan

import numpy as np

from imucald.frames import Matrix3, levelling_rotation, rotation_from_angles
from imucald.motion.speed import Block, BlockMaker
from imucald.motion.standstill import StandstillDetector
from imucald.motion.straight import YawRateSource
from imucald.motion.ticks import (
    ACCEL_BAD,
    ACCEL_MAX_X,
    ACCEL_MAX_Y,
    ACCEL_MAX_Z,
    ACCEL_MIN_X,
    ACCEL_MIN_Y,
    ACCEL_MIN_Z,
    ACCEL_N,
    ACCEL_X,
    ACCEL_Y,
    ACCEL_Z,
    BRAKE,
    LATERAL,
    LATERAL_N,
    REVERSE,
    SPEED,
    SPEED_AGE,
    SPEED_BAD,
    SPEED_N,
    TICK_S,
    T,
    TickRow,
)
from imucald.mount.estimate import Correction, MountEstimate, MountState
from imucald.mount.levelling import LongRunLevel, StopBook, Tilt
from imucald.mount.published_events import Angle, Manoeuvre, combined, combined_axis
from imucald.mount.published_gate import StraightGate, WanderingOffset
from imucald.mount.published_settings import PublishedSettings
from imucald.mount.published_sign import SignEvidence
from imucald.mount.published_states import Knowledge, judged, waiting_for
from imucald.mount.published_yaw import rotation_about_up
from imucald.mount.slewing import SlewedRotation
from imucald.samples import GRAVITY

NAN = math.nan
Vector = tuple[float, float, float]

MANOEUVRES_KEPT = 150
"""Manoeuvres that are kept (about an hour of city); the oldest goes first."""
MANOEUVRE_SECONDS = 8.0
"""A longer one counts as several [s]."""
SHORTEST_MANOEUVRE = 1.0
"""A shorter one is a bump [s]."""
MANOEUVRE_HOLE = 1.5
"""Time without an accepted block that ends a manoeuvre [s]."""
LONGEST_HOLE_TICKS = 5
"""Ticks for which the last specific force stands in: a 10 Hz sensor jitters."""
STUCK_TICKS = 10
"""Ticks without any change of the force, while driving, after which the sensor is stuck."""
PLAUSIBLE_FORCE = (0.3 * GRAVITY, 3.0 * GRAVITY)
"""Size of a tick's mean specific force on a vehicle that drives [m/s^2]."""
NEAR_FULL_SCALE = 0.98
UP_MEMORY_S = 20.0
"""Time constant of the vertical before the first levelling [s]."""
UP_SETTLED_TICKS = 50.0
UNKNOWN_SIGN_STD = math.pi / 2.0
"""Standard deviation of a yaw that may be off by 180 deg [rad]."""


class PublishedEstimator:
    """The published solver as an estimator of the mount; see `mount.estimate.MountEstimator`."""

    def __init__(self, settings: PublishedSettings | None = None) -> None:
        s = self._settings = settings or PublishedSettings()
        self._stops = StopBook(s.slope_std, s.accel_bias_std, s.average_stops)
        self._long_run = LongRunLevel(s.slope_std, s.accel_bias_std)
        self._standstill = StandstillDetector(s.static)
        self._blocks = BlockMaker(s.block_s, s.speed_delay, s.speed_timeout)
        self._yaw_source = YawRateSource(s.steering_ratio, s.wheelbase, "steering" in s.recognisers)
        self._offset = WanderingOffset(s.remove_offset_after)
        self._gate = StraightGate(s, self._offset)
        self._sign = SignEvidence(s.sign_sources)
        self._signed: deque[Manoeuvre] = deque(maxlen=MANOEUVRES_KEPT)
        self._unsigned: deque[Manoeuvre] = deque(maxlen=MANOEUVRES_KEPT)
        self._applied = SlewedRotation(s.slew)
        self._known = Knowledge()
        self._level: Matrix3 = np.eye(3)
        self._target: Matrix3 | None = None
        self._state = MountState.WAITING
        self._reverse_known = False
        self._moved = self._moved_s = math.inf
        self._up_sum = [0.0, 0.0, 0.0, 0.0]
        self._restart_stream()
        if s.planar:
            self._set_tilt(Tilt((0.0, 0.0, 1.0), s.planar_tilt_std, 0))

    # The verbs.

    @property
    def correction(self) -> Correction | None:
        """R_vehicle_from_sensor to apply now, row by row; None until usable."""
        return self._applied.correction

    @property
    def state(self) -> MountState:
        """The present state."""
        return self._state

    def gap(self) -> None:
        """Time jumped: open windows, blocks and manoeuvres are dropped, knowledge stays."""
        self._restart_stream()

    def _restart_stream(self) -> None:
        self._standstill.restart()
        self._blocks.restart()
        self._yaw_source.restart()
        self._offset.restart()
        self._gate.restart()
        self._sign.restart()
        self._open: Manoeuvre | None = None
        self._force: Vector | None = None
        self._holes = self._stuck = 0
        self._speed, self._speed_t = NAN, -math.inf
        self._reverse = False
        self._brake = self._lateral = NAN
        self._was_still = False
        self._straight_s = 0.0

    def step(self, tick: TickRow) -> None:
        """Take one tick."""
        self._take_vehicle(tick)
        clean = self._take_force(tick)
        force = self._force
        if force is not None:
            still = self._take_standstill(tick)
            up = self._up(force, clean, still)
            yaw_rate = self._yaw_source.step(tick, up, self._speed, still)
            x, y, z = force
            block = self._blocks.step(tick[T], x, y, z, yaw_rate, clean)
            if block is not None:
                self._take_block(block, up, still)
        self._applied.step()

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge."""
        known, s = self._known, self._settings
        reasons = waiting_for(known, s)
        covariance = None
        if self._target is not None and known.tilt is not None and known.angle is not None:
            yaw_std = known.angle.std if known.sign_known else UNKNOWN_SIGN_STD
            tilt_variance = known.tilt.std**2
            covariance = np.diag([tilt_variance + s.crown_std**2, tilt_variance, yaw_std**2])
        return MountEstimate(
            state=self._state,
            R_vehicle_from_sensor=self._target,
            covariance=covariance,
            waiting_for={name: text for name, (text, _) in reasons.items()},
            missing={name: code for name, (_, code) in reasons.items()},
            details={
                "method": "published",
                "stops": self._stops.seen,
                "manoeuvres": len(self._signed),
                "manoeuvres_without_speed": len(self._unsigned),
                "sign_votes": dict(self._sign.votes.counts),
                "yaw_rate_source": self._yaw_source.source,
            },
        )

    # What a tick brings.

    def _take_vehicle(self, tick: TickRow) -> None:
        if not isnan(tick[REVERSE]):
            self._reverse = tick[REVERSE] > 0.5
            self._reverse_known = True
        if not isnan(tick[BRAKE]):
            self._brake = tick[BRAKE]
        if tick[LATERAL_N] > 0.0:
            self._lateral = tick[LATERAL]
        t = tick[T]
        if tick[SPEED_N] > 0.0 and tick[SPEED_BAD] == 0.0 and self._settings.use_speed:
            self._speed = -tick[SPEED] if self._reverse else tick[SPEED]
            self._speed_t = t
            self._blocks.add_speed(t - tick[SPEED_AGE], self._speed)
        elif t - self._speed_t > self._settings.speed_timeout:
            self._speed = NAN

    def _take_force(self, tick: TickRow) -> bool:
        """Keep the tick's specific force; return whether it can be learnt from."""
        if tick[ACCEL_BAD] > 0.0:
            return False
        if tick[ACCEL_N] == 0.0:
            self._holes += 1
            if self._holes > LONGEST_HOLE_TICKS:
                self._force = None
                self._blocks.restart()
            return False if self._holes > LONGEST_HOLE_TICKS else self._force is not None
        self._holes = 0
        z = GRAVITY if self._settings.planar else tick[ACCEL_Z]
        force = (tick[ACCEL_X], tick[ACCEL_Y], z)
        size = math.sqrt(force[0] * force[0] + force[1] * force[1] + z * z)
        if not PLAUSIBLE_FORCE[0] <= size <= PLAUSIBLE_FORCE[1] or self._saturated(tick):
            return False
        same = force == self._force and tick[ACCEL_MIN_X] == tick[ACCEL_MAX_X]
        self._stuck = self._stuck + 1 if same else 0
        self._force = force
        self._gate.push(force)
        return self._stuck < STUCK_TICKS or not abs(self._speed) > self._settings.standstill_speed

    def _saturated(self, tick: TickRow) -> bool:
        limit = NEAR_FULL_SCALE * self._settings.accel_range
        if limit == math.inf:
            return False
        highest = max(tick[ACCEL_MAX_X], tick[ACCEL_MAX_Y], tick[ACCEL_MAX_Z])
        lowest = min(tick[ACCEL_MIN_X], tick[ACCEL_MIN_Y], tick[ACCEL_MIN_Z])
        return highest >= limit or lowest <= -limit

    def _take_standstill(self, tick: TickRow) -> bool:
        s, speed = self._settings, self._speed
        stopped = None if isnan(speed) else abs(speed) <= s.standstill_speed
        window = self._standstill.step(tick, stopped)
        if window is not None and not s.planar:
            far = self._moved > s.place_distance
            far = far or (stopped is None and self._moved_s > s.place_seconds)
            self._stops.add((window.x, window.y, window.z), window.samples, far)
            self._moved = self._moved_s = 0.0
            tilt = self._stops.tilt()
            if tilt is not None:
                self._set_tilt(tilt)
        still = self._standstill.still
        if not still:
            self._moved_s += TICK_S
            self._moved += 0.0 if stopped is None else abs(speed) * TICK_S
            if self._was_still:
                self._sign.depart(tick[T])
        self._was_still = still
        return still

    def _up(self, force: Vector, clean: bool, still: bool) -> Vector | None:
        """Return the vertical in sensor axes; before levelling, from a slow mean."""
        tilt = self._known.tilt
        if tilt is not None and (self._stops.seen or self._settings.planar):
            return tilt.up
        s = self._up_sum
        if clean:
            keep = 1.0 - TICK_S / UP_MEMORY_S
            x, y, z = force
            self._up_sum = s = [s[0] * keep + x, s[1] * keep + y, s[2] * keep + z, s[3] + 1.0]
            if not still:
                self._level_without_stop(x, y, z)
        if s[3] < UP_SETTLED_TICKS:
            return None
        norm = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        return (s[0] / norm, s[1] / norm, s[2] / norm)

    def _level_without_stop(self, x: float, y: float, z: float) -> None:
        """Fall back on the mean force of the drive, once a second, when it is long enough."""
        run = self._long_run
        before = int(run.seconds)
        run.add(x, y, z, TICK_S)
        if run.seconds >= self._settings.level_without_stop_after and int(run.seconds) > before:
            tilt = run.tilt()
            if tilt is not None:
                self._set_tilt(tilt)

    # What a block brings.

    def _take_block(self, block: Block, up: Vector | None, still: bool) -> None:
        s, dt = self._settings, block.t1 - block.t0
        mx, my, mz, m_dvdt, m_lateral = self._offset.mean()
        ready = self._offset.ready
        f = (block.fx - mx, block.fy - my, block.fz - mz)
        if block.clean and ready:
            self._sign.take_turn(block, f, up, self._reverse)
        steering = self._yaw_source.steering
        straight = block.clean and self._gate.is_straight(
            block, steering, self._lateral, self._present_level()
        )
        if not straight:
            self._offset.fade(dt)
            if self._gate.is_turning(block):
                self._straight_s = 0.0
            self._close()
            return
        known = not isnan(block.dvdt)
        dvdt = block.dvdt if known else 0.0
        lateral = block.speed * block.yaw_rate if s.subtract_lateral else 0.0
        lateral = 0.0 if isnan(lateral) else lateral
        self._offset.add(block.fx, block.fy, block.fz, dvdt, lateral, dt)
        self._straight_s += dt
        if not ready or still or self._straight_s < s.settle:
            self._close()
            return
        self._sign.take_straight(block, f, up, self._reverse, self._brake > 0.5)
        if known and "speed" in s.sign_sources:
            self._collect(block, f, dvdt - m_dvdt, lateral - m_lateral)
        else:
            self._collect_without_sign(block, f)

    def _collect(self, block: Block, f: Vector, along: float, lateral: float) -> None:
        s, m = self._settings, self._open
        slowest = s.min_speed if self._reverse_known else s.min_speed_unknown_gear
        if abs(block.speed) < slowest or max(abs(along), abs(block.dvdt)) < s.min_speed_change:
            return
        if m is not None and m.peak * block.dvdt < 0.0 and abs(block.dvdt) >= s.min_speed_change:
            self._close()  # from braking to accelerating: another manoeuvre
        m = self._manoeuvre(block, signed=True)
        m.add(block.t1, block.t1 - block.t0, f, along, lateral)
        if abs(block.dvdt) > abs(m.peak):
            m.peak = block.dvdt

    def _collect_without_sign(self, block: Block, f: Vector) -> None:
        x, y, _ = (self._present_level() @ np.array(f)).tolist()
        size = math.hypot(x, y)
        if size >= self._settings.min_speed_change:
            m = self._manoeuvre(block, signed=False)
            m.add(block.t1, block.t1 - block.t0, f, 0.0, 0.0)
            m.peak = max(m.peak, size)

    def _manoeuvre(self, block: Block, signed: bool) -> Manoeuvre:
        """Return the open manoeuvre if the block belongs to it, else a new one."""
        m = self._open
        if m is not None and (
            m.signed != signed
            or m.seconds >= MANOEUVRE_SECONDS
            or block.t0 - m.stop > MANOEUVRE_HOLE
        ):
            self._close()
        if self._open is None:
            self._open = Manoeuvre(block.t0, signed)
        return self._open

    def _close(self) -> None:
        """End the open manoeuvre; if it was one, count it and solve again."""
        m, self._open = self._open, None
        if m is None or abs(m.peak) < self._settings.manoeuvre_peak:
            return
        if m.seconds >= SHORTEST_MANOEUVRE:
            (self._signed if m.signed else self._unsigned).append(m)
            self._solve()

    # The solution.

    def _present_level(self) -> Matrix3:
        if self._known.tilt is None and self._up_sum[3] > 0.0:
            return levelling_rotation(self._up_sum[:3])
        return self._level

    def _set_tilt(self, tilt: Tilt) -> None:
        self._level = levelling_rotation(tilt.up)
        self._solve(tilt)

    def _solve(self, tilt: Tilt | None = None) -> None:
        """Combine all manoeuvres under the present tilt into the target angle; set the state."""
        tilt = tilt or self._known.tilt
        angle, sign_known = None, False
        if tilt is not None:
            angle, sign_known = self._target_angle()
        if angle is not None:
            lean = rotation_from_angles(-self._settings.crown, 0.0, 0.0)
            self._target = lean @ rotation_about_up(angle.value) @ self._level
        self._known = Knowledge(
            tilt=tilt,
            angle=angle,
            sign_known=sign_known,
            stops=self._stops.seen,
            manoeuvres=max(len(self._signed), len(self._unsigned)),
        )
        self._state = judged(self._known, self._state, self._settings)
        if self._state >= MountState.USABLE and self._target is not None:
            self._applied.aim(self._target)

    def _target_angle(self) -> tuple[Angle | None, bool]:
        """Return lambda and whether its sign is known; manoeuvres with speed are preferred."""
        signed = combined([m.pointer(self._level) for m in self._signed])
        if not self._unsigned or len(self._signed) >= self._settings.usable_manoeuvres:
            return signed, signed is not None
        axis = combined_axis(
            [m.axis_pointer(self._level) for m in (*self._unsigned, *self._signed)]
        )
        if axis is None:
            return None, False
        forward = math.cos(axis.value) * self._level[0] - math.sin(axis.value) * self._level[1]
        x, y, z = forward.tolist()
        sign = self._sign.votes.sign((x, y, z))
        if sign < 0.0:
            axis = axis._replace(value=axis.value + math.pi)
        return axis, sign != 0.0
