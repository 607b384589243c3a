"""Rest of an interval (method C), and mean rate of the gyroscope over each rest (method B, claim
1)."""

from __future__ import annotations

import math

from imucald.attitude.interval import Endpoint, Interval
from imucald.config.attitude import FilterSettings
from imucald.core.rotations import Vector
from imucald.motion.standstill import feels_parked

BLOCK_S = 1.0
"""Length of the pieces in which a rest is examined [s]. A piece that is not quiet ends the rest."""
MAX_ZERO_ERROR = 6.0
"""Largest rate at rest, in standard deviations of the zero error."""


def is_rest(
    first: Endpoint, last: Endpoint, found: Interval, zero_error: Vector, settings: FilterSettings
) -> bool:
    """Return whether the vehicle is at rest from one endpoint to the next.

    zero_error: known zero error of the gyroscope [rad/s].
    """
    has_speed = not math.isnan(found.speed)
    if has_speed and not first.speed == last.speed == 0.0:
        return False
    force = found.force_variance, math.hypot(*found.up)
    rate = sum(found.rate_variance), math.dist(found.rate, zero_error)
    return _is_quiet(force, rate, has_speed, settings)


def _is_quiet(
    force: tuple[float, float],
    rate: tuple[float, float],
    has_speed: bool,
    settings: FilterSettings,
) -> bool:
    """Return whether both sensors are as quiet as at rest. Without a speed, only a vehicle as still
    as a parked one counts as at rest.

    force, rate: variance of one sample, sum over all axes, and size of the mean, SI.
    """
    if rate[0] >= settings.rest_gyro_spread**2:
        return False
    if rate[1] >= MAX_ZERO_ERROR * max(settings.gyro_start):
        return False
    return force[0] < settings.rest_accel_spread**2 and (has_speed or feels_parked(*force))


class _TriadSums:
    """Count, sum and sum of squares of three axes."""

    def __init__(self) -> None:
        self.n = self.x = self.y = self.z = self.square = 0.0

    def add_vector(self, v: Vector) -> None:
        x, y, z = v
        self.n += 1.0
        self.x += x
        self.y += y
        self.z += z
        self.square += x * x + y * y + z * z

    def include(self, other: _TriadSums) -> None:
        self.n += other.n
        self.x += other.x
        self.y += other.y
        self.z += other.z
        self.square += other.square

    @property
    def mean(self) -> Vector:
        return self.x / self.n, self.y / self.n, self.z / self.n

    @property
    def spread(self) -> tuple[float, float]:
        """Variance of one sample, sum over all axes, and size of the mean."""
        x, y, z = self.mean
        size = x * x + y * y + z * z
        return max(self.square / self.n - size, 0.0), math.sqrt(size)


class RestingGyro:
    """Processes samples of both sensors in any common axes. Returns the zero error of the gyroscope
    after a rest that is long enough.

    The first rest must last `check` (as in the sensor check of method C). Later rests must last
    `start` if a speed shows that the vehicle stands. Without a speed, the vehicle must be as still
    as a parked vehicle, and the rest must last `check`.
    """

    def __init__(self, settings: FilterSettings) -> None:
        self._settings = settings
        self.begin()

    def begin(self) -> None:
        """End the present rest, if there is one."""
        self._total = _TriadSums()
        self._since = math.nan
        self._begin_block()

    def _begin_block(self) -> None:
        self._rates, self._forces = _TriadSums(), _TriadSums()
        self._block = math.nan

    def accel(self, force: Vector) -> None:
        """Process a specific force [m/s^2]."""
        self._forces.add_vector(force)

    def gyro(self, t: float, rate: Vector, stands: bool | None, is_first: bool) -> Vector | None:
        """Process a rate [rad/s] at t [s]. Returns the zero error if the rest is now long enough,
        else None.

        stands: True if the speed is zero; None: not known. is_first: no zero error was returned
        before.
        """
        if stands is False:
            self.begin()
            return None
        if math.isnan(self._block):
            self._block = t
            if math.isnan(self._since):
                self._since = t
        self._rates.add_vector(rate)
        if t - self._block < BLOCK_S:
            return None
        rates, forces = self._rates, self._forces
        if not forces.n or not _is_quiet(
            forces.spread, rates.spread, stands is True, self._settings
        ):
            self.begin()
            return None
        self._total.include(self._rates)
        self._begin_block()
        s = self._settings
        if t - self._since < (s.check if is_first or stands is None else s.start):
            return None
        found = self._total.mean
        self.begin()
        return found
