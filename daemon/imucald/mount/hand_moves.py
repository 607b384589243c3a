"""Detect a sensor that is turned by hand or by a knock.

`TurnedAlone` detects a sensor that turns about the vertical while the vehicle does not turn.

Two times are compared at which gyroscope and vehicle hardly turn. Between these times, gyroscope
and vehicle must have turned by the same angle, even if their signals have different delays. If the
gyroscope turned further, the sensor was moved by hand or by a knock. The turning of the vehicle is
measured by its yaw rate and, at speed, also by the force to the left (v r).

The angle of a gyroscope that sends seldom has a random walk (`gyro_walk`). For example, a phone
that shook in its holder, at five samples a second, seemed to turn by 29 deg within 2 s and had not
turned.

Before the first rest, the zero error of the gyroscope is a guess with a deviation
(`offsets.turn_zero_std`). A guess that is wrong by 1.7 deg/s looks like a turn by 3.4 deg.

`HandMoves` also detects any rotation and any tilt of the sensor while the vehicle stands.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, Flags
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import SignalBlock

APART = 20
"""Ticks between the two compared times (2 s). A knock is shorter than this, and a move by hand
takes about a second."""
STILL_RATE = 0.05
"""Rate [rad/s] below which gyroscope and vehicle count as not turning. If the two signals are
compared with a time error of 0.2 s, the error of the angle is 0.6 deg.
"""
MIN_SPEED = 10.0
"""Speed [m/s] above which the lateral force is used to measure turning: a turn by 6 deg in 2 s
needs 0.5 m/s^2 at this speed."""


class Witness(Struct, frozen=True):
    """How far a signal that measures the turning of the vehicle may differ from the gyroscope.

    The angles that both have turned between two times are compared. least: smallest difference that
    shows that the sensor turned without the vehicle [rad]. gain_share: error of scale of the two
    signals, as a share of the angle that the vehicle has turned. This share is subtracted from the
    difference first.
    """

    least: float
    gain_share: float

    def with_gyro_errors(self, walk: float, zero_std: float = 0.0) -> Witness:
        """Return these limits for a gyroscope with errors of its own.

        walk: variance of the random walk of its angle per second [rad^2/s]. zero_std: deviation of
        its zero error [rad/s]. Both enlarge `least` by `DEVIATIONS` of their standard deviations.
        """
        seconds = APART * TICK_S
        own = DEVIATIONS * math.hypot(math.sqrt(walk * seconds), zero_std * seconds)
        return Witness(math.hypot(self.least, own), self.gain_share)


DEVIATIONS = 6.0
"""Number of standard deviations above which a rotation counts. The probability is 2e-9 for a normal
variable, two-sided."""
YAW_RATE = Witness(math.radians(3.0), 0.1)
"""Yaw rate of the vehicle. Offsets of 0.3 deg/s in both signals cause a difference of 1.2 deg in 2
s."""
FORCE = Witness(math.radians(6.0), 0.3)
"""Lateral force of the vehicle. A gust of 0.3 m/s^2 for 2 s causes a difference of 3.4 deg. Body
roll also causes a difference."""


class TurnedAlone:
    """Compares the angle turned by the gyroscope with the angle turned by the vehicle, also across
    the ends of blocks."""

    def __init__(self) -> None:
        self._before: Array = np.zeros((2, 0))
        self._zero = 0.0

    def restart(self) -> None:
        """Restart: later data are not compared with earlier data."""
        self._before = np.zeros((2, 0))

    def take_zero(self, zero: float) -> None:
        """Set the zero error [rad/s] that was subtracted from the gyroscope's rates of the next
        block. It is subtracted from the stored rates too, in place of the former zero error."""
        self._before[0] += self._zero - zero
        self._zero = zero

    def take_rates(
        self, turn_rate: Array, vehicle: Array, ok: Flags, by: Witness = YAW_RATE
    ) -> float:
        """Process a block (N,) [rad/s]. Returns the angle by which the sensor turned without the
        vehicle [rad], or 0.
        """
        found = self._alone(turn_rate, vehicle, ok, by)
        if found:
            self.restart()
        return found

    def _alone(self, turn_rate: Array, vehicle: Array, ok: Flags, by: Witness) -> float:
        known = self._before.shape[1]
        both = np.empty((2, known + len(ok)))
        both[:, :known], both[0, known:], both[1, known:] = self._before, turn_rate, vehicle
        if np.count_nonzero(ok) < len(ok):
            both = both[:, known + int(np.flatnonzero(~ok)[-1]) + 1 :]
        self._before = both[:, -APART:]
        if both.shape[1] <= APART:
            return 0.0
        sizes = np.abs(both)
        hardly = sizes < STILL_RATE
        still = hardly[0] & hardly[1]
        use = still[APART:] & still[:-APART]
        turned = (both[0] - both[1]).cumsum() * TICK_S
        alone = turned[APART:] - turned[:-APART]
        path = sizes[1].cumsum() * TICK_S
        excess = np.abs(alone) - by.gain_share * (path[APART:] - path[:-APART])
        excess[~use] = 0.0
        k = int(excess.argmax())
        if excess[k] < by.least:
            return 0.0
        own = float(both[0, k + 1 : k + APART + 1].sum()) * TICK_S
        if own * float(alone[k]) < 0.0 or abs(own) < by.least:  # the vehicle's signal is odd
            return 0.0
        return float(alone[k])


STANDING_TURN = math.radians(3.0)
"""Angle [rad] by which a standing vehicle cannot turn or tilt. People who get in tilt a vehicle by
half a degree.
"""
LEAST_RADIUS = 4.0
"""Smallest radius of the circle on which the middle of a car's rear axle drives [m]. Turning
circles are 10 to 11 m wide. A speed signal that begins at 3 km/h is still zero while a vehicle
creeps on this circle at 12 deg/s.
"""
STANDING_TICKS = 12
"""Number of standing ticks from which the tilt of a vehicle is known."""
REST_WINDOW = 32
"""Largest number of ticks for the mean of the present tilt. Motion at a speed below the smallest
speed of the signal is therefore included for a limited time only.
"""
LATE_TICKS = 28
"""Number of further standing ticks after which a standing tick is used. The accelerometer shows the
start of motion before the speed does.

The wait covers the longest delay of a speed (`MAX_SPEED_DELAY`, 1.8 s) and the time without pulses
of the wheel sensors (up to 1 m/s, `standstill`, at 1 m/s^2).
"""


YAW = 2


class HandMove(Struct, frozen=True):
    """A rotation by several degrees, found in its own block.

    axis: largest angle, 0 roll, 1 pitch, 2 yaw. size: this angle [rad]. deviations: this angle in
    standard deviations. is_felt: the gyroscope has measured at least half of the rotation. blocks:
    number of blocks since the rotation.
    """

    axis: int
    size: float
    deviations: float
    is_felt: bool = False
    blocks: int = 1


class HandMoves:
    """Detects a sensor that is turned by hand: while the vehicle stands, or alone while it
    drives."""

    def __init__(self) -> None:
        self._alone = TurnedAlone()
        self._forget_standing()

    def restart(self) -> None:
        """Restart: later data are not compared with earlier data."""
        self._alone.restart()
        self._forget_standing()

    def _forget_standing(self) -> None:
        """Forget the present stop, because the vehicle has moved or may have moved."""
        self._stopped_at: tuple[Array, Array] | None = None  # mean force (3,), its variance (3, 3)
        self._turned, self._felt = np.zeros(3), np.zeros(3)
        self._standing = np.zeros((0, 6))  # force and rate of ticks not looked at yet

    def while_driving(
        self, p: SignalBlock, R: Matrix3, turn_rate: Array, lateral: Array, has_yaw_rate: bool
    ) -> HandMove | None:
        """Return a rotation of the sensor without the vehicle.

        turn_rate: (N,) turn rate from the gyroscope [rad/s]. lateral: (N,) force to the left
        without gravity [m/s^2].
        """
        if has_yaw_rate:
            ok, vehicle, by = p.ok_yaw, p.yaw_rate, YAW_RATE
        else:
            ok = p.ok_force & p.ok_speed & (np.abs(p.speed) > MIN_SPEED)
            vehicle, by = lateral / np.where(ok, p.speed, 1.0), FORCE
        by = by.with_gyro_errors(float(R[2] @ p.rate_walk @ R[2]), p.turn_zero_std)
        self._alone.take_zero(float(R[2] @ p.gyro_bias))
        turned = self._alone.take_rates(turn_rate, vehicle, p.ok_rate & ok, by)
        if turned == 0.0:
            return None
        return HandMove(YAW, turned, turned / (by.least / DEVIATIONS))

    def while_standing(self, p: SignalBlock, R: Matrix3) -> HandMove | None:
        """Return a rotation or a tilt of the sensor while the vehicle stands."""
        rest = p.rest & p.ok_force
        first = 0
        if not rest.all():  # it has moved within the block: another stop, if any
            self._forget_standing()
            if not rest[-1]:
                return None
            first = int(np.flatnonzero(~rest)[-1]) + 1
        ticks = np.concatenate([p.force, p.rate * p.ok_rate[:, None]], axis=1)[first:]
        standing = np.concatenate([self._standing, ticks])
        known = len(standing) - LATE_TICKS
        if known < STANDING_TICKS:
            self._standing = standing
            return None
        self._standing = standing[known:]
        force, rate = standing[:known, :3], standing[:known, 3:]
        if self._stopped_at is None:
            self._stopped_at = _mean_force(force[:STANDING_TICKS])
        quick = np.abs(rate @ R[2]) > p.least_speed / LEAST_RADIUS
        self._turned += rate[quick].sum(axis=0) * TICK_S
        before, variance = self._stopped_at
        window = force[-REST_WINDOW:]
        now, own_variance = _mean_force(window)
        self._felt += rate.sum(axis=0) * TICK_S
        turned, felt = R @ self._turned, R @ self._felt
        self._turned *= 0.5  # a bias adds up, a turn is quick
        self._felt *= 0.5
        e = np.append(_tilt(before, now, R)[:YAW], turned[YAW])
        noise = np.sqrt(np.diag(R @ (variance + own_variance) @ R.T)[[1, 0]])
        limits = np.full(3, STANDING_TURN)
        limits[:YAW] += _hidden_force(p.least_speed, len(window)) / GRAVITY
        limits[:YAW] = np.hypot(limits[:YAW], DEVIATIONS * noise / GRAVITY)
        excess = np.abs(e) / limits
        axis = int(np.argmax(excess))
        if excess[axis] < 1.0:
            return None
        if axis != YAW:  # where it has come to by now
            e = _tilt(before, force[-STANDING_TICKS:].mean(axis=0), R)
        self._stopped_at, self._turned, self._felt = None, np.zeros(3), np.zeros(3)
        size, is_felt = float(e[axis]), abs(felt[axis] - e[axis]) < 0.5 * abs(e[axis])
        return HandMove(axis, size, size / float(limits[axis]) * DEVIATIONS, bool(is_felt))


def _tilt(before: Array, now: Array, R: Matrix3) -> Array:
    """Return the tilt of a sensor between two mean forces at rest: rotation vector (3,) in vehicle
    axes [rad].
    """
    size2 = float(np.linalg.norm(now) * np.linalg.norm(before))
    return np.asarray(R @ np.cross(now, before) / max(size2, 1e-9))


def _hidden_force(least: float, ticks: int) -> Array:
    """Return the hidden force across and along (2,) [m/s^2].

    The mean forces at the beginning and at the end of a stop may differ by this force. The cause is
    a vehicle that creeps at up to `least` [m/s] while its speed signal is zero.
    """
    along = 1.0 / STANDING_TICKS + 1.0 / ticks
    return np.array([2.0 * least * least / LEAST_RADIUS, least * along / TICK_S])


def _mean_force(force: Array) -> tuple[Array, Array]:
    """Return the mean of forces (n, 3) and the variance of the mean (3, 3).

    The variance is computed from differences between successive ticks. A tilt during these ticks
    hardly enlarges this variance.
    """
    steps = np.diff(force, axis=0)
    return force.mean(axis=0), 0.5 * (steps.T @ steps) / (len(steps) * len(force))
