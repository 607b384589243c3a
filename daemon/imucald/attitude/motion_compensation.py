"""Method B: it removes the effect of motion on the accelerometer (CN109506674B).

At each instant, a_fwd = d(v_avg)/dt acts along the direction of motion. a_c = omega x v uses the
newest speed, because an average speed would be late in a braking turn. The measured specific force
minus a_fwd and a_c is gravity plus error. The zero error is subtracted from the gyroscope. Pitch
and roll are computed from the remaining force. Each angle is corrected by the deflection, which is
computed from the previous angle.

Deflection (*reconstructed*; the publication states no formula). An acceleration a is known along
the direction of motion, but a number s is subtracted along the accelerometer's own axis. The pitch
or roll of the body deflects this axis from the direction of motion. Let the axis be deflected by
delta (positive: the axis points up). The accelerometer measures
    f_x = a cos(delta) + g sin(delta),    f_z = g cos(delta) - a sin(delta),
The angle computed from f_x - s is atan2(f_x - s, f_z) = delta + S. The error S is exactly
    S(delta; a, s) = atan2(a - s cos(delta), g - s sin(delta)).
delta is not known yet, so the previous angle is used: J_n = phi_n - S(phi_{n-1}) for the pitch, and
K_n in the same way for the roll.
- Pitch: s = a = a_fwd. A speed from wheels is along the road, so only the body's pitch relative to
the road is a deflection. The slope of the road (the slow mean of the angle) is not a deflection. A
speed from satellites is horizontal, so the whole angle is a deflection.
- Roll: s = omega_up v, measured in the body, and a = s / cos(delta). With the full omega x v, both
components of a are already along the deflected axes, and S is zero.

All quantities are in right-forward-up axes: x right, y forward, z up. Pitch is positive with the
nose up, roll is positive with the right side down.
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
"""Time constant of the road's part of an angle [s]. It is longer than the oscillation of the body
on its springs.
"""
MAX_SPEEDS = 4096
"""Largest number of stored speed samples: one second of any bus."""


def deflection(angle: float, acceleration: float, subtracted: float) -> float:
    """Return S [rad]: the error of an angle computed from f - s, with the axis deflected by `angle`
    [rad].

    acceleration: acceleration along the direction of motion [m/s^2], positive in the direction of
    the axis. subtracted: number s that is subtracted along the axis [m/s^2].
    """
    return math.atan2(
        acceleration - subtracted * math.cos(angle), GRAVITY - subtracted * math.sin(angle)
    )


class AverageSpeed(NamedTuple):
    """Mean speed [m/s] over the last samples, and the time of the mean [s]."""

    t: float
    speed: float


class SpeedAverager:
    """Average v_avg: mean of the speed samples of the last `average` seconds, corrected for the
    delay of the speed."""

    def __init__(self, settings: MotionCompensationSettings) -> None:
        self._settings = settings
        self._samples: deque[tuple[float, float]] = deque(maxlen=MAX_SPEEDS)

    def restart(self) -> None:
        """Forget everything, because time has jumped."""
        self._samples.clear()

    def add_speed(self, t: float, speed: float) -> AverageSpeed:
        """Process a signed speed [m/s] that was received at t [s]. Returns the present average."""
        samples, settings = self._samples, self._settings
        samples.append((t, speed))
        while samples[0][0] < t - settings.average:
            samples.popleft()
        n = len(samples)
        mean_t = sum(s[0] for s in samples) / n
        return AverageSpeed(mean_t - (settings.delay or 0.0), sum(s[1] for s in samples) / n)


class Compensated(NamedTuple):
    """Result of method B for one instant, in right-forward-up axes.

    force: specific force minus motion [m/s^2]. rate: rate minus zero error [rad/s]. pitch, roll:
    angles from the force, without the deflection [rad]. raw_pitch, raw_roll: angles from the force,
    with the deflection [rad]. known: True if the speed was known.
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

    zero_error: zero error of the gyroscope [rad/s], right-forward-up axes.
    """

    def __init__(self, settings: MotionCompensationSettings) -> None:
        self.settings = settings
        self.zero_error: Vector = (0.0, 0.0, 0.0)
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
        """Pitch and roll of the previous instant [rad]. A caller with better angles may set these
        angles."""
        self._road = (0.0, 0.0)

    def speed(self, t: float, speed: float) -> None:
        """Process a signed speed [m/s] that was received at t [s]."""
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
        """Return whether the speed is zero at t [s] and was zero in all last averages; None: not
        known.
        """
        if t - self._heard > self.settings.timeout or len(self._endpoints) < 2:
            return None
        return all(endpoint.speed == 0.0 for endpoint in self._endpoints)

    def take_sample(self, t: float, force: Vector, rate: Vector) -> Compensated:
        """Correct one accelerometer sample [m/s^2] and one gyroscope sample [rad/s] at t [s]."""
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
        """Return J and K of the publication: the raw angles minus S of the previous angles."""
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
        """Return omega' x l + omega x (omega x l) at the sensor. omega' is computed from successive
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
