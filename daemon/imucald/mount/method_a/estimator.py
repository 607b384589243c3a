"""Method A online: a `MountEstimator` that runs the published solver on ticks.

The published steps are: static test, tilt, straight variable-speed motion, target angle,
correction. There are five additions to the publication: a limit on v r (speed times yaw rate),
subtraction of v r, dv/dt from the speed for sign and weight, averaging of several stops, and
removal of the wandering offset. An interval that contains a bad sample is dropped completely.
"""

from __future__ import annotations

import math
from math import isnan

import numpy as np

from imucald.core.rotations import Matrix3, Vector, rotation_from_angles
from imucald.core.samples import GRAVITY
from imucald.motion.physical_limits import ROAD_FORCE_WIDE, is_saturated
from imucald.motion.speed import SpeedInterval, SpeedIntervalMaker
from imucald.motion.straight import YawRateSource
from imucald.motion.stuck import HeldForce
from imucald.motion.ticks import ACCEL, BRAKE, LATERAL_ACCEL, REVERSE, SPEED, T, TickRow
from imucald.mount.estimate import Correction, MountEstimate, MountState
from imucald.mount.hysteresis import GOOD
from imucald.mount.method_a.collector import ManoeuvreCollector
from imucald.mount.method_a.gate import (
    OFFSET_LOST_SPEED_S,
    OFFSET_WITHOUT_SPEED_S,
    StraightGate,
    WanderingOffset,
)
from imucald.mount.method_a.levelling import rotation_about_up
from imucald.mount.method_a.settings import PublishedSettings
from imucald.mount.method_a.sign import SignEvidence
from imucald.mount.method_a.states import TiltAndAngle, judged, waiting_for
from imucald.mount.method_a.target_angle import CombinedAngle, combined, combined_axis
from imucald.mount.method_a.tilt import TiltEstimator
from imucald.mount.slewing import SlewedCorrection

NAN = math.nan

MAX_HOLE_TICKS = 5
"""Number of ticks for which the last specific force replaces a missing force: the samples of a 10
Hz sensor have jitter."""
UNKNOWN_SIGN_STD = math.pi / 2.0
"""Standard deviation of a yaw that may be wrong by 180 deg [rad]."""


class PublishedEstimator:
    """The published solver as a mount estimator, with the interface
    `mount.estimate.MountEstimator`."""

    def __init__(self, settings: PublishedSettings | None = None) -> None:
        s = settings or PublishedSettings()
        if s.calibration.method_a.to_the_letter:
            s = s.to_the_letter()
        self._settings = s
        self._tilt = TiltEstimator(s)
        self._intervals = SpeedIntervalMaker(
            s.block_s, s.calibration.speed_delay or 0.0, s.speed_timeout
        )
        self._yaw_source = YawRateSource(
            s.vehicle.steering_ratio,
            s.vehicle.wheelbase,
            "steering" in s.calibration.straight.recognisers,
        )
        lost = OFFSET_LOST_SPEED_S if s.use_speed else OFFSET_WITHOUT_SPEED_S
        self._offset = WanderingOffset(s.calibration.target_angle.remove_offset_after, lost)
        self._gate = StraightGate(s, self._offset)
        self._sign = SignEvidence(s.calibration.target_angle.sign_from)
        self._collector = ManoeuvreCollector(s)
        self._applied = SlewedCorrection(s.slew)
        self._held = HeldForce()
        self._known = TiltAndAngle()
        self._target: Matrix3 | None = None
        self._state = MountState.WAITING
        self._restart_stream()
        self._solve()

    # Methods of the interface.

    @property
    def correction(self) -> Correction | None:
        """Correction to apply now, or None until the mount is usable."""
        return self._applied.correction

    @property
    def state(self) -> MountState:
        """The present state."""
        return self._state

    def gap(self) -> None:
        """Note a jump of time: open windows, intervals and manoeuvres are dropped, and the
        knowledge is kept.
        """
        self._restart_stream()

    def _restart_stream(self) -> None:
        self._tilt.restart()
        self._intervals.restart()
        self._yaw_source.restart()
        self._offset.restart()
        self._gate.restart()
        self._sign.restart()
        self._collector.drop()
        self._force: Vector | None = None
        self._holes = 0
        self._held.restart()
        self._speed, self._speed_t = NAN, -math.inf
        self._reverse = False
        self._brake = self._lateral = NAN
        self._straight_s = 0.0

    def step(self, tick: TickRow) -> None:
        """Process one tick."""
        self._take_vehicle(tick)
        clean = self._take_force(tick)
        force = self._force
        if force is not None:
            tilt = self._tilt
            if tilt.take_tick(tick, force, clean, self._speed):
                self._solve()
            if tilt.departed:
                self._sign.depart(tick[T])
            yaw_rate = self._yaw_source.take_tick(tick, tilt.up, self._speed, tilt.still)
            x, y, z = force
            interval = self._intervals.take_tick(tick[T], x, y, z, yaw_rate, clean)
            if interval is not None:
                self._take_interval(interval)
        self._applied.move_on()

    def estimate(self) -> MountEstimate:
        """Return the present estimate."""
        known, s = self._known, self._settings
        reasons = waiting_for(known, s)
        covariance = None
        if self._target is not None and known.tilt is not None and known.angle is not None:
            yaw_std = known.angle.std if known.sign_known else UNKNOWN_SIGN_STD
            tilt_variance = known.tilt.std**2
            covariance = np.diag(
                [tilt_variance + s.vehicle.crown_std**2, tilt_variance, yaw_std**2]
            )
        return MountEstimate(
            state=self._state,
            R_vehicle_from_sensor=self._target,
            covariance=covariance,
            waiting_for={name: text for name, (text, _) in reasons.items()},
            missing={name: code for name, (_, code) in reasons.items()},
            details={
                "method": "published",
                "stops": self._tilt.stops,
                "manoeuvres": len(self._collector.signed),
                "manoeuvres_without_speed": len(self._collector.unsigned),
                "sign_votes": dict(self._sign.votes.counts),
                "yaw_rate_source": self._yaw_source.source,
            },
            targets=s.targets,
        )

    # Use of a tick.

    def _take_vehicle(self, tick: TickRow) -> None:
        if not isnan(tick[REVERSE]):
            self._reverse = tick[REVERSE] > 0.5
            self._collector.gear_known = True
        if not isnan(tick[BRAKE]):
            self._brake = tick[BRAKE]
        if tick[LATERAL_ACCEL.n] > 0.0:
            self._lateral = tick[LATERAL_ACCEL.mean]
        t = tick[T]
        if tick[SPEED.n] > 0.0 and tick[SPEED.bad] == 0.0 and self._settings.use_speed:
            self._speed = -tick[SPEED.mean] if self._reverse else tick[SPEED.mean]
            self._speed_t = t
            self._intervals.add_speed(t - tick[SPEED.age], self._speed)
        elif t - self._speed_t > self._settings.speed_timeout:
            self._speed = NAN

    def _take_force(self, tick: TickRow) -> bool:
        """Store the tick's specific force. Returns True if the tick can be used for learning."""
        if tick[ACCEL.bad] > 0.0:
            return False
        if tick[ACCEL.n] == 0.0:
            self._holes += 1
            if self._holes > MAX_HOLE_TICKS:
                self._force = None
                self._held.restart()
                self._intervals.restart()
            return False if self._holes > MAX_HOLE_TICKS else self._force is not None
        self._holes = 0
        z = GRAVITY if self._settings.planar else tick[ACCEL.z]
        force = (tick[ACCEL.x], tick[ACCEL.y], z)
        size = math.sqrt(force[0] * force[0] + force[1] * force[1] + z * z)
        low, high = ROAD_FORCE_WIDE
        if not low <= size <= high or is_saturated(tick, self._settings.calibration.full_scale):
            return False
        stuck = self._held.take_tick(tick, force)
        self._force = force
        self._gate.push(force)
        stands = self._settings.calibration.static.standstill_speed
        return not stuck or not abs(self._speed) > stands

    # Use of an interval.

    def _take_interval(self, interval: SpeedInterval) -> None:
        s, dt = self._settings, interval.t1 - interval.t0
        mx, my, mz, m_dvdt, m_lateral = self._offset.mean()
        ready = self._offset.ready
        f = (interval.fx - mx, interval.fy - my, interval.fz - mz)
        if interval.clean and ready:
            self._sign.take_turn(interval, f, self._tilt.up, self._reverse)
        steering = self._yaw_source.steering
        straight = interval.clean and self._gate.is_straight(
            interval, steering, self._lateral, self._tilt.level
        )
        if not straight:
            self._offset.fade(dt)
            if self._gate.is_turning(interval):
                self._straight_s = 0.0
            self._end_manoeuvre()
            return
        known = not isnan(interval.dvdt)
        dvdt = interval.dvdt if known else 0.0
        target = s.calibration.target_angle
        lateral = interval.speed * interval.yaw_rate if target.subtract_lateral else 0.0
        lateral = 0.0 if isnan(lateral) else lateral
        self._offset.add_interval(interval, dvdt, lateral, with_speed=known)
        self._straight_s += dt
        if not ready or self._tilt.still or self._straight_s < s.settle:
            self._end_manoeuvre()
            return
        braking = self._brake > 0.5
        self._sign.take_straight(interval, f, self._tilt.up, self._reverse, braking)
        if known and "speed" in target.sign_from:
            ended = self._collector.take_interval(interval, f, dvdt - m_dvdt, lateral - m_lateral)
        else:
            ended = self._collector.take_unsigned(interval, f, self._tilt.level)
        if ended:
            self._solve()

    def _end_manoeuvre(self) -> None:
        if self._collector.end():
            self._solve()

    # The solution.

    def _solve(self) -> None:
        """Compute the target angle from all manoeuvres with the present tilt, and set the state."""
        tilt, level = self._tilt.tilt, self._tilt.level
        angle, sign_known = None, False
        if tilt is not None:
            angle, sign_known = self._target_angle(level)
        if angle is not None:
            lean = rotation_from_angles(-self._settings.crown, 0.0, 0.0)
            self._target = lean @ rotation_about_up(angle.value) @ level
        self._known = TiltAndAngle(
            tilt=tilt,
            angle=angle,
            sign_known=sign_known,
            stops=self._tilt.stops,
            manoeuvres=max(len(self._collector.signed), len(self._collector.unsigned)),
        )
        self._state = judged(self._known, self._state, self._settings)
        if self._state in GOOD and self._target is not None:
            self._applied.aim(Correction.turning(self._target))

    def _target_angle(self, level: Matrix3) -> tuple[CombinedAngle | None, bool]:
        """Return the target angle lambda and whether its sign is known. Manoeuvres with speed are
        preferred."""
        book, unsigned = self._collector.signed, self._collector.unsigned
        signed = combined(book.pointers(level), robust=self._settings.robust)
        if not unsigned or len(book) >= self._settings.usable_manoeuvres:
            return signed, signed is not None
        books = (unsigned, book)
        pointers = np.concatenate([b.axis_pointers(level) for b in books])
        axis = combined_axis(pointers, self._settings.robust)
        if axis is None:
            return None, False
        forward = math.cos(axis.value) * level[0] - math.sin(axis.value) * level[1]
        x, y, z = forward.tolist()
        votes = self._sign.votes
        ahead, back = votes.count((x, y, z))
        if back > ahead:
            axis = axis._replace(value=axis.value + math.pi)
        return axis, votes.sign((x, y, z)) != 0.0
