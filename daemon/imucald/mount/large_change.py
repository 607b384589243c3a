"""Detect a large rotation of the sensor. The test runs in every block from the first minutes of a
drive.

`joint.moves` finds small changes, after enough road was driven to know the usual variation. A
rotation by several degrees is visible in single blocks, in three ways: the direction of gravity
without the motion, the direction in which the force responds to dv/dt and v r, and any rotation
while the vehicle stands. Each block of the last minutes is tried as the time of a
change: the mean before is compared with the mean after (a generalised likelihood ratio test;
Basseville and Nikiforov, Detection of Abrupt Changes, 1993, ch. 2.4). The road's slope is a Gauss-
Markov process over the distance driven, as in `evidence_gravity`. `block_sums` gives the yaw of a
single block. The spreads of tilt and yaw start at a prior and are then estimated.

`TurnedAlone` detects a sensor that turns about the vertical while the vehicle does not turn.

Two times are compared at which gyroscope and vehicle hardly turn. Between these times, gyroscope
and vehicle must have turned by the same angle, even if their signals have different delays. If the
gyroscope turned further, the sensor was moved by hand or by a knock. The turning of the vehicle is
measured by its yaw rate and, at speed, also by the force to the left (v r).

The angle of a gyroscope that sends seldom has a random walk (`gyro_walk`). For example, a phone
that shook in its holder, at five samples a second, seemed to turn by 29 deg within 2 s and had not
turned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.arrays import Array, Flags
from imucald.core.rotations import Matrix3, vector_from_rotation
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.alternatives import MAX_REVERSE
from imucald.mount.block_sums import BlockMotion, BlockSums, block_yaw
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.evidence_gravity import share_of_one_place
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
    """Properties of a signal that measures the turning of the vehicle.

    least: smallest rotation of the gyroscope alone that counts [rad]. gain_share: tolerated
    difference between gyroscope and vehicle, as a share of the angle turned between the two times.
    """

    least: float
    gain_share: float

    def beside(self, walk: float) -> Witness:
        """Return these properties for a gyroscope whose angle has a random walk.

        walk: variance of the random walk per second [rad^2/s]. The walk enlarges `least` by
        `DEVIATIONS` of its standard deviations.
        """
        own = DEVIATIONS * math.sqrt(walk * APART * TICK_S)
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

    def restart(self) -> None:
        """Restart: later data are not compared with earlier data."""
        self._before = np.zeros((2, 0))

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


REMEMBERED = 50
"""Number of blocks that are stored (320 s)."""
LEAST_BEFORE = (5, 5, 3)
"""Smallest number of blocks before a change of roll, pitch and yaw.

In yaw, few blocks are enough to show a change of `MIN_SIZE`.
"""
MOST_AFTER = 12
"""Largest number of blocks between a tested change and now (77 s)."""
LEAST_TICKS = 32
"""Smallest number of good ticks in a usable block: half of all ticks."""
TILT_NOISE = math.radians(0.5)
"""Deviation of a block's tilt from other causes than the road's slope: squat, gain errors, unknown
motion [rad]."""
PRIOR_BLOCKS = 10.0
"""Weight of the prior for the spread, in blocks."""
CLIP = 4.5
"""Limit, in standard deviations, on the contribution of one block to the spread in yaw: a single
bend may be unusual."""
LIMITS = (6.0, 6.0, 6.0)
"""Standard deviations above which a change in roll, pitch or yaw counts.

The probability of 6 standard deviations is 2e-9 for a normal variable, two-sided. This probability
gives one false alarm in 3,000 h: there are 560 blocks an hour and about twelve tests in each block,
of which two or three are independent.
"""
MIN_SIZE = (math.radians(6.0), math.radians(6.0), math.radians(2.5))
"""Smallest change in roll, pitch and yaw that this test reports [rad]. `joint.moves` finds smaller
changes.

Only on mountain roads (10 %) can the mean slope of half a minute differ this much from the mean
slope of the minutes before.
"""
AGREEING = 0.4
"""Share of a change that every block since the change must show. A single gust or a single bad road
is therefore not enough for a change.
"""
CLEAR, CLEAR_BLOCKS = 3.0, 2
"""Conditions for a change of yaw. A block is clear if the change is at least `CLEAR` standard
deviations of this block. At least `CLEAR_BLOCKS` blocks must be clear.
"""
STANDING_TURN = math.radians(3.0)
"""Angle [rad] by which a standing vehicle cannot turn or tilt. People who get in tilt a vehicle by
half a degree.
"""
BACKWARDS = math.radians(150.0)
"""Change of yaw [rad] above which a block is left out if no signal shows reverse and its speed is
possible in reverse: the vehicle may be driving backwards. A sensor is seldom turned by exactly half
a turn.
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


TILTS = (0, 1)
YAW, METRES, TILT_WEIGHT, YAW_WEIGHT = 2, 3, 4, 5
NO_ROWS: Array = np.zeros((0, 6))
"""Columns of each block: roll, pitch and yaw about R [rad], distance [m], weight of the tilt
(distance plus 3 m), weight of the yaw (information [1/rad^2]).
"""


class LargeChange(Struct, frozen=True):
    """A large change of one angle.

    axis: 0 roll, 1 pitch, 2 yaw. size: change [rad]. deviations: change in standard deviations.
    blocks: number of blocks since the change. is_felt: the gyroscope has measured at least half of
    the change.
    """

    axis: int
    size: float
    deviations: float
    blocks: int
    is_felt: bool = False


class LargeChangeDetector:
    """Tests the tilt and the yaw of blocks, relative to the present rotation."""

    def __init__(self, settings: EstimatorSettings) -> None:
        across, along = settings.unevenness
        self._slope = settings.slope_std * np.array([across, along])
        self._length = settings.slope_length
        self._alone = TurnedAlone()
        self.restart()

    def restart(self) -> None:
        """Restart: later data are not compared with earlier data."""
        self._alone.restart()
        self._rows = NO_ROWS
        self._R: Matrix3 | None = None
        self._forget_standing()

    def _forget_standing(self) -> None:
        """Forget the present stop, because the vehicle has moved or may have moved."""
        self._stopped_at: tuple[Array, Array] | None = None  # mean force (3,), its variance (3, 3)
        self._turned, self._felt = np.zeros(3), np.zeros(3)
        self._standing = np.zeros((0, 6))  # force and rate of ticks not looked at yet

    def take_block(
        self,
        sums: BlockSums,
        use: Flags,
        R: Matrix3,
        motion: BlockMotion,
        gains: tuple[float, float],
        has_speed: bool,
        has_reverse: bool,
    ) -> None:
        """Process a block and its motion.

        use: (N,) flags of the ticks that count. sums: sums over these ticks. R: present rotation.
        gains: gains of dv/dt and v r (speed times yaw rate). has_reverse: True if there is a
        reverse signal.
        """
        if self._R is not None and R is not self._R:
            moved = vector_from_rotation(R @ self._R.T)
            if math.sqrt(moved @ moved) > 0.35:
                self.restart()
            else:
                self._rows[:, :METRES] -= moved
        self._R = R
        n = sums.n
        if not has_speed or n < LEAST_TICKS:
            return
        u, v, w = (force / n for force in sums.force)
        x, y, z = (a * u + b * v + c * w for a, b, c in R.tolist())
        x -= gains[0] * sums.accel / n
        y -= gains[1] * sums.turn / n
        yaw, known = block_yaw(motion, use)
        if abs(yaw) > BACKWARDS and not has_reverse and sums.fastest < MAX_REVERSE:
            known = 0.0
        metres = sums.speed * TICK_S
        e = math.atan2(y, z), math.atan2(-x, math.hypot(y, z)), yaw
        row = [*e, metres, metres + 3.0, known]
        self._rows = np.concatenate([self._rows[1 - REMEMBERED :], [row]])

    def found(self, with_yaw: bool) -> LargeChange | None:
        """Return the most significant change above the limits, or None.

        with_yaw: test the yaw too.
        """
        rows = self._rows
        changes = [self._best(TILTS, rows[:, :YAW], rows[:, TILT_WEIGHT], range(len(rows)))]
        if with_yaw:
            at = (rows[:, YAW_WEIGHT] > 0.0).nonzero()[0]
            known = rows[at]
            changes.append(self._best((YAW,), known[:, YAW:METRES], known[:, YAW_WEIGHT], at))
        best: LargeChange | None = None
        excess = 1.0
        for change in changes:
            if change is not None and abs(change.deviations) / LIMITS[change.axis] > excess:
                best, excess = change, abs(change.deviations) / LIMITS[change.axis]
        return best

    def _tilt_variance(self, axis: int, blocks: int, metres: float) -> float:
        part = share_of_one_place(metres, self._length)
        return float(self._slope[axis] ** 2) * part + TILT_NOISE**2 / blocks

    def _best(
        self, axes: tuple[int, ...], e: Array, w: Array, at: Sequence[int] | NDArray[np.int64]
    ) -> LargeChange | None:
        """Return the best change of the given axes, or None.

        e: (n, axes) angles of the blocks [rad]. w: (n,) weights. at: (n,) positions of the blocks
        among all blocks.
        """
        n = len(e)
        best: LargeChange | None = None
        most = min(MOST_AFTER, n - LEAST_BEFORE[axes[0]])  # blocks after the change, from two on
        if most < 2:
            return None
        weights, sums = w[::-1].cumsum(), (w[:, None] * e)[::-1].cumsum(axis=0)
        new_w, new_e = weights[1:most], sums[1:most]
        old_w, old_e = weights[-1] - new_w, sums[-1] - new_e
        sizes = new_e / new_w[:, None] - old_e / old_w[:, None]
        if max(sizes.max(), -sizes.min()) < MIN_SIZE[axes[0]]:
            return None
        columns, times = np.nonzero(np.abs(sizes.T) >= MIN_SIZE[axes[0]])
        for column, j in zip(columns.tolist(), times.tolist(), strict=True):
            after, size = j + 2, float(sizes[j, column])
            k, one = n - after, e[:, column]
            wa, wb = float(new_w[j]), float(old_w[j])
            old = float(old_e[j, column]) / wb
            shown = (one[k:] - old) / size
            if axes[column] == YAW:
                shown = shown[w[k:] * (size * size) >= CLEAR * CLEAR]
            if len(shown) < CLEAR_BLOCKS or float(shown.min()) < AGREEING:
                continue
            left = one[:k] - old
            if axes[column] == YAW:
                spread = float(np.minimum(w[:k] * left * left, CLIP * CLIP).sum()) / k
                each, before = 1.0 / wa, 1.0 / wb
            else:
                metres, axis = self._rows[:, METRES], axes[column]
                usual = self._tilt_variance(axis, 1, float(metres[:k].mean()))
                spread = float(w[:k] @ (left * left)) / wb / usual
                each = self._tilt_variance(axis, after, float(metres[k:].sum()))
                before = self._tilt_variance(axis, k, float(metres[:k].sum()))
            scale = max((PRIOR_BLOCKS + k * spread) / (PRIOR_BLOCKS + k), 0.8)
            deviations = size / math.sqrt(scale * (each + before))
            if best is None or abs(deviations) > abs(best.deviations):
                best = LargeChange(axes[column], size, deviations, len(self._rows) - int(at[k]))
        return best

    def while_driving(
        self, p: SignalBlock, R: Matrix3, motion: BlockMotion, has_yaw_rate: bool
    ) -> LargeChange | None:
        """Return a rotation of the sensor without the vehicle."""
        if has_yaw_rate:
            ok, vehicle, by = p.ok_yaw, p.yaw_rate, YAW_RATE
        else:
            ok = p.ok_force & p.ok_speed & (np.abs(p.speed) > MIN_SPEED)
            vehicle, by = motion.force[:, 1] / np.where(ok, p.speed, 1.0), FORCE
        by = by.beside(float(R[2] @ p.rate_walk @ R[2]))
        turned = self._alone.take_rates(motion.turn_rate, vehicle, p.ok_rate & ok, by)
        if turned == 0.0:
            return None
        return LargeChange(2, turned, turned / (by.least / DEVIATIONS), 1)

    def while_standing(self, p: SignalBlock, R: Matrix3) -> LargeChange | None:
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
        return LargeChange(axis, size, size / float(limits[axis]) * DEVIATIONS, 1, bool(is_felt))


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
