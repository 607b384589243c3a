"""Method B: the effect of motion on the accelerometer is removed (CN109506674B).

At each instant, a_fwd = d(v_avg)/dt acts along the direction of motion. a_c = omega x v uses the
newest speed, because an average would be late in a braking turn. The measured specific force less
both is gravity plus error. The zero error is subtracted from the gyroscope. Pitch and roll follow
from the remaining force. Each is corrected by the deflection found from the previous angle.

Deflection (*reconstructed*; the publication prints no formula). An acceleration a is known along
the direction of motion, but a number s is subtracted along the accelerometer's own axis. The body's
pitch or roll deflects this axis from the direction of motion. Let the axis be deflected by delta
(positive: it points up). The accelerometer feels
    f_x = a cos(delta) + g sin(delta),    f_z = g cos(delta) - a sin(delta),
The difference f_x - s leaves an angle atan2(f_x - s, f_z) = delta + S with, exactly,
    S(delta; a, s) = atan2(a - s cos(delta), g - s sin(delta)).
delta is not known yet, so the previous angle is used: J_n = phi_n - S(phi_{n-1}), K_n likewise.
- Pitch: s = a = a_fwd. A speed counted by wheels is along the road. Only the body's pitch against
  the road then deflects; the road's part (the slow mean of the angle) does not. A speed over the
  map is horizontal, so the whole angle deflects.
- Roll: s = omega_up v, measured in the body, and a = s / cos(delta). With the full omega x v both
  components of a are already those along the deflected axes, and S is zero.

All quantities are in right-forward-up axes: x right, y forward, z up. Pitch is positive nose up,
roll is positive right side down.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from imucald.attitude.right_forward_up import rfu_from_vehicle
from imucald.config.attitude import MotionCompensationSettings
from imucald.core.rotations import Vector, cross
from imucald.core.samples import GRAVITY

ROAD_TIME = 3.0
"""Time constant of the road's part of an angle [s]: longer than the swing of the body on its
springs.
"""
MAX_SPEEDS = 4096
"""Largest number of speed samples that are stored: a second of any bus."""


def deflection(angle: float, acceleration: float, subtracted: float) -> float:
    """Return S [rad]: error of an angle found from f - s, with the axis deflected by `angle` [rad].

    acceleration: along the direction of motion [m/s^2], positive in the axis' direction;
    subtracted: number subtracted along the axis for it [m/s^2].
    """
    return math.atan2(
        acceleration - subtracted * math.cos(angle), GRAVITY - subtracted * math.sin(angle)
    )


class AverageSpeed(NamedTuple):
    """Mean speed [m/s] over the last samples, and its time [s]."""

    t: float
    speed: float


class SpeedAverager:
    """v_avg: mean of the speed samples of the last `average` seconds, corrected for their delay."""

    def __init__(self, settings: MotionCompensationSettings) -> None:
        self._settings = settings
        self._samples: deque[tuple[float, float]] = deque(maxlen=MAX_SPEEDS)

    def restart(self) -> None:
        """Forget everything, because time has jumped."""
        self._samples.clear()

    def add_speed(self, t: float, speed: float) -> AverageSpeed:
        """Take a speed [m/s], signed, that came at t [s]; return the average now."""
        samples, settings = self._samples, self._settings
        samples.append((t, speed))
        while samples[0][0] < t - settings.average:
            samples.popleft()
        n = len(samples)
        mean_t = sum(s[0] for s in samples) / n
        return AverageSpeed(mean_t - (settings.delay or 0.0), sum(s[1] for s in samples) / n)


class Compensated(NamedTuple):
    """Result of method B for one instant; right-forward-up axes.

    force: specific force less motion [m/s^2]. rate: less zero error [rad/s]. pitch, roll: from the
    force, less the deflection. raw_pitch, raw_roll: the same with the deflection [rad]. known:
    whether the speed was known.
    """

    force: Vector
    rate: Vector
    pitch: float
    roll: float
    raw_pitch: float
    raw_roll: float
    known: bool


class MotionCompensation:
    """Method B, instant by instant, with the data received so far.

    zero_error: of the gyroscope [rad/s], right-forward-up axes.
    """

    def __init__(
        self, settings: MotionCompensationSettings, zero_error: Vector = (0.0, 0.0, 0.0)
    ) -> None:
        self.settings = settings
        self.zero_error = zero_error
        self._average = SpeedAverager(settings)
        self._lever = rfu_from_vehicle(*settings.lever_arm)
        self.restart()

    def restart(self) -> None:
        """Forget everything, because time has jumped."""
        self._average.restart()
        self._endpoints: deque[AverageSpeed] = deque(maxlen=MAX_SPEEDS)
        self._heard = -math.inf
        self._speed = 0.0
        self._a_fwd = 0.0
        self._last: tuple[float, Vector] | None = None
        self.angles = (0.0, 0.0)
        """Pitch and roll of the previous instant [rad]; a caller with better angles sets them."""
        self._road = (0.0, 0.0)

    def speed(self, t: float, speed: float) -> None:
        """Take a speed [m/s], signed, that came at t [s]."""
        self._heard, self._speed = t, speed
        endpoint = self._average.add_speed(t, speed)
        endpoints = self._endpoints
        if endpoints and endpoint.t <= endpoints[-1].t:
            return
        if endpoints and endpoint.t - endpoints[-1].t > self.settings.timeout:
            endpoints.clear()
        endpoints.append(endpoint)
        while len(endpoints) > 2 and endpoints[-1].t - endpoints[1].t >= self.settings.interval:
            endpoints.popleft()
        if len(endpoints) > 1:
            first, last = endpoints[0], endpoints[-1]
            self._a_fwd = (last.speed - first.speed) / (last.t - first.t)

    def is_standing(self, t: float) -> bool | None:
        """Return whether speed is zero at t [s] and has been zero since the last averages; None:
        not known.
        """
        if t - self._heard > self.settings.timeout or len(self._endpoints) < 2:
            return None
        return all(endpoint.speed == 0.0 for endpoint in self._endpoints)

    def take_sample(self, t: float, force: Vector, rate: Vector) -> Compensated:
        """Correct one sample of accelerometer [m/s^2] and gyroscope [rad/s] at t [s]."""
        bx, by, bz = self.zero_error
        rate = (rate[0] - bx, rate[1] - by, rate[2] - bz)
        known = t - self._heard <= self.settings.timeout and len(self._endpoints) > 1
        a_fwd = self._a_fwd if known else 0.0
        speed = self._speed if known else 0.0
        cx, cy, cz = cross(rate, (0.0, speed, 0.0))
        if self.settings.centripetal == "plane":
            cz = 0.0
        lx, ly, lz = self._lever_acceleration(t, rate)
        fx, fy, fz = force[0] - cx - lx, force[1] - a_fwd - cy - ly, force[2] - cz - lz
        raw_pitch = math.atan2(fy, math.hypot(fx, fz))
        raw_roll = math.atan2(-fx, fz)
        pitch, roll = self._deflected(t, raw_pitch, raw_roll, a_fwd, cx)
        self._last = (t, rate)
        self.angles = (pitch, roll)
        return Compensated((fx, fy, fz), rate, pitch, roll, raw_pitch, raw_roll, known)

    def _deflected(
        self, t: float, raw_pitch: float, raw_roll: float, a_fwd: float, a_right: float
    ) -> tuple[float, float]:
        """Return J and K of the publication: the angles less S of the previous ones."""
        pitch, roll = self.angles
        if self._last is None:
            self._road = (raw_pitch, raw_roll)
            return raw_pitch, raw_roll
        if self.settings.speed_is == "along_road":
            part = 1.0 - math.exp(-max(t - self._last[0], 0.0) / ROAD_TIME)
            self._road = (
                self._road[0] + part * (pitch - self._road[0]),
                self._road[1] + part * (roll - self._road[1]),
            )
            pitch, roll = pitch - self._road[0], roll - self._road[1]
        raw_pitch -= deflection(pitch, a_fwd, a_fwd)
        if self.settings.centripetal == "plane":
            # A positive roll points the right axis down, so a force to the right is a negative one.
            raw_roll += deflection(-roll, a_right / math.cos(roll), a_right)
        return raw_pitch, raw_roll

    def _lever_acceleration(self, t: float, rate: Vector) -> Vector:
        """Return omega' x l + omega x (omega x l) at the sensor, with omega' from successive
        samples.
        """
        if not any(self._lever):
            return 0.0, 0.0, 0.0
        along = cross(rate, cross(rate, self._lever))
        if self._last is None or not 0.0 < t - self._last[0] < self.settings.timeout:
            return along
        dt, before = t - self._last[0], self._last[1]
        change = tuple((a - b) / dt for a, b in zip(rate, before, strict=True))
        turning = cross((change[0], change[1], change[2]), self._lever)
        return turning[0] + along[0], turning[1] + along[1], turning[2] + along[2]
