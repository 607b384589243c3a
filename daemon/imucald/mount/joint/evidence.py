"""Collect the evidence of a drive, and solve for the unknowns.

The ticks are stored as received, in sensor axes. The windows are computed in the working axes when
a solution is due. If the axes have moved too far for a linear solution, all windows are computed
again from the stored ticks (Gauss-Newton method).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.config.base import MAX_SPEED_DELAY, MIN_SPEED_DELAY
from imucald.core.arrays import Array, Flags, inverse, solved
from imucald.core.rotations import (
    Matrix3,
    levelling_rotation,
    orthonormalised,
    rotation_from_angles,
    rotation_from_vector,
)
from imucald.core.samples import GRAVITY
from imucald.drive import equations as eq
from imucald.drive import windows as wd
from imucald.drive.roads import (
    SLOPE_M,
    Slopes,
    mean_slopes,
    road_slopes,
    road_weight,
    slope_way,
    without_bend,
)
from imucald.drive.speed_knots import known_rate, known_times, means_between
from imucald.drive.unknown_speed import FIRST_STD, UnknownSpeed
from imucald.drive.unknown_speed import NAMES as UNKNOWN_NAMES
from imucald.drive.vertical import CarriedVertical
from imucald.motion.standstill import DRIVING_SPEED
from imucald.motion.ticks import TICK_S
from imucald.mount.creep import Creep, SegmentSeries, creep
from imucald.mount.estimate import SentDeviations
from imucald.mount.estimator_settings import DelayPrior
from imucald.mount.even_signals import BLOCK_TICKS
from imucald.mount.joint.drift import NONE as NO_DRIFT
from imucald.mount.joint.drift import Drift, Drifts, ZeroDrift
from imucald.mount.joint.fusion import LinearMeasurement, any_sensor, contradiction, fuse, joined
from imucald.mount.joint.known import AS_BEFORE, PROBABLY_OTHER, KnownSensor
from imucald.mount.joint.moves import (
    LEAST_BEFORE,
    ROAD_TAIL,
    SPANS,
    EntryChange,
    Move,
    likeliest_move,
)
from imucald.mount.joint.response import SEGMENTS, Responses
from imucald.mount.joint.state import (
    CROWN,
    EPS,
    IN_BENDS,
    LAG,
    PHI,
    TURN,
    UNKNOWNS,
    ZERO,
    ZERO_VECTOR,
    OtherSignals,
    Priors,
    WeightedPrior,
    are_of_a_sensor,
    entry,
    level_row,
    own_matrices,
    own_terms,
    rate_entry,
    sent_deviations,
    sent_variance,
    without_gains,
    zero_row,
)
from imucald.mount.joint.sudden_changes import MOST_ONSETS, SuddenChange
from imucald.mount.joint.sums import Fits, WindowSums

Complex = NDArray[np.complex128]
Axes = tuple[Matrix3, Matrix3, Array]
"""Matrices from sensor axes to working axes for force and rate, and zero error of the force
[m/s^2].
"""

BLOCKS_A_WINDOW = wd.WINDOW // wd.BLOCK
BLOCKS_AT_ONCE = 16
"""Number of blocks whose windows are computed together. A larger number would need more memory and
would not be faster.
"""
MADE_AT_ONCE = 64
"""Number of windows that are computed again with each new block, if the evidence is long. The
computation takes 0.04 s on a busy core of 2026. The loop that corrects frames waits during this
time. Frames that wait for 0.1 s are not corrected.
"""
BACKWARD = 0.2
"""Share of backward driving from which the axes are turned round: distance backward minus distance
forward, divided by the whole distance.
"""
MOST_BLOCKS, KEPT_BLOCKS = 640, 480
"""Largest number of blocks, and number of blocks that are kept when the largest number is exceeded.
A long drive is therefore estimated from its last 50 to 70 minutes. More data do not reduce any
deviation.
"""
LEAST_USED, LEAST_MOVING = 0.5, 0.1
"""Smallest share of usable ticks in a window, and smallest share of driving ticks among the usable
ticks.
"""
MOST_LEFT = 0.01
"""Angle of a change of the axes [rad] from which the windows are computed again."""
MOST_LATE = 0.03
"""Change of the speed's delay [s] from which the windows are computed again."""
FAR = 0.4
"""Change of the speed's delay [s] from which the search is used in place of the fit.

The fit is linear in the delay, and its prior deviation of the delay is 0.15 s. The limit is between
two and three of these deviations.
"""
DELAY_STEP = 0.02
DELAYS: Final = np.arange(MIN_SPEED_DELAY, MAX_SPEED_DELAY + 0.001, DELAY_STEP)
REACH = 4.0
"""Largest distance of the delay from the mean of its prior, in deviations of the prior."""
LEAST_BANDS = 3
"""Smallest number of frequency bands that are used."""
USUAL_NOISE: Final = np.array(
    [
        [0.2, 0.4, 0.3, 0.2, 0.2, 0.2, 0.3, 0.4],
        [0.2, 0.5, 0.3, 0.25, 0.2, 0.15, 0.15, 0.15],
        [0.15, 0.4, 0.3, 0.3, 0.3, 0.3, 0.4, 0.7],
    ]
)
"""Expected noise for each axis of the force and each frequency band [(m/s^2)^2].

The values are rounded up from the means of eleven drives: three drives of second_world, two
measured drives, and the simulated drives with the seeds 970000 to 970005. These drives are
therefore not used to judge results.
"""
SQUAT = 0.006
"""Prior standard deviation of the response of the vertical force to d(v dv/dt)/dt [s^2/m].

A body pitches by k dv/dt. k is 2 to 3.5 deg/g, up to 0.006 (assumption, as for `PITCHES`). The
pitch changes the force along z in two ways. dv/dt is not along x any more: -k (dv/dt)^2. The
measured pitch rate contains the pitching, and -v q is subtracted: -k v d2v/dt2. The sum is
-k d(v dv/dt)/dt.
"""
NONE = 1e-5
"""Prior standard deviation of a response that does not exist."""
SPREAD: Final = np.array(
    [  # -vq, jerk, d(vr)/dt, dp/dt, dq/dt, dr/dt, r^2, v, tilted x, y, dv/dt v r, (v r)^2, d(va)
        [0.1, 0.15, LAG[0], 0.1, 1.5, 1.5, 3.0, 0.02, 0.03, 0.03, 0.01, IN_BENDS[0], NONE],
        [0.1, 0.05, LAG[1], 1.5, 0.1, 3.0, 1.5, 0.02, 0.03, 0.03, 0.01, IN_BENDS[1], NONE],
        [0.5, 0.05, LAG[2], 1.5, 3.0, 0.1, 0.1, 0.02, 0.03, 0.03, 0.02, IN_BENDS[2], SQUAT],
    ]
)
"""Prior standard deviations of the nuisance coefficients for each axis of the force.

Causes of the nuisances: curvature of the road, delay of the speed, lag of the body, lever arm [m],
zero error of the gyroscope, tilt of the gyroscope, even terms.
"""
TURN_SPREAD: Final = np.array([1.0, 0.02, 0.02, 0.3, 0.02, 0.003])
"""Prior standard deviations of the coefficients of roll rate and pitch rate: axis of turning,
rolling, pitching, dr/dt, lean in bends, lag of the rolling.

Bodies roll later than v r rises, because the springs are damped and the lateral velocity takes time
to build up. The last value is the rolling times a lag of 0.15 s (assumption).
"""
JERK: Final = len(wd.MAIN) + wd.EXTRA.index("jerk")
TURN_FITS: Final = Fits(
    tuple((wd.RATES.start + i, *wd.TURN_COLUMNS) for i in range(2)),
    np.full((2, wd.BANDS), 0.001),  # expected noise of roll rate and pitch rate [(rad/s)^2]
    np.tile(TURN_SPREAD, (2, 1)),
    keep=1,
)
ROLLS, PITCHES = 0.0075, 0.004
"""Roll angle per v r (speed times yaw rate), and pitch angle per dv/dt [rad/(m/s^2)], for a vehicle
without a gyroscope. These values are 4 to 6 deg/g for roll and 2 to 3 deg/g for pitch, from the
springs (assumption).
"""
ROLLING_SPREAD: Final = np.array([0.7, 1.5, 1.5])
"""Prior standard deviation of the response to dp/dt for each axis of the force, if the roll rate p
is computed without a gyroscope. The causes are the lever arm, and a yaw rate that is 0.1 s too
early or too late.
"""
SLOPE_NOISE: Final = np.array(
    [
        [6.0, 6.0, 2.0, 0.5, 0.1, 0.0, 0.0, 0.0],
        [8.0, 12.0, 4.0, 1.0, 0.3, 0.2, 0.3, 0.5],
        [1.5, 4.0, 2.5, 1.3, 0.7, 0.5, 0.6, 1.2],
    ]
)
"""Additional noise from slopes without a gyroscope, for each axis of the force and each frequency
band [(m/s^2)^2].

The values are medians of the simulated drives with the seeds 970000 to 970011. These drives are not
used to judge results.
"""
UNKNOWN: Final = range(len(wd.NAMES), len(wd.NAMES) + len(UNKNOWN_NAMES))
"""Indices of the columns that `unknown_speed` computes.

In a drive without a speed signal, these columns come after the columns of `windows`.
"""
UNKNOWN_NOISE: Final = np.array([0.15, 0.5, 0.4, 0.35, 0.2, 0.1, 0.05, 0.05])
"""Expected noise of the lateral force in each frequency band [(m/s^2)^2], for a drive without a
speed signal. The values are from the simulated drives with the seeds 9000 to 9007, rounded up.
"""
UNKNOWN_SPREAD: Final = np.array(
    [1.0, 1.0, 0.03, 0.03, 1.5, 3.0, 1.5, 0.02, 0.15, 0.01, 0.01, 1.5, 1.5, 0.03]
)
"""Prior standard deviations of the coefficients for a drive without a speed signal.

Order of the values: the cross-talk xy and yx, the nuisances as in `SPREAD`, the lever arm in f_x
[m], and the gain of the turn rate.
"""
STEERED_GAIN = 0.2
"""Prior standard deviation of the gain of a turn rate that is computed from a steering angle. The
cause is understeer (assumption).
"""


ANSWERS: Final = {
    (0, 1): "yaw_turn",
    (1, 0): "yaw_dvdt",
    (2, 0): "pitch_dvdt",
    (2, 1): "roll_turn",
    (0, 2): "pitch_axis",
    (1, 2): "roll_axis",
}
"""Name of the evidence for each response to motion, by axis and motion.

Motion 0 is dv/dt, motion 1 is v r (speed times yaw rate), and motion 2 is the turn rate r. The
force responds to motions 0 and 1. The measured roll rate and pitch rate respond to motion 2.
"""
Answered = tuple[tuple[tuple[int, tuple[int, int]], ...], ...]
WITH_SPEED: Final[Answered] = (
    ((1, (0, 1)),),
    ((0, (1, 0)),),
    ((0, (2, 0)), (1, (2, 1))),
)
"""Coefficients that are zero in the vehicle's axes, for each fit of the force: place in the fit,
axis and motion.
"""
WITHOUT_SPEED: Final[Answered] = (
    ((0, (0, 1)), (1, (1, 0))),
    ((0, (2, 0)), (1, (2, 1))),
)
"""Coefficients as in `WITH_SPEED` for a drive without a speed signal. The lateral force then gives
the responses to both motions.
"""
LEVELS: Final = ("pitch_gravity", "roll_gravity")
"""Names of the evidence from the horizontal force: pitch from the force along x, roll from the
force along y.
"""
NO_WALK: Final = np.zeros((3, 3))
NO_REST: Final = np.zeros(BLOCK_TICKS, dtype=bool)
LEVELLINGS = 3
"""Number of times that the first axes are levelled. A drive that begins in a long bend would
otherwise begin with axes that are 10 deg off.
"""
SIDE = 0.3
"""Smallest rms of the lateral force that follows the turn rate, as a share of the rms of the whole
horizontal force. Lateral means across the principal axis of the force.
"""
MIDDLES: Final = np.linspace(0.5, BLOCK_TICKS - 0.5, BLOCK_TICKS)
"""Middles of the ticks of a block [ticks of 0.1 s].

The speed is known at these times if every tick has a mean of the speed.
"""


class Block(NamedTuple):
    """Signals of a block of 64 ticks on an even time grid.

    force: (64, 3) [m/s^2], sensor axes. rate: (64, 3) [rad/s], sensor axes, after the zero error
    was subtracted. Without a gyroscope, the x and y components of the rate are zero, and the z
    component is the yaw rate of the vehicle.

    speed: (64,) [m/s], negative in reverse. Without a speed signal, an assumed speed shows only
    rest and the direction of the gear. use: (64,) flags of the usable ticks. is_rate_known: True if
    the zero error of the rate was measured. rate_zero: (3,) zero error that was subtracted from the
    rate [rad/s]. rate_walk: (3, 3) growth of the variance of an angle that is integrated from the
    rate [rad^2/s]. knots: (K,) times at which the speed is known [ticks since the start of the
    block]. least_speed: smallest speed that the speed signal shows [m/s]. rest: (64,) True while
    the vehicle is as still as a parked vehicle. turn_zero_std: deviation of `rate_zero` about the
    vertical [rad/s].
    """

    force: Array
    rate: Array
    speed: Array
    use: Flags
    is_rate_known: bool = True
    rate_zero: Array = ZERO_VECTOR
    rate_walk: Array = NO_WALK
    knots: Array = MIDDLES
    least_speed: float = 0.0
    rest: Flags = NO_REST
    turn_zero_std: float = 0.0


class Solution(NamedTuple):
    """Estimate at one time.

    force, rate: (3, 3) matrices W and V from sensor axes to vehicle axes. zero: (3,) zero error of
    the force in vehicle axes [m/s^2]; this error is subtracted. covariance: (UNKNOWNS, UNKNOWNS)
    covariance of the remaining errors. delay: delay of the speed [s]. unfinished: angle of the last
    change of the axes [rad]. housing: (3, 3) R_vehicle_from_sensor of the housing. turn: rotation
    of the gyroscope about z relative to the accelerometer [rad]. same: probability that sensor and
    mount have not changed since the last drive. contradiction: chi-square with three degrees of
    freedom of the mount against the mount of the last drive; None: there is no mount of a last
    drive. variance: (8,) variances of the sent data, see `state.sent_variance`.
    """

    force: Matrix3
    rate: Matrix3
    zero: Array
    covariance: Array
    delay: float
    unfinished: float
    housing: Matrix3
    turn: float
    same: float
    contradiction: float | None
    variance: Array

    @property
    def is_of_sensors(self) -> bool:
        """True if the gains of both matrices in all directions are possible for a sensor."""
        return are_of_a_sensor(self.force, self.rate)

    @property
    def bias(self) -> Array:
        """Zero error of the force (3,) in sensor axes [m/s^2]."""
        return inverse(self.force) @ self.zero

    def sensor(self, priors: Priors) -> KnownSensor:
        """Return the part of the solution that belongs to the sensor itself."""
        terms = own_terms(self.housing, self.force, self.rate, self.zero)
        terms[EPS][2] = self.turn
        return KnownSensor.found(self.housing, terms, self.covariance, priors)

    def sent(self, turned: Array = ZERO_VECTOR, zero: Array = ZERO_VECTOR) -> SentDeviations:
        """Return the deviations of the sent data.

        turned: (3,) variance of an additional rotation of both sensors [rad^2]. zero: (3,) variance
        of an additional change of the zero error [(m/s^2)^2].
        """
        return sent_deviations(self.variance, turned, zero)


class Evidence:
    """All blocks of a drive since the last move of the sensor, and their solution."""

    def __init__(
        self,
        priors: Priors,
        known: KnownSensor | None = None,
        is_moved: bool = False,
        past: Drift | None = None,
        signals: OtherSignals | None = None,
        late: DelayPrior | None = None,
        lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """known: earlier data of the sensor. is_moved: the sensor was moved after these data.

        past: an earlier drift, in sensor axes. late: prior of the delay of the speed. lever_arm:
        known vector from the body's centre of rotation to the sensor, vehicle axes [m].
        """
        self.signals = signals = signals or OtherSignals()
        self._past = past
        self._priors = priors
        self.known, self.is_moved = known, is_moved
        self._rotation = np.eye(3)  # of the housing, by which the working axes came about
        self._blocks: list[Block] = []
        self._breaks: set[int] = {0}
        self._axes: Axes | None = None
        self.rotation: Matrix3 | None = None
        """Approximate rotation (3, 3) from accelerometer to vehicle axes; None before there is
        evidence for this rotation.
        """
        self._taken = np.zeros(UNKNOWNS)
        self._late, self._lever_arm = late or DelayPrior(), lever_arm
        self.delay, self.delay_std = self._late.mean, math.inf
        self._later = 0.0  # change of the delay that the last fit asks for
        self.gains = (1.0, 1.0)
        """Gains of the force on dv/dt and v r (speed times yaw rate)."""
        self.variances: Mapping[str, float] = {}
        """Variance of the angle from each kind of evidence alone [rad^2]."""
        self._bands = np.ones(wd.BANDS, dtype=bool)
        self.solution: Solution | None = None
        self._due = 0
        self._sums = WindowSums(force_fits(signals), TURN_FITS)
        self._answered = WITH_SPEED if signals.speed else WITHOUT_SPEED
        slopes = priors.slope, priors.crown[0]
        self._unknown = UnknownSpeed(*slopes, is_carried=signals.gyro, steered=signals.steered)
        self._levels: Array = np.zeros((0, 6))
        self._roads: dict[int, Slopes] = {}  # by number of blocks
        self._done = self._followed = 0
        self._drift, self._found_drift = ZeroDrift(), NO_DRIFT
        self._drift_axes: Axes = np.eye(3), np.eye(3), ZERO_VECTOR
        self._drift_delay = math.inf
        self._reset_windows()

    @property
    def drift(self) -> Drift:
        """Estimate of a drift of the force's zero error from the stored blocks."""
        if self._axes is None or not self._follows_drift:
            return NO_DRIFT
        self._follow_drift()  # it can't wait until a solution is due
        if self._is_up_to(self._followed):
            found = self._drift.found()
            self._found_drift = found.turned(self._axes[0] @ inverse(self._drift_axes[0]))
        return self._found_drift

    def sudden_change(self) -> SuddenChange | None:
        """Return the most likely sudden change in the last minute. If the cause of an earlier
        change is still open, this change is included too.

        Returns None if the signals do not allow the test, or before the filter has taken all
        blocks.
        """
        if self._axes is None or not self._follows_drift:
            return None
        self._follow_drift()
        return self._drift.sudden_change() if self._is_up_to(self._followed) else None

    @property
    def watch_axes(self) -> Matrix3:
        """Matrix (3, 3) from sensor axes to the axes of `sudden_change`."""
        return self._drift_axes[0]

    @property
    def _follows_drift(self) -> bool:
        """True if there are a gyroscope and a speed. Both signals are needed to separate a zero
        error from a slope.
        """
        return self.signals.gyro and self.signals.speed

    def in_sensor_axes(self, drift: Drift) -> Drift:
        """Return `drift` in sensor axes.

        Before the working axes are known, return the drift that was known before the first block.
        """
        if self._axes is None:
            return self._past or NO_DRIFT
        return drift.turned(inverse(self._axes[0]))

    @property
    def is_delay_beyond(self) -> bool:
        """True if the best delay is the largest delay of the search, and the prior of the delay
        also allows larger delays.
        """
        is_largest = math.isfinite(self.delay_std) and self.delay >= MAX_SPEED_DELAY - DELAY_STEP
        return (
            is_largest and self._late.mean + REACH * self._late.std > MAX_SPEED_DELAY + DELAY_STEP
        )

    def leave_mount(self) -> None:
        """Use the earlier data of the sensor for another mount, from the next solution on."""
        self.is_moved, self._due = True, 0

    @property
    def segment(self) -> int:
        """Number of whole road segments of driving."""
        return len(self._sums) // SEGMENTS[0]

    @property
    def bias(self) -> Array:
        """Present estimate of the accelerometer's zero error (3,) in sensor axes [m/s^2]."""
        return ZERO_VECTOR if self.solution is None else self.solution.bias

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self._blocks)

    @property
    def seconds(self) -> float:
        """Length of the evidence [s]."""
        return len(self._blocks) * BLOCK_TICKS * TICK_S

    def gap(self) -> None:
        """Note a jump of time. Later blocks are not joined with earlier blocks."""
        self._breaks.add(len(self._blocks))

    def add_block(self, block: Block) -> None:
        """Process the next block."""
        self._blocks.append(block)
        if len(self._blocks) > MOST_BLOCKS:
            self._forget(len(self._blocks) - KEPT_BLOCKS)

    def subtract_rate_zero(self, zero: Array, std: float = 0.0) -> None:
        """Subtract the measured zero error (3,) of the rate [rad/s] from the blocks before the
        measurement.

        A guess of the zero error was subtracted from these blocks. The measured value replaces the
        guess. std: deviation of the value about the vertical [rad/s].
        """
        self._blocks = [
            b
            if b.is_rate_known
            else b._replace(
                rate=b.rate + b.rate_zero - zero,
                is_rate_known=True,
                rate_zero=zero,
                turn_zero_std=std,
            )
            for b in self._blocks
        ]
        if self._axes is not None:
            self._drift_delay = math.inf  # it begins again as well
            self._rework(*self._axes)

    def _forget(self, count: int) -> None:
        """Delete the first blocks, because the solution covers only the last hour. count: number of
        blocks to delete.
        """
        if self._axes is not None:
            self._extend()
            if self._follows_drift:
                self._follow_drift()
        del self._blocks[:count]
        self._due = 0
        self._breaks = {0} | {k - count for k in self._breaks if k > count}
        self._sums.forget(count)
        self._levels = self._levels[count:]
        self._roads.clear()
        self._done = max(self._done - count, 0)
        self._followed = max(self._followed - count, 0)

    def _reset_windows(self) -> None:
        self._vertical = CarriedVertical()
        self._unknown.restart()
        self._tail: tuple[Array, Flags, Array, Array] | None = None
        self._sums.restart()
        self._levels = np.zeros((0, 6))
        self._roads.clear()
        self._done = 0

    def _reset_drift(self) -> None:
        """Restart the drift filter if the axes, or the delay of the speed, have changed too much
        for the filter.
        """
        assert self._axes is not None
        if not self._follows_drift:
            return
        W, V, _ = self._axes
        pairs = zip((W, V), self._drift_axes[:2], strict=True)
        moved = max(float(np.abs(new @ inverse(old) - np.eye(3)).max()) for new, old in pairs)
        if moved < Drifts().tilt and abs(self.delay - self._drift_delay) < MOST_LATE:
            return
        self._drift = ZeroDrift(None if self._past is None else self._past.turned(W))
        self._drift_axes, self._drift_delay, self._followed = self._axes, self.delay, 0

    # windows -------------------------------------------------------------------------------------

    def _extend(self) -> None:
        """Compute the windows of the new blocks. The last block is left out until its next speed is
        known.
        """
        for first, stop in self._joined_since(self._done):
            if first in self._breaks:
                self._vertical.restart()
                self._unknown.restart(is_same_drive=first > 0)
                self._tail = None
            self._take(first, stop)
            self._done = stop

    def _joined_since(self, first: int) -> Iterator[tuple[int, int]]:
        """Yield groups of joined blocks. The groups start at the block `first`. Each group is a
        pair: index of the first block, and index after the last block.

        All groups together contain at most `MADE_AT_ONCE` blocks, or a quarter of this number
        without a speed signal.
        """
        most = MADE_AT_ONCE if self.signals.speed else MADE_AT_ONCE // 4  # slower by so much
        end = min(len(self._blocks) - 1, first + most)
        while first < end:
            stop = min([end, first + BLOCKS_AT_ONCE, *(k for k in self._breaks if k > first)])
            yield first, stop
            first = stop

    def _is_up_to(self, made: int) -> bool:
        """True if all complete blocks have been processed. made: number of processed blocks."""
        return made >= len(self._blocks) - 1

    def _follow_drift(self) -> None:
        """Give the new blocks to the filter that tests for a drift of the zero error."""
        V, slopes = self._drift_axes[1], self._slopes(MOST_ONSETS).density
        for first, stop in self._joined_since(self._followed):
            if first in self._breaks:
                self._drift.restart()
            moved = self._motion(first, stop, self._drift_delay)
            force, rate, speed, accel, motion = self._in_axes(first, stop, self._drift_axes, moved)
            left = force - motion
            for k, b in enumerate(self._blocks[first:stop]):
                part = slice(k * wd.BLOCK, (k + 1) * wd.BLOCK)
                ticks = left[part], rate[part], speed[part], accel[part]
                self._drift.add_block(*ticks, b.use, V @ b.rate_zero, V @ b.rate_walk @ V.T, slopes)
            self._followed = stop

    def _in_axes(
        self, first: int, stop: int, axes: Axes, moved: tuple[Array, Array]
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return force (N, 3), rate (N, 3), speed (N,), dv/dt (N,) and the motion's part of the
        force (N, 3) for the ticks of joined blocks. All vectors are in `axes`.
        """
        W, V, zero = axes
        run = self._blocks[first:stop]
        speed, accel = moved
        force = np.concatenate([b.force for b in run]) @ W.T - zero
        if self.signals.gyro:
            rate = np.concatenate([b.rate for b in run]) @ V.T
        else:
            rate = np.zeros((len(force), 3))
            rate[:, 2] = self._in_time(first, stop, lambda b: b.rate[:, 2], self.signals.late)
            rate[:, :2] = _leaning(speed * rate[:, 2], accel)
        if any(self._lever_arm):
            turning = np.gradient(rate, TICK_S, axis=0)
            force -= np.column_stack(eq.of_lever(_axes(rate), _axes(turning), self._lever_arm))
        return force, rate, speed, accel, eq.of_motion(accel, speed, rate)

    def _take(self, first: int, stop: int) -> None:
        """Compute the windows whose last blocks are the blocks `first` to `stop` - 1."""
        assert self._axes is not None
        use = np.concatenate([b.use for b in self._blocks[first:stop]])
        if self.signals.speed:
            moved = self._motion(first, stop, self.delay)
            force, rate, speed, accel, motion = self._in_axes(first, stop, self._axes, moved)
            level, more = force - motion, np.zeros((len(use), 0))
        else:
            force, rate, speed, accel, level, more = self._eliminated(first, stop, use)
            motion = eq.of_motion(accel, speed, rate)
        if self.signals.gyro:
            up, tilts = self._vertical.block(rate, (force - motion) / GRAVITY, use)
        else:
            up, tilts = np.tile([0.0, 0.0, 1.0], (len(use), 1)), np.zeros((len(use), 3, 3))
        x = np.hstack([wd.columns(force, rate, speed, accel, up, tilts), more])
        v = speed
        if not self.signals.speed:  # what the vehicle shows of it: rest, and the gear
            v = np.concatenate([b.speed for b in self._blocks[first:stop]])
        self._level_from(level, speed, np.copysign(speed, speed * v), use)
        knots = self._knots_of(self._blocks[first:stop])
        if self._tail is not None:
            x, use, v, knots = (
                np.concatenate(part)
                for part in zip(self._tail, (x, use, v, knots + len(self._tail[0])), strict=True)
            )
        kept = (BLOCKS_A_WINDOW - 1) * wd.BLOCK
        gone = max(len(x) - kept, 0)
        self._tail = x[gone:], use[gone:], v[gone:], knots[knots > gone] - gone
        if len(x) < wd.WINDOW:
            return
        in_use, at = _by_window(use), _by_window(v)
        used = in_use.sum(axis=1)
        moving = (in_use & (np.abs(at) > DRIVING_SPEED)).sum(axis=1)
        good = (used >= LEAST_USED * wd.WINDOW) & (moving >= LEAST_MOVING * used)
        if good.any():
            known = known_times(knots, v, self._blocks[stop - 1].least_speed)
            x = means_between(x, known, use)
            windows = _by_window(x)[good]
            rate = wd.mean_by_power(_by_window(known_rate(known, len(x)))[good], windows)
            ends = np.arange(stop - len(good), stop)[good]
            self._sums.add_spectra(wd.spectra(windows, in_use[good]), ends, rate)

    def _eliminated(
        self, first: int, stop: int, use: Flags
    ) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Return the signals of joined blocks for a drive without a speed signal.

        The results are force (N, 3), rate (N, 3), speed (N,), dv/dt (N,), the horizontal force
        without the motion (N, 2), and the columns of `unknown_speed` (N, columns).
        """
        assert self._axes is not None
        still = np.zeros(len(use)), np.zeros(len(use))
        force, rate, *_ = self._in_axes(first, stop, self._axes, still)
        rest = np.concatenate([b.rest for b in self._blocks[first:stop]])
        found = self._unknown.follow(force, rate, rest, use)
        if not self.signals.gyro:
            rate[:, 2] = found.turn
            rate[:, :2] = _leaning(found.speed * found.turn, found.accel)
        return force, rate, found.speed, found.accel, found.left, found.columns

    def _knots_of(self, run: list[Block]) -> Array:
        """Return the times at which the speed of joined blocks is known [ticks since the start of
        the first block].
        """
        parts = [b.knots + k * wd.BLOCK for k, b in enumerate(run)]
        return np.concatenate(parts) - self.delay / TICK_S

    def _motion(self, first: int, stop: int, delay: float) -> tuple[Array, Array]:
        """Return the speed and its derivative in the ticks of joined blocks. delay: delay of the
        speed [s].
        """
        early, late = (
            self._in_time(first, stop, lambda b: b.speed, delay, 0.5 * part) for part in (-1.0, 1.0)
        )
        return 0.5 * (early + late), (late - early) / TICK_S

    def _in_time(
        self, first: int, stop: int, of: Callable[[Block], Array], delay: float, later: float = 0.0
    ) -> Array:
        """Return a signal (N,) of joined blocks after correction of its delay.

        of: function that returns the signal of a block. delay: delay of the signal [s]. later:
        further shift towards later samples [ticks of 0.1 s].
        """
        before = first - 1 if first not in self._breaks else first
        after = stop + 1 if stop < len(self._blocks) and stop not in self._breaks else stop
        series = np.concatenate([of(b) for b in self._blocks[before:after]])
        at = np.arange(len(series)) - (first - before) * wd.BLOCK
        t = np.arange((stop - first) * wd.BLOCK) + delay / TICK_S + later
        return np.asarray(np.interp(t, at, series), dtype=float)

    def _level_from(self, left: Array, speed: Array, ahead: Array, use: Flags) -> None:
        """Add one row of sums for each block, from which the mean of the horizontal gravity is
        computed.

        The weight of a tick is the distance driven in the tick, reduced at high speed
        (`drive.roads`). left: (N, 3) or (N, 2) force minus the motion's part [m/s^2].
        speed: (N,) [m/s]. ahead: (N,) speed along the direction of travel that the gear shows
        [m/s].
        """
        passed, weight = slope_way(speed) * use * TICK_S, road_weight(speed, use)
        square = weight * np.square(speed)
        rows = np.column_stack([weight[:, None] * left[:, :2], weight, passed, square, ahead * use])
        blocks = rows.reshape(-1, wd.BLOCK, 6).sum(axis=1)
        self._levels = np.concatenate([self._levels, blocks])

    def _slopes(self, last: int = 0) -> Slopes:
        """Return the slopes of the roads. last: number of last blocks that are left out."""
        count = max(len(self._levels) - last, 0)
        if count not in self._roads:
            levels = self._levels[:count, :4] / [GRAVITY, GRAVITY, 1.0, 1.0]
            self._roads[count] = road_slopes(levels, self._priors.slope)
        return self._roads[count]

    # solving -------------------------------------------------------------------------------------

    def start_from(self, R_vehicle_from_sensor: Matrix3) -> None:
        """Use a rotation (3, 3) as the working axes of both sensors."""
        self._rotation = R_vehicle_from_sensor
        self._rework(R_vehicle_from_sensor, R_vehicle_from_sensor.copy(), np.zeros(3))

    def solve_when_due(self) -> None:
        """Solve after each block at first. Later, solve when the evidence has grown by 5 %."""
        if len(self._blocks) >= self._due:
            self.solve()
            pause = len(self._blocks) // 20 if self._is_up_to(self._done) else 0
            self._due = len(self._blocks) + 1 + pause

    def solve(self) -> Solution | None:
        """Return the solution from all evidence. If there is too little evidence, return the
        previous solution; None if there was none.

        If the evidence is long, one call computes only some of the windows again, and the next
        calls continue.

        Raises LinAlgError if no sensor can produce these signals.
        """
        if self._axes is None and not self._find_first_axes():
            return self.solution
        self._extend()
        if not self.signals.speed and self._is_up_to(self._done) and self._drives_backward():
            self._turn_round()
        for _ in range(3):
            if len(self._sums) < (2 if self.known is None else 1):
                break
            if self._is_up_to(self._done) and self.signals.speed:
                self._look_for_delay()
            if not self._is_up_to(self._done):
                break
            found = self._solve_once()
            if not found.is_of_sensors:  # contradicting signals: each step leads further away
                raise np.linalg.LinAlgError("no sensor could have these matrices")
            self.solution = found
            if found.unfinished < MOST_LEFT and abs(self._later) < MOST_LATE:
                break
            self.delay += self._later
            self._rotation = found.housing
            self._rework(found.force, found.rate, found.zero)
        return self.solution

    @property
    def known_sensor(self) -> KnownSensor | None:
        """Data of the sensor that stay valid after a move of the sensor or a restart of the
        process.
        """
        return self.known if self.solution is None else self.solution.sensor(self._priors)

    def _hypotheses(self) -> list[WeightedPrior]:
        if self.known is None:
            return any_sensor(self._priors)
        known = self.known.hypotheses(self._rotation, self._priors, self.is_moved)
        return [*known, *any_sensor(self._priors, PROBABLY_OTHER)]

    def _rework(self, force: Matrix3, rate: Matrix3, zero: Array) -> None:
        self._axes, self.rotation = (force, rate, zero), orthonormalised(force)
        self._taken = own_terms(self._rotation, force, rate, zero)
        self._reset_windows()
        self._reset_drift()
        self._extend()

    def _find_first_axes(self) -> bool:
        """Find the first working axes. Returns False if the evidence is not sufficient.

        The up direction is the direction of mean gravity: of the mean force minus the mean of the
        motion's part. The forward direction is found by complex least squares of the horizontal
        force on dv/dt + i v r (speed times yaw rate). Each direction needs the other one, so both
        are found in turn.
        """
        if len(self._blocks) < BLOCKS_A_WINDOW:
            return False
        blocks = self._blocks[:-1]
        motion = [self._motion(k, k + 1, self.delay) for k in range(len(blocks))]
        use = np.concatenate([b.use for b in blocks])
        force = np.concatenate([b.force for b in blocks])
        rate = np.concatenate([b.rate for b in blocks])
        v, a = (np.concatenate(part) for part in zip(*motion, strict=True))
        if use.sum() < BLOCK_TICKS or (np.abs(v) > DRIVING_SPEED).sum() < BLOCK_TICKS:
            return False
        up, kernel = force[use].mean(axis=0), np.ones(10) / 10.0

        def smooth(x: Array) -> Array:
            return np.asarray(np.convolve(np.where(use, x, 0.0), kernel, "same"))

        changes = smooth(a)
        R, moved = np.eye(3), ZERO_VECTOR  # mean of the motion's part of the force, sensor axes
        for _ in range(LEVELLINGS):
            level_from_sensor = levelling_rotation(up - moved)
            turning = rate @ level_from_sensor[2] if self.signals.gyro else rate[:, 2]
            ahead, left, _ = level_from_sensor @ force.T
            m = changes + 1j * smooth(v * turning)
            level = smooth(ahead) + 1j * smooth(left)
            level, varied = (level - level[use].mean())[use], (m - m[use].mean())[use]
            if not self.signals.speed:
                return self._find_principal_axes(level, varied.imag, level_from_sensor)
            answer = np.vdot(varied, level)
            size = np.sqrt(np.vdot(varied, varied).real * np.vdot(level, level).real)
            if abs(answer) < 0.4 * size:
                return False
            yaw = -math.atan2(answer.imag, answer.real)
            R = rotation_from_angles(0.0, 0.0, yaw) @ level_from_sensor
            moved = R.T @ np.array([a[use].mean(), (v * turning)[use].mean(), 0.0])
        self.start_from(R)
        return True

    def _find_principal_axes(self, level: Complex, turn: Array, R: Matrix3) -> bool:
        """Find the first working axes without a speed. Returns False if the evidence is not
        sufficient.

        The part of the horizontal force that is proportional to the turn rate is subtracted.
        Forward is the principal axis of the remaining force. Left is the side to which the force of
        left bends points.

        level: (N,) force ahead and force to the left as a complex number, in axes R (3, 3). turn:
        (N,) turn rate, in any unit.
        """
        power, size = float(turn @ turn), float(np.vdot(level, level).real)
        if not (power > 0.0 and size > 0.0):
            return False
        answer = complex(level @ turn) / power
        along = np.sqrt(complex(np.square(level - answer * turn).sum()))
        across = (answer / 1j * along.conjugate()).real  # left of `along`, where bends point
        if abs(across) * math.sqrt(power / size) < SIDE * abs(along):
            return False
        yaw = -math.atan2(along.imag, along.real) + (math.pi if across < 0.0 else 0.0)
        self.start_from(rotation_from_angles(0.0, 0.0, yaw) @ R)
        return True

    def _drives_backward(self) -> bool:
        """True if the vehicle drives mostly backward according to the gear. While the vehicle
        stands, the small distances in the sums are noise.
        """
        way = self._levels[:, 5]
        return bool(way.sum() < -BACKWARD * np.abs(way).sum())

    def _turn_round(self) -> None:
        """Turn the axes round by 180 deg, because vehicles drive forward more than backward.

        Driving backward gives the same forces and turn rates as driving forward with the sensor
        turned by 180 deg.
        """
        assert self._axes is not None
        W, V, zero = self._axes
        round_up = np.diag([-1.0, -1.0, 1.0])
        self._rotation = round_up @ self._rotation
        self._rework(round_up @ W, round_up @ V, round_up @ zero)

    def _look_for_delay(self) -> None:
        """Search the delay of the speed for which the force fits dv/dt best, before `_refine_delay`
        can compute it. Also find the frequency bands in which dv/dt is known.
        """
        cross = self._sums.weigh_spectra()
        grid = DELAYS - self.delay
        noise = self._sums.force.noise[0]
        fit = (np.exp(-1j * np.outer(grid, wd.OMEGA)) @ (cross / noise[wd.BAND])).real
        fit[np.abs(DELAYS - self._late.mean) > REACH * self._late.std] = -math.inf
        best = float(grid[np.argmax(fit)])
        self._bands = np.arange(wd.BANDS) < max(self._sums.bands_with_speed, LEAST_BANDS)
        limit = MOST_LATE if self.solution is None else FAR
        if abs(best) > limit and self._axes is not None:
            self.delay += best
            self._rework(*self._axes)

    def _solve_once(self) -> Solution:
        assert self._axes is not None
        priors = self._priors
        has_gyro = self.signals.gyro
        answers = self._sums.force.respond(self._bands)
        if self.signals.speed:
            self._refine_delay(answers)
        h = answers.value
        gain = np.maximum(np.diag(h[:2]), 0.3) if self.signals.speed else np.ones(2)
        self.gains = float(gain[0]), float(gain[1])
        measured: list[LinearMeasurement] = []
        variances: dict[str, float] = {}
        for k, answered in enumerate(self._answered):
            places = [place for place, _ in answered]
            rows = np.array([self._answer_row(i, j) for _, (i, j) in answered])
            C = answers.covariance[k][np.ix_(places, places)]
            value = h[k, places]
            for m, (place, (i, j)) in enumerate(answered):
                C[m, m] += self._left_out(i, j)
                if (i, j) == (2, 0) and not has_gyro:
                    # nor has the pitching itself been subtracted (assumption)
                    C[m, m] += priors.pitching**2
                if (i, j) == (2, 1) and not has_gyro:  # -v q of bends that lean is in it
                    rows[m, CROWN] = -1.0
                    value[m] += priors.crown[0] * gain[1]
                    leaning = _over_segments(self._slopes(), answers.segments[k])
                    C[m, m] += priors.turning[1] ** 2 + leaning[place, 1]
            scale = gain[[j for _, (_, j) in answered]]
            C = C / np.outer(scale, scale)
            measured.append(LinearMeasurement(rows, value / scale, C))
            variances |= {ANSWERS[at]: float(C[m, m]) for m, (_, at) in enumerate(answered)}
        level, lean = self._level_measured()
        variances |= {k: float(m.covariance[0, 0]) for k, m in zip(LEVELS, level, strict=True)}
        if has_gyro:
            turning, of_bends = self._turning_measured()
            variances |= {ANSWERS[i, 2]: float(m.covariance[0, 0]) for i, m in enumerate(turning)}
            shared = np.minimum(lean, of_bends)  # the roads of the bends are a part of all roads
            level = [joined(*pair) for pair in zip(level, turning, shared, strict=True)]
        measured += level
        if self._follows_drift:
            measured.append(self._vertical_measured())
        self.variances = variances
        hypotheses = self._hypotheses()
        theta, covariance, shares = fuse(hypotheses, measured, self._taken)
        same, against = 0.0, None
        if self.known is not None and not self.is_moved:
            same = float(shares[AS_BEFORE])
            against = contradiction(hypotheses[AS_BEFORE], measured, self._taken)
        return self._applied(theta, covariance, same, against)

    def _refine_delay(self, answers: Responses) -> None:
        """Compute the remaining error of the delay and its deviation, from the response of the
        forward force to the jerk.

        The phase between force and dv/dt is not used: if the speed has few samples, this phase is
        wrong at frequencies above half of the sample rate.
        """
        prior, variance = self._late.std**2, float(answers.model[0, JERK])
        variance *= float(answers.covariance[0, 0, 0] / answers.model[0, 0])
        # the prior of the response is in it: it is replaced by the prior of the delay
        variance = 1.0 / max(1.0 / variance - 1.0 / SPREAD[0, JERK - len(wd.MAIN)] ** 2, 1e-6)
        mean, reach = self._late.mean, REACH * self._late.std
        share = prior / (prior + variance)
        found = self.delay - float(answers.vector[0, 1 + JERK])
        low, high = max(mean - reach, MIN_SPEED_DELAY), min(mean + reach, MAX_SPEED_DELAY)
        self._later = min(max(share * found + (1.0 - share) * mean, low), high) - self.delay
        self.delay_std = math.sqrt(share * variance)

    def _answer_row(self, i: int, j: int) -> Array:
        """Return the row (UNKNOWNS,) for the response of the force's axis i to dv/dt (j = 0) or v r
        (speed times yaw rate) (j = 1).
        """
        row = entry(i, j)
        if i < 2:
            row[[PHI.start + 2, EPS.start + 2]] -= self._sums.leak[i, j]
        elif j == 1 and self.signals.gyro:  # -v q of a tilted rate has been subtracted
            row += rate_entry(1, 2)
        return row

    @property
    def has_fitted(self) -> bool:
        """True if the solution was computed from at least most of the present windows."""
        is_enough = len(self._sums) >= SEGMENTS[0]
        return is_enough and self.solution is not None and self._sums.has_fitted(self.signals.gyro)

    def move(self) -> Move | None:
        """Return the most likely rotation of the sensor in the last minutes.

        Returns None if there is too little evidence.
        """
        if not self.has_fitted:
            return None
        self._extend()
        spans = SPANS[self.segment - LEAST_BEFORE >= SPANS]
        if not len(spans):
            return None
        entries = [*self._answers_changed(spans), *self._levels_changed(spans)]
        return likeliest_move(entries, (len(self._blocks) - self._sums.began(spans)).tolist())

    def _answers_changed(self, spans: NDArray[np.int_]) -> Iterator[EntryChange]:
        """Yield the changes of the responses to motion. spans: numbers of last road segments, each
        compared with all earlier segments.
        """
        priors, force, turning = self._priors, self._sums.force, self._sums.turning
        size, variance = force.changes(force.by_segment(True, is_weighted=False), spans)
        for k, answered in enumerate(self._answered):
            for place, (i, j) in answered:
                own = variance[k, :, place] + self._left_out(i, j)
                yield EntryChange(self._answer_row(i, j)[PHI], size[k, :, place], own)
        if not self.signals.gyro:
            return
        size, variance = turning.changes(turning.by_segment(True, is_weighted=False), spans)
        roads = _over_segments(self._slopes(MOST_ONSETS), spans)
        for i in range(2):
            own = variance[i, :, 0] + priors.turning[i] ** 2 + roads[:, i]
            yield EntryChange(rate_entry(i, 2)[PHI], size[i, :, 0], own, ROAD_TAIL)

    def creep(self, chance: float, shifts: int) -> Creep | None:
        """Test whether the mount creeps, see `creep.creep`. Returns None if there is too little
        evidence.
        """
        if not self.has_fitted:
            return None
        return creep(self._series(), chance, shifts)

    def _series(self) -> list[SegmentSeries]:
        """Return the evidence about the rotation relative to the working axes, by road segment.

        The axis of turning and the horizontal force along the vehicle are left out: they differ too
        much between town and motorway to separate creep from the road.
        """
        made, sums = [], self._sums
        force = sums.force.scores(sums.force.by_segment())
        shown = [(force, k, *one) for k, answered in enumerate(self._answered) for one in answered]
        if self.signals.gyro:
            turning = sums.turning.scores(sums.turning.by_segment())
            shown.append((turning, 1, 0, (1, 2)))
        for fit, k, place, (i, j) in shown:
            name = ANSWERS[i, j]
            scores, known = (part[k, :, place] for part in fit)
            part = 1.0 / (1.0 + known * self._left_out(i, j))
            score = -TURN[i, j][1] * part * scores  # the axes turn against the answer
            made.append(SegmentSeries(name, score, part * known, self.variances[name]))
        _, across, weight, metres = self._levels_by_segment().T
        known = (weight > 0.0) / self._slopes().over(metres)[:, 1]
        angle = -TURN[1, 2][1] * across / np.maximum(weight, 1e-9)
        left = known * (angle - float(known @ angle) / float(known.sum()))
        return [*made, SegmentSeries(LEVELS[1], left, known, self.variances[LEVELS[1]])]

    def _left_out(self, i: int, j: int) -> float:
        """Return the variance of a response to motion that comes from effects without a term in the
        equations. i: axis. j: motion, as in `ANSWERS`.
        """
        priors = self._priors
        if j == 2:
            return priors.turning[i] ** 2
        more = {(0, 1): priors.sideslip, (2, 0): priors.pitching}
        if not self.signals.speed:
            xy = priors.eliminated[0] if self.signals.gyro else priors.uncarried
            more |= {(0, 1): xy, (1, 0): priors.eliminated[1]}
        return priors.floor**2 + more.get((i, j), 0.0) ** 2

    def _levels_by_segment(self, to_last: bool = False) -> Array:
        """Return sums (S, 4) for each road segment: the two components of the horizontal force
        divided by g, the weight, and the distance [m].

        to_last: the last segment ends with the last window.
        """
        ends = self._sums.ends(to_last)
        starts = np.concatenate([[0], ends[:-1] + 1])
        levels = np.add.reduceat(self._levels[: ends[-1] + 1, :4], starts)
        return np.asarray(levels / [GRAVITY, GRAVITY, 1.0, 1.0])

    def _levels_changed(self, spans: NDArray[np.int_]) -> Iterator[EntryChange]:
        """Yield the changes of the horizontal force. spans: numbers of last road segments, each
        compared with the segments before the longest span. These earlier segments also show how
        hilly the roads are.
        """
        levels = self._levels_by_segment(to_last=True)
        began = (len(levels) - spans).tolist()
        parts = [(0, began[-1]), *((first, len(levels)) for first in began)]
        means, metres = mean_slopes(levels, np.array(parts))
        variances = road_slopes(levels[: began[-1]], self._priors.slope).over(metres)
        for i in range(2):
            size, variance = means[1:, i] - means[0, i], variances[1:, i] + variances[0, i]
            yield EntryChange(level_row(i)[PHI], size, variance, ROAD_TAIL)

    def _level_measured(self) -> tuple[list[LinearMeasurement], Array]:
        """Return the measurements of the level zero along x and y, and the variances (2,) of the
        roads' mean slope in these measurements.
        """
        priors = self._priors
        levels = self._levels[:, :5] / [GRAVITY, GRAVITY, 1.0, 1.0, GRAVITY]
        slopes = self._slopes()
        lean = slopes.mean_variance
        mean, variance = slopes.mean.copy(), lean.copy()
        if self.signals.bend:
            mean[1], variance[1] = without_bend(levels, variance[1], self.signals.bend)
        stds = np.array([b.turn_zero_std for b in self._blocks[: len(levels)]])
        if stds.any():  # a zero of the turn rate is a lateral force in proportion to the speed
            turned = np.sqrt(levels[:, 2] * levels[:, 4] / GRAVITY) @ stds
            variance[1] += (turned / max(levels[:, 2].sum(), 1e-9)) ** 2
        if not self.signals.speed:  # the mean of dv/dt is as uncertain as the speed at both ends
            ends = math.hypot(self._unknown.std, FIRST_STD)
            variance[0] += (ends / (GRAVITY * self.seconds)) ** 2
        out = []
        for i in range(2):
            value = mean[i] - (priors.crown[0] if i == 1 else 0.0)
            noise = np.array([[variance[i] + 0.002**2]])
            out.append(LinearMeasurement(level_row(i)[None], np.array([value]), noise))
        return out, lean

    def _turning_measured(self) -> tuple[list[LinearMeasurement], Array]:
        """Return the measurements of the axis of turning: column 3 of the rate's matrix, plus the
        mean slope of the bends. Also return the variances (2,) of this mean slope.
        """
        priors, out = self._priors, []
        found = self._sums.turning.respond(np.ones(wd.BANDS, dtype=bool))
        leaning = _over_segments(self._slopes(), found.segments[:, 0]).diagonal()
        for i in range(2):
            row = rate_entry(i, 2)
            if i == 1:
                row[CROWN] = 1.0
            value = found.value[i] - (priors.crown[0] if i == 1 else 0.0)
            noise = found.covariance[i] + priors.turning[i] ** 2 + leaning[i]
            out.append(LinearMeasurement(row[None], value, noise))
        return out, leaning

    def _vertical_measured(self) -> LinearMeasurement:
        """Return the axis of turning relative to the vertical from the accelerometer, as estimated
        by the drift filter.

        The drift filter estimates the vertical on any slope, because it uses the change of the
        force's direction in bends.
        """
        assert self._axes is not None
        self._follow_drift()
        value, covariance = self._drift.axis_of_turning()
        W, V, zero = self._axes
        W_then, V_then, zero_then = self._drift_axes
        turned, tilted = W @ inverse(W_then), V @ inverse(V_then)
        level = GRAVITY * turned[:, 2] + turned @ zero_then - zero
        value = value + tilted[:2, 2] - level[:2] / GRAVITY
        rows = np.array([rate_entry(i, 2) - zero_row(i) for i in range(2)])
        return LinearMeasurement(rows, value, covariance + self._priors.bent**2 * np.eye(2))

    def _applied(
        self, theta: Array, covariance: Array, same: float, against: float | None
    ) -> Solution:
        """Correct the working axes by the estimated errors, and return the solution."""
        assert self._axes is not None
        W, V, zero = self._axes
        mixed, tilted = own_matrices(theta)
        turned = rotation_from_vector(theta[PHI])  # a rotation: a turn must not change a gain
        E, C = mixed @ turned, tilted @ turned
        shift = np.concatenate([theta[ZERO] * GRAVITY, [0.0]])
        moved = float(max(np.abs(E - np.eye(3)).max(), np.abs(C - np.eye(3)).max()))
        turn = float(theta[EPS][2])  # of the gyroscope about z: in no matrix
        housing = turned.T @ self._rotation
        # Cross-axis terms in turned axes are partly gains, and no measurement shows a gain.
        force, rate, zero = without_gains(
            housing, solved(E, W), solved(C, V), solved(E, zero + shift)
        )
        return Solution(
            force, rate, zero, covariance, self.delay, moved, housing, turn, same, against,
            sent_variance(covariance),
        )  # fmt: skip


def force_fits(signals: OtherSignals) -> Fits:
    """Return the fits of the axes of the force to the motion that these signals show."""
    noise = USUAL_NOISE.copy()
    spread = np.concatenate([np.ones((3, 2)), SPREAD], axis=1)
    columns = [(i, *range(wd.X.start, wd.X.stop)) for i in range(3)]
    if not signals.gyro:
        noise += SLOPE_NOISE
        spread[:, len(wd.MAIN) + wd.EXTRA.index("dp/dt")] = ROLLING_SPREAD
    if not signals.speed:
        slopes = np.zeros(wd.BANDS) if signals.gyro else SLOPE_NOISE[1]
        few = len(UNKNOWN_SPREAD)
        columns = [tuple(UNKNOWN), columns[2][: 1 + few]]
        noise = np.array([UNKNOWN_NOISE + slopes, noise[2]])
        spread = np.array([UNKNOWN_SPREAD, spread[2, :few]])
        if signals.steered:
            spread[0, -1] = STEERED_GAIN
    return Fits(tuple(columns), noise, spread, keep=2)


def _over_segments(slopes: Slopes, segments: Array | NDArray[np.int_]) -> Array:
    """Return the variances (n, 2) of the mean slope of the bends in road segments (n,)."""
    return slopes.over(np.asarray(SLOPE_M * (segments - 1.0), dtype=float))


def _leaning(lateral: Array, accel: Array) -> Array:
    """Return the roll rate and the pitch rate (N, 2) [rad/s] of a body that leans in proportion to
    v r (speed times yaw rate) and dv/dt. lateral: (N,) v r [m/s^2]. accel: (N,) dv/dt [m/s^2].
    """
    return np.column_stack([eq.rolling(lateral, ROLLS), -eq.pitching(accel, PITCHES, PITCHES)])


def _axes(x: Array) -> eq.Axes:
    return x[:, 0], x[:, 1], x[:, 2]


def _by_window(x: NDArray[Any]) -> NDArray[Any]:
    """Return windows (n, WINDOW, ...) of the ticks (N, ...) of joined blocks. Successive windows
    start one block apart.
    """
    blocks = x.reshape(-1, wd.BLOCK, *x.shape[1:])
    n = len(blocks) - BLOCKS_A_WINDOW + 1
    return np.concatenate([blocks[i : i + n] for i in range(BLOCKS_A_WINDOW)], axis=1)
