"""Method B alone, with the verbs of the filter: corrected samples in, roll and pitch out.

No memory beyond B's own: what the accelerometer is spared of motion is what the angles say, noise
and all. For comparison, and for those who filter themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from imucald.attitude.estimate import STALE_S, AttitudeEstimate, AttitudeState
from imucald.attitude.motion_compensation import Compensated, MotionCompensation
from imucald.attitude.right_forward_up import rfu_from_vehicle, vehicle_from_rfu
from imucald.config.attitude import AttitudeSettings
from imucald.core.rotations import Vector

NAN = math.nan
_NOTHING: Vector = (NAN, NAN, NAN)


class CompensatedAttitude:
    """Takes samples in vehicle axes (ISO 8855), SI units, stream time."""

    def __init__(self, settings: AttitudeSettings | None = None) -> None:
        self.settings = settings or AttitudeSettings()
        self.compensation = MotionCompensation(self.settings.compensation)
        self.checked = False
        """Whether the gyroscope's zero error has been measured at rest."""
        self.reset()

    def reset(self) -> None:
        """Forget everything but the zero error."""
        self.compensation.restart()
        self._sign = 1.0
        self._rate: Vector | None = None
        self._t_gyro = -math.inf
        self._t = -math.inf
        self._last: Compensated | None = None
        self._rest_begin()

    gap = reset

    @property
    def running(self) -> bool:
        """Whether there is an attitude."""
        return self._last is not None

    def gyro(self, t: float, values: Sequence[float]) -> None:
        """Take an angular rate [rad/s]."""
        self._rate = rfu_from_vehicle(values[0], values[1], values[2])
        self._t_gyro = t
        if not self.checked:
            self._rest(t, self._rate)

    def accel(self, t: float, values: Sequence[float]) -> None:
        """Take a specific force [m/s^2]."""
        if self._rate is None or t - self._t_gyro > self.settings.filter.longest_step:
            return
        force = rfu_from_vehicle(values[0], values[1], values[2])
        self._last = self.compensation.take(t, force, self._rate)
        self._t = t

    def speed(self, t: float, speed: float) -> None:
        """Take a speed [m/s], not negative: the direction comes by `reverse`."""
        self.compensation.speed(t, self._sign * speed)
        if speed > 0.0:
            self._rest_begin()

    def reverse(self, is_reverse: bool) -> None:
        """Say whether the vehicle drives backwards."""
        self._sign = -1.0 if is_reverse else 1.0

    def heading(self, t: float, heading: float) -> None:
        """Ignore a heading: B has none."""

    def mag(self, t: float, values: Sequence[float]) -> None:
        """Ignore a magnetic field: B has no heading."""

    def turned(self, old: Sequence[float], new: Sequence[float]) -> None:
        """The mount's rotation is another one: nothing is kept that this would spoil."""

    def estimate(self, now: float | None = None) -> AttitudeEstimate:
        """Return roll and pitch of the newest sample; there are no deviations and no heading."""
        last = self._last
        stale = now is not None and now - min(self._t, self._t_gyro) > STALE_S
        b = self.compensation.zero_error
        return AttitudeEstimate(
            state=AttitudeState.NOT_AVAILABLE
            if last is None or stale
            else AttitudeState.UNFILTERED,
            t=self._t,
            roll=NAN if last is None else last.roll,
            pitch=NAN if last is None else -last.pitch,
            heading=NAN,
            std=_NOTHING,
            rate=_NOTHING if last is None else vehicle_from_rfu(*last.rate),
            rate_std=_NOTHING,
            grade=NAN,
            grade_std=NAN,
            bias=vehicle_from_rfu(*b),
        )

    def _rest_begin(self) -> None:
        self._rest_start = NAN
        self._sum = [0.0] * 3
        self._square = self._n = 0.0

    def _rest(self, t: float, rate: Vector) -> None:
        """Thirty seconds of standing tell the zero error (the sensor check of method C)."""
        if not self.compensation.is_standing(t):
            self._rest_begin()
            return
        if math.isnan(self._rest_start):
            self._rest_start = t
        for i, w in enumerate(rate):
            self._sum[i] += w
            self._square += w * w
        self._n += 1.0
        if t - self._rest_start < self.settings.filter.check:
            return
        x, y, z = (total / self._n for total in self._sum)
        variance = self._square / self._n - (x * x + y * y + z * z)
        if variance < self.settings.filter.rest_gyro_spread**2:
            self.compensation.zero_error = (x, y, z)
            self.checked = True
        self._rest_begin()
