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

from imucald.frames import Matrix3, levelling_rotation, rotation_from_vector, vector_from_rotation
from imucald.motion.speed import Block, BlockMaker
from imucald.motion.standstill import StandstillDetector
from imucald.motion.straight import YawRateSource, angles_agree
from imucald.motion.ticks import (
    ACCEL_BAD,
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
from imucald.mount.estimate import Correction, Missing, MountEstimate, MountState
from imucald.mount.levelling import LongRunLevel, StopBook, Tilt
from imucald.mount.published_events import Angle, Manoeuvre, combined, combined_axis
from imucald.mount.published_settings import PublishedSettings
from imucald.mount.published_sign import SignVotes
from imucald.mount.published_yaw import rotation_about_up
from imucald.samples import GRAVITY

NAN = math.nan
Vector = tuple[float, float, float]

MANOEUVRES_KEPT = 150
"""Manoeuvres that are kept (about an hour of city); the oldest goes first."""
MANOEUVRE_SECONDS = 8.0
"""A longer one counts as several [s]."""
MANOEUVRE_HOLE = 1.5
"""Time without an accepted block that ends a manoeuvre [s]."""
LONGEST_HOLE_TICKS = 5
"""Ticks for which the last specific force stands in: a 10 Hz sensor jitters."""
PLAUSIBLE_FORCE = (0.3 * GRAVITY, 3.0 * GRAVITY)
"""Size of a tick's mean specific force [m/s^2] on a vehicle that drives."""
UP_MEMORY_S = 20.0
"""Time constant of the vertical before the first levelling [s]."""
OFFSET_SETTLED_S = 2.0
"""Straight motion that the removed offset needs before it is good [s]."""
OFFSET_FADE_S = 15.0
"""Time constant at which the offset's weight fades while not straight [s]."""
DEPARTURE_S = 2.0
"""Time after standstill that counts as first motion [s]."""
DEPARTURE_FORCE = 0.7
"""Mean horizontal force of a first motion that counts [m/s^2]."""
BRAKE_FORCE = 0.6
"""The same for braking that counts."""
TURN_RATE = math.radians(6.0)
"""Yaw rate of a turn that tells left from right [rad/s]."""
TURN_FORCE = 0.8
"""Horizontal force of such a turn [m/s^2]."""
TURN_SECONDS = 1.5


class _Offset:
    """Mean of force and of (dv/dt, v r) over straight motion, fading; the same filter for both."""

    def __init__(self, tau: float) -> None:
        self._tau = tau
        self.restart()

    def restart(self) -> None:
        self._sums = [0.0] * 5
        self._weight = 0.0

    @property
    def ready(self) -> bool:
        return self._tau <= 0.0 or self._weight >= OFFSET_SETTLED_S

    def mean(self) -> list[float]:
        if self._tau <= 0.0 or self._weight <= 0.0:
            return [0.0] * 5
        return [s / self._weight for s in self._sums]

    def add(self, values: tuple[float, float, float, float, float], dt: float) -> None:
        if self._tau > 0.0:
            keep = math.exp(-dt / self._tau)
            self._sums = [s * keep + v * dt for s, v in zip(self._sums, values, strict=True)]
            self._weight = self._weight * keep + dt

    def fade(self, dt: float) -> None:
        keep = math.exp(-dt / OFFSET_FADE_S)
        self._sums = [s * keep for s in self._sums]
        self._weight *= keep


class PublishedEstimator:
    """The published solver as an estimator of the mount; see `mount.estimate.MountEstimator`."""

    def __init__(self, settings: PublishedSettings | None = None) -> None:
        s = self._settings = settings or PublishedSettings()
        self._stops = StopBook(s.slope_std, s.accel_bias_std, s.average_stops)
        self._long_run = LongRunLevel(s.slope_std, s.accel_bias_std)
        self._standstill = StandstillDetector(s.static)
        self._blocks = BlockMaker(s.block_s, s.speed_delay, s.speed_timeout)
        self._yaw_source = YawRateSource(
            s.steering_ratio, s.wheelbase, use_steering="steering" in s.recognisers
        )
        self._offset = _Offset(s.remove_offset_after)
        self._votes = SignVotes()
        self._signed: deque[Manoeuvre] = deque(maxlen=MANOEUVRES_KEPT)
        self._unsigned: deque[Manoeuvre] = deque(maxlen=MANOEUVRES_KEPT)
        self._tilt: Tilt | None = None
        self._level: Matrix3 = np.eye(3)
        self._angle: Angle | None = None
        self._sign = 0.0
        self._state = MountState.WAITING
        self._target: Matrix3 | None = None
        self._applied: Matrix3 | None = None
        self._correction: Correction | None = None
        self._slewing = False
        self._reverse_known = False
        self._speed_ever = False
        self._moved = math.inf
        self._moved_s = math.inf
        self._up_sum = [0.0, 0.0, 0.0, 0.0]
        self._restart_stream()
        if s.planar:
            self._set_tilt(Tilt((0.0, 0.0, 1.0), s.planar_tilt_std, 0))

    # The verbs.

    @property
    def correction(self) -> Correction | None:
        """R_vehicle_from_sensor to apply now, row by row; None until usable."""
        return self._correction

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
        self._open: Manoeuvre | None = None
        self._force: Vector | None = None
        self._holes = 0
        self._speed = NAN
        self._speed_t = -math.inf
        self._reverse = False
        self._brake = NAN
        self._lateral = NAN
        self._was_still = False
        self._departed = -math.inf
        self._departure = [0.0, 0.0, 0.0, 0.0]
        self._turn = [0.0, 0.0, 0.0, 0.0]
        self._brake_force = [0.0, 0.0, 0.0, 0.0]
        self._recent: deque[Vector] = deque(
            maxlen=self._settings.consistency_window + self._settings.consistency_smoothing
        )

    def step(self, tick: TickRow) -> None:
        """Take one tick."""
        t = tick[T]
        self._take_vehicle(tick, t)
        clean = self._take_force(tick)
        if self._force is None:
            return
        still = self._take_standstill(tick)
        speed = self._speed
        up = self._up(clean, still)
        yaw_rate = self._yaw_source.step(tick, up, speed, still)
        if not still:
            self._moved_s += TICK_S
            if not isnan(speed):
                self._moved += abs(speed) * TICK_S
        x, y, z = self._force
        block = self._blocks.step(t, x, y, z, yaw_rate, clean)
        if block is not None:
            self._take_block(block, still)
        if self._slewing:
            self._slew()

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge."""
        tilt, angle = self._tilt, self._angle
        details: dict[str, object] = {
            "method": "published",
            "stops": self._stops.seen,
            "manoeuvres": len(self._signed),
            "manoeuvres_without_speed": len(self._unsigned),
            "sign_votes": dict(self._votes.counts),
            "yaw_rate_source": self._yaw_source.source,
        }
        reasons = self._waiting_for()
        waiting = {name: text for name, (text, _) in reasons.items()}
        missing = {name: code for name, (_, code) in reasons.items()}
        if tilt is None or angle is None or self._target is None:
            return MountEstimate(self._state, waiting_for=waiting, missing=missing, details=details)
        roll_variance = tilt.std**2 + self._settings.crown_std**2
        covariance = np.diag([roll_variance, tilt.std**2, angle.std**2])
        return MountEstimate(self._state, self._target, covariance, waiting, missing, details)

    # What a tick brings.

    def _take_vehicle(self, tick: TickRow, t: float) -> None:
        if not isnan(tick[REVERSE]):
            self._reverse = tick[REVERSE] > 0.5
            self._reverse_known = True
        if not isnan(tick[BRAKE]):
            self._brake = tick[BRAKE]
        if tick[LATERAL_N] > 0.0:
            self._lateral = tick[LATERAL]
        if tick[SPEED_N] > 0.0 and tick[SPEED_BAD] == 0.0 and self._settings.use_speed:
            self._speed = -tick[SPEED] if self._reverse else tick[SPEED]
            self._speed_t = t
            self._speed_ever = True
            self._blocks.add_speed(t - tick[SPEED_AGE], self._speed)
        elif t - self._speed_t > self._settings.speed_timeout:
            self._speed = NAN

    def _take_force(self, tick: TickRow) -> bool:
        """Keep the tick's specific force; return whether it can be learnt from."""
        if tick[ACCEL_BAD] > 0.0:
            return False
        if tick[ACCEL_N] == 0.0:
            self._holes += 1
            if self._holes == LONGEST_HOLE_TICKS + 1:
                self._blocks.restart()
                self._force = None
            return self._holes <= LONGEST_HOLE_TICKS
        self._holes = 0
        z = GRAVITY if self._settings.planar else tick[ACCEL_Z]
        force = (tick[ACCEL_X], tick[ACCEL_Y], z)
        size = math.sqrt(force[0] * force[0] + force[1] * force[1] + z * z)
        if not PLAUSIBLE_FORCE[0] <= size <= PLAUSIBLE_FORCE[1]:
            return False
        self._force = force
        self._recent.append(force)
        return True

    def _take_standstill(self, tick: TickRow) -> bool:
        speed = self._speed
        stopped: bool | None = None
        if not isnan(speed):
            stopped = abs(speed) <= self._settings.standstill_speed
        window = self._standstill.step(tick, stopped)
        if window is not None and not self._settings.planar:
            far = self._moved > self._settings.place_distance
            if not self._speed_ever or isnan(speed):
                far = far or self._moved_s > self._settings.place_seconds
            self._stops.add((window.x, window.y, window.z), window.samples, far)
            self._moved = self._moved_s = 0.0
            tilt = self._stops.tilt()
            if tilt is not None:
                self._set_tilt(tilt)
        still = self._standstill.still
        if self._was_still and not still:
            self._departed = tick[T]
            self._departure = [0.0, 0.0, 0.0, 0.0]
        self._was_still = still
        return still

    def _up(self, clean: bool, still: bool) -> Vector | None:
        """Return the vertical in sensor axes; before levelling, from a slow mean."""
        if self._stops.seen or self._settings.planar:
            return self._tilt.up if self._tilt is not None else None
        assert self._force is not None
        s = self._up_sum
        if clean:
            keep = 1.0 - TICK_S / UP_MEMORY_S
            x, y, z = self._force
            s[0] = s[0] * keep + x
            s[1] = s[1] * keep + y
            s[2] = s[2] * keep + z
            s[3] += 1.0
            if not still:
                self._level_without_stop(x, y, z)
        if s[3] < 50.0:
            return None
        norm = math.sqrt(s[0] * s[0] + s[1] * s[1] + s[2] * s[2])
        return (s[0] / norm, s[1] / norm, s[2] / norm)

    def _level_without_stop(self, x: float, y: float, z: float) -> None:
        run = self._long_run
        run.add(x, y, z, TICK_S)
        if run.seconds >= self._settings.level_without_stop_after and int(s := run.seconds) > int(
            s - TICK_S
        ):
            tilt = run.tilt()
            if tilt is not None:
                self._set_tilt(tilt)

    # What a block brings.

    def _take_block(self, block: Block, still: bool) -> None:
        dt = block.t1 - block.t0
        if not block.clean:
            self._close()
            self._offset.fade(dt)
            return
        lateral = block.speed * block.yaw_rate
        self._vote_turn(block, dt)
        if not self._is_straight(block, lateral):
            self._offset.fade(dt)
            self._close()
            return
        known = not isnan(block.dvdt)
        dvdt = block.dvdt if known else 0.0
        if not self._settings.subtract_lateral or isnan(lateral):
            lateral = 0.0
        offset = self._offset.mean()
        ready = self._offset.ready
        self._offset.add((block.fx, block.fy, block.fz, dvdt, lateral), dt)
        f = (block.fx - offset[0], block.fy - offset[1], block.fz - offset[2])
        if not ready or still:
            self._close()
            return
        self._vote_straight(block, f, dt)
        if known:
            along = dvdt - offset[3]
            least = self._settings.min_speed_change
            if not self._fast_enough(block.speed) or max(abs(along), abs(dvdt)) < least:
                self._close_after_hole(block.t0)
                return
            self._collect(block, dt, f, along, lateral - offset[4], dvdt)
        else:
            self._collect_without_speed(block, dt, f)

    def _is_straight(self, block: Block, lateral: float) -> bool:
        s = self._settings
        if s.lateral_limit > 0.0:
            if not isnan(lateral):
                if abs(lateral) > s.lateral_limit:
                    return False
            elif abs(self._lateral) > s.lateral_limit:  # the vehicle's own; False where NaN
                return False
            elif self._unexplained(block) > s.lateral_limit:
                return False
        for recogniser in s.recognisers:
            if recogniser == "yaw_rate" and not isnan(block.yaw_rate):
                gated = s.lateral_limit > 0.0 and not isnan(lateral)
                limit = s.yaw_rate_limit if gated else s.yaw_rate_limit_without_speed
                return abs(block.yaw_rate) <= limit
            if recogniser == "steering" and not isnan(self._yaw_source.steering):
                return abs(self._yaw_source.steering) <= s.steering_limit
            if recogniser == "consistency":
                return self._angles_agree()
        return False

    def _unexplained(self, block: Block) -> float:
        """Horizontal force beyond what dv/dt explains [m/s^2]: v r where no yaw rate is known."""
        if isnan(block.dvdt) or not self._offset.ready:
            return 0.0
        mean = self._offset.mean()
        level = self._current_level()
        f = np.array((block.fx - mean[0], block.fy - mean[1], block.fz - mean[2]))
        x, y = float(level[0] @ f), float(level[1] @ f)
        along = block.dvdt - mean[3]
        return math.sqrt(max(x * x + y * y - along * along, 0.0))

    def _angles_agree(self) -> bool:
        """Recogniser 3 on the smoothed angles of the last window; offset is taken off first.

        Motion that does not vary has no angle; it counts as straight, for the offset's sake, and
        gives no target angle.
        """
        n = self._settings.consistency_smoothing
        recent = self._recent
        if len(recent) < recent.maxlen if recent.maxlen else True:
            return False
        forces = np.array(recent)
        mean = self._offset.mean()
        if self._offset.ready and self._settings.remove_offset_after > 0.0:
            forces = forces - np.array(mean[:3])
        sums = np.cumsum(forces, axis=0)
        smooth = (sums[n:] - sums[:-n]) / n
        level = smooth @ self._current_level().T
        sizes = np.hypot(level[:, 0], level[:, 1])
        if not self._offset.ready or float(sizes.max()) < self._settings.min_speed_change:
            return True
        strong = sizes >= 0.5 * self._settings.min_speed_change
        angles = np.arctan2(level[strong, 1], level[strong, 0])
        return angles_agree(angles, self._settings.consistency_spread)

    def _fast_enough(self, speed: float) -> bool:
        s = self._settings
        return abs(speed) >= (s.min_speed if self._reverse_known else s.min_speed_unknown_gear)

    def _collect(
        self, block: Block, dt: float, f: Vector, along: float, lateral: float, dvdt: float
    ) -> None:
        m = self._open
        if m is not None and (
            not m.signed
            or (m.peak * dvdt < 0.0 and abs(dvdt) >= self._settings.min_speed_change)
            or block.t0 - m.stop > MANOEUVRE_HOLE
            or m.seconds >= MANOEUVRE_SECONDS
        ):
            self._close()
            m = None
        if m is None:
            m = self._open = Manoeuvre(block.t0, signed=True)
        m.add(block.t1, dt, f, along, lateral)
        if abs(dvdt) > abs(m.peak):
            m.peak = dvdt

    def _collect_without_speed(self, block: Block, dt: float, f: Vector) -> None:
        level = self._current_level()
        h = math.hypot(*(float(level[i] @ f) for i in (0, 1)))
        if h < self._settings.min_speed_change:
            self._close_after_hole(block.t0)
            return
        m = self._open
        if m is not None and (m.signed or m.seconds >= MANOEUVRE_SECONDS):
            self._close()
            m = None
        if m is None:
            m = self._open = Manoeuvre(block.t0, signed=False)
        m.add(block.t1, dt, f, 0.0, 0.0)
        m.peak = max(m.peak, h)

    def _close_after_hole(self, now: float) -> None:
        if self._open is not None and now - self._open.stop > MANOEUVRE_HOLE:
            self._close()

    def _close(self) -> None:
        """End the open manoeuvre; if it was one, count it and solve again."""
        m, self._open = self._open, None
        if m is None or abs(m.peak) < self._settings.manoeuvre_peak:
            return
        if m.seconds < 2.0 * self._settings.block_s:
            return
        (self._signed if m.signed else self._unsigned).append(m)
        self._solve()

    # Votes on the sign, without speed.

    def _vote_turn(self, block: Block, dt: float) -> None:
        rate = block.yaw_rate
        s = self._turn
        if abs(rate) > TURN_RATE and "turn" in self._settings.sign_sources and self._offset.ready:
            mean = self._offset.mean()
            side = math.copysign(dt, rate)
            s[0] += side * (block.fx - mean[0])
            s[1] += side * (block.fy - mean[1])
            s[2] += side * (block.fz - mean[2])
            s[3] += dt
            return
        if s[3] >= TURN_SECONDS and not self._reverse and self._tilt is not None:
            left = self._horizontal(s)
            if math.sqrt(left[0] ** 2 + left[1] ** 2 + left[2] ** 2) > TURN_FORCE * s[3]:
                self._votes.add("turn", np.cross(left, self._tilt.up).tolist())
        self._turn = [0.0, 0.0, 0.0, 0.0]

    def _vote_straight(self, block: Block, f: Vector, dt: float) -> None:
        sources = self._settings.sign_sources
        direction = -1.0 if self._reverse else 1.0
        if "first_motion" in sources and block.t0 - self._departed < DEPARTURE_S + 2.0:
            self._gather(self._departure, f, dt, direction)
            if self._departure[3] >= DEPARTURE_S:
                self._cast("first_motion", self._departure, DEPARTURE_FORCE)
                self._departed = -math.inf
        if "brake" in sources and self._brake > 0.5:
            self._gather(self._brake_force, f, dt, -direction)
            if self._brake_force[3] >= DEPARTURE_S:
                self._cast("brake", self._brake_force, BRAKE_FORCE)
                self._brake_force = [0.0, 0.0, 0.0, 0.0]
        else:
            self._brake_force = [0.0, 0.0, 0.0, 0.0]

    @staticmethod
    def _gather(sums: list[float], f: Vector, dt: float, direction: float) -> None:
        for i in range(3):
            sums[i] += direction * dt * f[i]
        sums[3] += dt

    def _cast(self, source: str, sums: list[float], least: float) -> None:
        forward = self._horizontal(sums)
        size = math.sqrt(forward[0] ** 2 + forward[1] ** 2 + forward[2] ** 2)
        if self._tilt is not None and size > least * sums[3]:
            self._votes.add(source, forward)

    def _horizontal(self, v: list[float]) -> Vector:
        if self._tilt is None:
            return (v[0], v[1], v[2])
        x, y, z = self._tilt.up
        along = v[0] * x + v[1] * y + v[2] * z
        return (v[0] - along * x, v[1] - along * y, v[2] - along * z)

    # The solution.

    def _current_level(self) -> Matrix3:
        if self._tilt is None and self._up_sum[3] > 0.0:
            return levelling_rotation(self._up_sum[:3])
        return self._level

    def _set_tilt(self, tilt: Tilt) -> None:
        self._tilt = tilt
        self._level = levelling_rotation(tilt.up)
        self._solve()

    def _solve(self) -> None:
        """Combine all manoeuvres under the present tilt into the target angle, and the state."""
        if self._tilt is None:
            return
        signed = combined([m.pointer(self._level) for m in self._signed])
        enough = signed is not None and signed.manoeuvres >= self._settings.usable_manoeuvres
        if enough or not self._unsigned:
            self._angle, self._sign = signed, 1.0 if signed is not None else 0.0
        else:
            self._angle = combined_axis(
                [m.axis_pointer(self._level) for m in (*self._unsigned, *self._signed)]
            )
            self._sign = 0.0
            if self._angle is not None:
                c, s = math.cos(self._angle.value), math.sin(self._angle.value)
                forward = c * self._level[0] - s * self._level[1]
                x, y, z = forward.tolist()
                self._sign = self._votes.sign((x, y, z))
                if self._sign < 0.0:
                    self._angle = self._angle._replace(value=self._angle.value + math.pi)
        if self._angle is not None:
            self._target = rotation_about_up(self._angle.value) @ self._level
        self._judge()

    def _judge(self) -> None:
        """Set the state; one that is reached is left only beyond its limit times hysteresis."""
        s, tilt, angle, before = self._settings, self._tilt, self._angle, self._state
        state = MountState.WAITING if tilt is None else MountState.LEVELLED
        if tilt is not None and angle is not None and self._sign != 0.0:
            slack = s.hysteresis if before >= MountState.USABLE else 1.0
            usable = (
                angle.manoeuvres >= s.usable_manoeuvres
                and angle.std <= s.usable_yaw_std * slack
                and tilt.std <= s.usable_tilt_std * slack
            )
            slack = s.hysteresis if before >= MountState.FINE else 1.0
            fine = (
                angle.manoeuvres >= s.fine_manoeuvres
                and angle.std <= s.fine_yaw_std * slack
                and tilt.std <= s.fine_tilt_std * slack
            )
            if usable:
                state = MountState.FINE if fine else MountState.USABLE
        self._state = state
        if state < MountState.USABLE or self._target is None:
            self._correction = None
            self._applied = None
            self._slewing = False
            return
        if self._applied is None:
            self._apply(self._target)
        self._slewing = True

    def _slew(self) -> None:
        """Turn the applied rotation towards the target, no faster than the preset rate."""
        if self._target is None or self._applied is None:
            self._slewing = False
            return
        turn = vector_from_rotation(self._target @ self._applied.T)
        angle = math.sqrt(float(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2))
        step = self._settings.slew * TICK_S
        if angle <= step:
            self._apply(self._target)
            self._slewing = False
            return
        self._apply(rotation_from_vector(turn * (step / angle)) @ self._applied)

    def _apply(self, R: Matrix3) -> None:
        self._applied = R
        xx, xy, xz, yx, yy, yz, zx, zy, zz = (float(c) for c in R.ravel())
        self._correction = (xx, xy, xz, yx, yy, yz, zx, zy, zz)

    def _waiting_for(self) -> dict[str, tuple[str, Missing]]:
        """One reason per angle; no entry where nothing is missing."""
        s = self._settings
        waiting: dict[str, tuple[str, Missing]] = {}
        if self._tilt is None:
            seconds = s.static.seconds
            reason = f"standstill of {seconds:g} s not seen yet", Missing.STANDSTILL
            waiting["roll"] = waiting["pitch"] = reason
        elif self._tilt.std > s.fine_tilt_std and not s.planar:
            text = f"more stops in other places, slope averages out ({self._stops.seen} seen)"
            waiting["roll"] = waiting["pitch"] = text, Missing.STANDSTILL
        yaw = self._waiting_for_yaw()
        if yaw is not None:
            waiting["yaw"] = yaw
        return waiting

    def _waiting_for_yaw(self) -> tuple[str, Missing] | None:
        s, angle = self._settings, self._angle
        count = (
            angle.manoeuvres if angle is not None else max(len(self._signed), len(self._unsigned))
        )
        what = f"straight acceleration or braking above {s.manoeuvre_peak:g} m/s2"
        seen = f"{what} ({count} of {s.usable_manoeuvres} seen)"
        if self._tilt is None:
            return f"waiting for levelling, then {seen}", Missing.STANDSTILL
        if count < s.usable_manoeuvres or angle is None:
            return f"waiting for {seen}", Missing.ACCELERATION
        if self._sign == 0.0:
            text = "forward or backward not known: brake switch, turns or moving off from rest"
            return text, Missing.DIRECTION_OF_TRAVEL
        if angle.std > s.usable_yaw_std:
            std = math.degrees(angle.std)
            return f"manoeuvres do not agree yet ({count} seen, {std:.1f} deg)", Missing.AGREEMENT
        if count < s.fine_manoeuvres or angle.std > s.fine_yaw_std:
            return f"more {what} ({count} seen)", Missing.ACCELERATION
        return None
