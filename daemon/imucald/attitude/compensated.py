"""Method B alone, with the interface of the filter: corrected samples in, roll and pitch out.

By default, the angles are computed directly from the force minus motion. The angles contain the
noise of the force and have no memory except the memory of method B. The result is for comparison,
and for users with a filter of their own.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucald.attitude.carried_angles import CarriedAngles
from imucald.attitude.estimate import STALE_S, UNKNOWN, AttitudeEstimate, AttitudeState
from imucald.attitude.motion_compensation import Compensated, MotionCompensation
from imucald.attitude.rest import RestingGyro
from imucald.attitude.right_forward_up import rfu_from_vehicle, vehicle_from_rfu
from imucald.attitude.sensor_check import CheckResult
from imucald.config.attitude import AttitudeSettings
from imucald.core.rotations import Vector
from imucald.motion.lost_time import LostTime


class CompensatedAttitude:
    """Processes samples in vehicle axes (ISO 8855), SI units, with stream time."""

    def __init__(self, settings: AttitudeSettings | None = None) -> None:
        self.settings = settings or AttitudeSettings()
        self.motion_compensation = MotionCompensation(self.settings.compensation)
        self.checked = False
        """True if the gyroscope's zero error was measured at rest."""
        self._rest = RestingGyro(self.settings.filter)
        self._lost_time = LostTime()
        self._carried = CarriedAngles(
            self.settings.compensation.rate_time, self.settings.filter.longest_step
        )
        self.reset()

    def reset(self) -> None:
        """Forget everything except the zero error."""
        self.motion_compensation.restart()
        self._sign = 1.0
        self._rate: Vector | None = None
        self._t_gyro = -math.inf
        self._t = -math.inf
        self._last: Compensated | None = None
        self._rest.begin()
        self._carried.restart()

    def check_again(self) -> None:
        """Measure the zero error again at the next rest that is long enough."""
        self.checked = False
        self._rest.begin()

    @property
    def running(self) -> bool:
        """True if an attitude is available."""
        return self._last is not None

    @property
    def check(self) -> CheckResult | None:
        """Zero error from the last rest, in vehicle axes; None before the first rest."""
        if not self.checked:
            return None
        return CheckResult(vehicle_from_rfu(*self.motion_compensation.zero_error), (0.0, 0.0, 0.0))

    def restore_check(self, found: CheckResult) -> None:
        """Use the result of an earlier check, in vehicle axes. The next rest replaces this
        result."""
        self.motion_compensation.zero_error = rfu_from_vehicle(*found.rate)
        self.checked = True

    def gyro(self, t: float, values: Sequence[float]) -> None:
        """Process an angular rate [rad/s]."""
        self._rate = rfu_from_vehicle(values[0], values[1], values[2])
        step, self._t_gyro = t - self._t_gyro, t
        if step < math.inf and self._lost_time.take_time_step(max(step, 0.0)):
            self._carried.restart()  # the turn during the gap was not carried
        stands = self.motion_compensation.is_standing(t)
        zero_error = self._rest.gyro(t, self._rate, stands, is_first=not self.checked)
        if zero_error is not None:
            self.motion_compensation.zero_error = zero_error
            self.checked = True
        if self.settings.compensation.rate_time > 0.0:
            b, w = self.motion_compensation.zero_error, self._rate
            self._carried.turn(t, (w[0] - b[0], w[1] - b[1], w[2] - b[2]))

    def accel(self, t: float, values: Sequence[float]) -> None:
        """Process a specific force [m/s^2]."""
        if self._rate is None or t - self._t_gyro > self.settings.filter.longest_step:
            return
        force = rfu_from_vehicle(values[0], values[1], values[2])
        self._rest.accel(force)
        last = self._last = self.motion_compensation.take_sample(t, force, self._rate)
        self._t = t
        if self.settings.compensation.rate_time > 0.0:
            self._carried.draw(t, last.pitch, last.roll)
            angles = self._carried.angles
            if angles is not None:
                self.motion_compensation.angles = angles

    def speed(self, t: float, speed: float) -> None:
        """Process a speed [m/s], not negative. `reverse` sets the direction."""
        self.motion_compensation.speed(t, self._sign * speed)
        if speed > 0.0:
            self._rest.begin()

    def reverse(self, is_reverse: bool) -> None:
        """Set whether the vehicle drives backwards."""
        self._sign = -1.0 if is_reverse else 1.0

    def heading(self, t: float, heading: float) -> None:
        """Ignore a heading: method B has no heading."""

    def mag(self, t: float, values: Sequence[float]) -> None:
        """Ignore a magnetic field: method B has no heading."""

    def turned(self, old: Sequence[float], new: Sequence[float]) -> None:
        """Note that the rotation of the mount has changed. No state depends on this rotation."""

    def take_zeros_off(self, rate: Vector, force: Vector) -> None:
        """Set the additional zero errors that are subtracted from the samples from now on, vehicle
        axes (3,) [rad/s], [m/s^2].

        The zero error of the rate is reduced by the same value, if a rest has already shown a zero
        error.
        """
        if self.checked:
            (x, y, z), (p, q, r) = self.motion_compensation.zero_error, rfu_from_vehicle(*rate)
            self.motion_compensation.zero_error = x - p, y - q, z - r

    def estimate(self, now: float | None = None) -> AttitudeEstimate:
        """Return roll and pitch at the newest sample, without deviations and without a heading."""
        last = self._last
        stale = now is not None and now - min(self._t, self._t_gyro) > STALE_S
        b = self.motion_compensation.zero_error
        pitch, roll = self.motion_compensation.angles
        if last is not None and (angles := self._carried.angles) is not None:
            pitch, roll = angles  # of the newest rate, not only of the newest force
        return AttitudeEstimate(
            state=AttitudeState.NOT_AVAILABLE
            if last is None or stale
            else AttitudeState.UNFILTERED,
            t=self._t,
            roll=math.nan if last is None else roll,
            pitch=math.nan if last is None else -pitch,
            heading=math.nan,
            std=UNKNOWN,
            rate=UNKNOWN if last is None else vehicle_from_rfu(*last.rate),
            rate_std=UNKNOWN,
            grade=math.nan,
            grade_std=math.nan,
            bias=vehicle_from_rfu(*b),
            free_acceleration=UNKNOWN if last is None else vehicle_from_rfu(*last.force),
        )
