"""Detect a drift of the accelerometer's zero error.

A Kalman filter on means of 0.8 s integrates the vertical from the gyroscope's rates. The filter
compares this vertical with the force minus the motion's part of the force. All quantities are in
the working axes, which are estimates of the vehicle's axes. In bends, the zero error turns with the
vehicle, but a slope does not. This difference separates the zero error from the slope. A creeping
mount rotates the gyroscope too. This rotation separates the creep from the zero error and from the
slope. The filter's model is a drive without faults. In this model, everything is constant except
the vertical and the zero errors of both sensors. These zero errors are slow random walks:

    left = g u + b + v (0, -z_r, z_q) + B (dv/dt, v r, dr/dt, r^2, (v r)^2, d(v r)/dt) + noise
    u'   = r u_y - q, p - r u_x        (p, q, r) = rate - z - e r
    u = m + slope, white noise over the distance (`drive.roads.Slopes.density`)

left: force minus the motion's part (3). u: horizontal part of the vertical (2). z: zero error of
the rate (3). e: tilt of the gyroscope (2). m: tilt of the working axes (2). b: zero error of the
force (3). B: responses to motion that remain in the working axes (3 by 6).

A drift of the zero error is a ramp in b. The rate of the ramp and its direction are unknown. The
effect of the ramp on the innovations is linear in the rate. The likelihood ratio of each onset is
therefore known in closed form (Willsky and Jones, IEEE Trans. Automatic Control 21, 1976). The sum
of these ratios over the onsets is the statistic of Shiryaev and Roberts. In drives without faults,
the mean of this statistic grows by one per onset. The statistic therefore exceeds a threshold A at
most once in A onsets (Pollak, Ann. Statistics 13, 1985).

The zero error of a sensor drifts a little in any drive while the sensor warms up. This warm-up is a
ramp with a smaller prior rate. The statistic of the warm-up is evidence for a sensor without a
fault. A certain warm-up therefore does not make a fault likely.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, Flags, inverse, solved
from imucald.core.samples import GRAVITY
from imucald.drive.roads import slope_way
from imucald.drive.vertical import VERTICAL_WALK
from imucald.motion.standstill import MAX_GYRO_BIAS
from imucald.motion.ticks import TICK_S
from imucald.mount.joint.state import IN_BENDS, LAG
from imucald.mount.joint.sudden_changes import (
    ANSWER,
    EFFECT,
    GYRO,
    MOST_ONSETS,
    MOTIONS,
    RATE_ZERO,
    STATES,
    TILT,
    UP,
    ZERO,
    Onsets,
    SuddenChange,
    likeliest_change,
)

Complex = NDArray[np.complex128]

STEP, STEPS = 8, 8
"""Number of ticks of a mean, and number of means of a block."""
STEP_S = STEP * TICK_S
ONSET_BLOCKS, ONSETS = 10, 24
"""Number of blocks between two possible onsets of a drift (64 s), and number of onsets that are
tested. The tested onsets cover the last 26 minutes.
"""
FALSE_ALARM_H = 300.0
"""Hours of driving in which at most one false alarm is expected. This value is the limit of
docs/integrity.md for one fault.
"""
DOUBT_H = 15.0
"""Hours of driving in which one drift is assumed when the deviation is computed. This value is
smaller than `FALSE_ALARM_H`, so the deviation grows early during a drift.
"""
NAMED = 0.2
"""Size of a drift [m/s^2] above which the drift is reported as a fault. A smaller drift only
increases the deviation.
"""
_LOG_BLOCKS = math.log(FALSE_ALARM_H * 3600.0 / (STEPS * STEP_S))
LOG_ONSETS = _LOG_BLOCKS - math.log(ONSET_BLOCKS)
"""Logarithm of the number of drift onsets in which one false alarm is allowed."""
NEVER = 700.0
"""Size of the log odds of an impossible hypothesis. The exponential of this number does not
overflow.
"""
_ONE, _AXES = np.eye(3), np.arange(3)
_UNTIL = np.vstack([np.tril(np.ones((STEPS, STEPS)), -1) + 0.5 * np.eye(STEPS), np.ones(STEPS)])
"""Matrix (STEPS + 1, STEPS) that sums the turns of the steps.

Row k gives the turn until the middle of step k. The last row gives the turn until the end of all
steps.
"""


def probability(log_odds: float) -> float:
    """Return the probability that corresponds to log odds."""
    return 1.0 / (1.0 + math.exp(min(-log_odds, NEVER)))


class Drifts(NamedTuple):
    """Standard deviations of the states before any data, and standard deviations of their random
    walks.
    """

    rate: float = 0.002
    """Rate of change of the zero error of each axis in a fault [m/s^2 per second]. The value is an
    assumption: ten times the rate in a warm-up.
    """
    warming: float = 0.0002
    """Rate of change of the zero error of each axis in a warm-up [m/s^2 per second]: 1 mg/K
    (BMI160) and 10 K in 10 min.
    """
    warmed: float = 0.1
    """Total change of the zero error of each axis in a warm-up [m/s^2]."""
    zero: float = 0.5
    """Zero error of the force in the working axes [m/s^2]. The value includes the part of gravity
    that comes from the tilt of these axes.
    """
    zero_walk: float = 3e-4
    """Random walk of the force's zero error [m/s^2 per root second].

    The walk is 0.007 m/s^2 in 10 min. A sensor with 0.07 mg/K that warms up by 10 K has the same
    change (assumption). A larger change counts as a drift and is part of the deviation.
    """
    rate_zero: float = MAX_GYRO_BIAS
    """Zero error of the rate before the vehicle is at rest for the first time [rad/s].

    Before this rest, the zero error is estimated from driving data. In the bends of a car park, the
    error of this estimate was 6 deg/s. The recording is css_canmod_164, which was used to choose
    this value.
    """
    rate_zero_walk: float = 5e-5
    """Random walk of the rate's zero error [rad/s per root second].

    The walk is 0.03 deg/s in 100 s. A phone that warmed up had the same change. The recording is
    vehsense_2018_08_04, which was used to choose this value and is not used as evidence.
    """
    up: float = 0.05
    """Vertical while no gyroscope data are available for its integration [rad]."""
    up_walk: float = VERTICAL_WALK
    """Random walk of the vertical during its integration [rad per root second]. The causes are
    noise and gain error of the gyroscope.
    """
    lost: float = 0.01
    """Increase of the vertical's deviation for each unused tick [rad]."""
    gyro: float = 0.06
    """Tilt of the gyroscope's working axes [rad]. The value is wide, because the first working axes
    may be wrong by several degrees. `fusion` applies the prior of a sensor (`state.Priors.gyro`).
    """
    tilt: float = 0.03
    """Tilt of the working axes relative to the vehicle's axes [rad]."""
    noise: float = 0.1
    """Initial noise of a mean [m/s^2]. The filter then estimates the noise of each axis from the
    data.
    """
    loudness: float = 4.0
    """Degrees of freedom (Student's t distribution) of the ratio between a block's noise and the
    estimated noise.
    """


ANSWERS: Final = np.array(
    [
        [0.06, 0.06, 1.5, 3.0, IN_BENDS[0], LAG[0]],
        [0.06, 0.06, 3.0, 1.5, IN_BENDS[1], LAG[1]],
        [0.06, 0.06, 0.3, 0.3, IN_BENDS[2], LAG[2]],
    ]
)
"""Prior standard deviations of the matrix B, the responses of the force to motion.

Columns 1 and 2: cross-talk and gains, wide for the first working axes. Columns 3 and 4: lever arm
[m]. Column 5: slip and lean of a vehicle in bends [s^2/m]. Column 6: lag of the lateral velocity in
bends [s]. The wide values of columns 1 and 2, and `Drifts.gyro`, were chosen on simulated motorways
with the seeds 970000 to 970019 and 1560000 to 1560041. These drives are not used to judge results.
"""
LEARNT, LEAST, MOST = 200.0, 0.02, 100.0
"""Number of means over which the noise is estimated (160 s). Smallest and largest ratio of the
estimated noise variance to the usual noise variance.
"""
HEAVY = 9.0
"""Largest square of a residual that is used to estimate the noise, as a multiple of the noise
variance of the axis: three deviations. Larger squares are limited to this value.
"""


class Drift(NamedTuple):
    """Estimate of a drift of the force's zero error.

    log_odds: logarithm of the odds of a fault against a sensor without a fault. A sensor without a
    fault may warm up. The odds are computed from the statistic of a fault divided by the threshold
    of this statistic. Values above zero mean a fault. At most one false alarm is expected in
    `FALSE_ALARM_H` hours. size: (3,) change of the zero error in a fault [m/s^2], working axes.
    covariance: (3, 3) covariance of `size`. rate: (3,) rate of the drift in a fault [m/s^2 per
    second]. rate_covariance: (3, 3) covariance of `rate`. usual: (3, 3) mean square of the change
    if there is no fault [(m/s^2)^2].
    """

    log_odds: float
    size: Array
    covariance: Array
    rate: Array = np.zeros(3)
    rate_covariance: Array = 4e-6 * np.eye(3)
    usual: Array = np.zeros((3, 3))

    def turned(self, matrix: Array) -> Drift:
        """Return the same drift in other axes. matrix: (3, 3) rotation into these axes."""

        def both(covariance: Array) -> Array:
            return np.asarray(matrix @ covariance @ matrix.T)

        size, rate = matrix @ self.size, matrix @ self.rate
        squares = self.covariance, self.rate_covariance, self.usual
        covariance, rate_covariance, usual = map(both, squares)
        return Drift(self.log_odds, size, covariance, rate, rate_covariance, usual)

    @property
    def is_named(self) -> bool:
        """True if a drift is certain and large enough for a fault."""
        return self.log_odds > 0.0 and float(np.linalg.norm(self.size)) > NAMED

    def variance(self) -> Array:
        """Return the variance (3,) of the change from the past zero error to the present zero error
        [(m/s^2)^2]. The variance is the mean over the cases of a drift and of no drift, weighted by
        their probabilities.
        """
        odds = self.log_odds + math.log(FALSE_ALARM_H / DOUBT_H)
        share = probability(odds)
        drifted = np.diag(self.covariance) + self.size**2
        return np.asarray(share * drifted + (1.0 - share) * np.diag(self.usual))


NONE = Drift(-math.inf, np.zeros(3), np.zeros((3, 3)))


class _Path(NamedTuple):
    """Path of the vertical over n steps.

    up: (n + 1, 2) horizontal part of the vertical in the middle of each step, and at the end of the
    last step. slopes: (n + 1, 2, STATES) derivatives of `up` with respect to the state at the
    start.
    """

    up: Array
    slopes: Array


class ZeroDrift:
    """Kalman filter of a drive without drift, and the effect of a drift from each onset on this
    filter.

    The state has a mean (STATES,) and a covariance (STATES, STATES). Four results are stored for
    each onset: the shift of the mean for a drift of 1 m/s^2 per second, the information (3, 3)
    about the rate of the drift, the score (3,) of this rate, and the drift before the onset. past:
    a drift before the first block, in the working axes. This drift may continue, so the first onset
    is the onset of this drift.
    """

    def __init__(self, past: Drift | None = None, drifts: Drifts | None = None) -> None:
        self._past = past if past is not None and math.isfinite(past.log_odds) else None
        self._drifts = d = drifts or Drifts()
        std = np.zeros(STATES)
        std[UP], std[RATE_ZERO], std[GYRO], std[TILT] = d.up, d.rate_zero, d.gyro, d.tilt
        std[ZERO], std[ANSWER] = d.zero, ANSWERS.ravel()
        self._mean = np.zeros(STATES)
        self._covariance = np.diag(std**2)
        walk = np.zeros(STATES)
        walk[UP], walk[RATE_ZERO], walk[ZERO] = d.up_walk, d.rate_zero_walk, d.zero_walk
        self._walk = STEP_S * walk**2
        self._noise = np.full(3, d.noise**2)
        self._taken: Array | None = None
        self._steps = self._blocks = 0
        self._ramps, self._sudden = Onsets(3), Onsets(EFFECT.shape[1])
        self._kept = math.nan  # onset of a sudden change whose cause is open
        self._log = np.zeros((2, 0))
        self._before = np.zeros((0, 3))

    def restart(self) -> None:
        """Mark the vertical as unknown."""
        self._mean[UP] = 0.0
        self._ramps.shift[UP] = self._sudden.shift[UP] = 0.0
        self._covariance[UP] = 0.0
        self._covariance[:, UP] = 0.0
        self._covariance[UP, UP] = self._drifts.up**2 * np.eye(2)

    def add_block(
        self, left: Array, rate: Array, speed: Array, accel: Array, use: Flags, rate_zero: Array,
        rate_walk: Array, slopes: Array,
    ) -> None:  # fmt: skip
        """Process a block of N = 64 ticks in the working axes.

        The block is divided into parts. Random walks are added at the start of a part. The effect
        of unused ticks must be added before the other ticks.

        left: (N, 3) force minus the motion's part [m/s^2]. rate: (N, 3) rate after the zero error
        rate_zero (3,) was subtracted [rad/s]. speed: (N,) [m/s]. accel: (N,) [m/s^2]. use: (N,)
        flags of the usable ticks. rate_walk: (3, 3) growth of the variance of an angle that is
        integrated from the rate [rad^2/s]. slopes: (2,) density of the roads' slopes along and
        across the vehicle [m], see `drive.roads.Slopes.density`.
        """
        if self._blocks % ONSET_BLOCKS == 0:
            self._begin_ramp()
        self._sudden.begin(self._steps, EFFECT, MOST_ONSETS, self._kept)
        self._blocks += 1
        if self._taken is not None:
            self._mean[RATE_ZERO] -= rate_zero - self._taken
        self._taken = rate_zero
        used = use.reshape(STEPS, STEP).sum(axis=1)
        means = _means(left, rate[:, 2], speed, accel, use, used)
        turns = rate.reshape(STEPS, STEP, 3).sum(axis=1) * TICK_S
        passed = (slope_way(speed) * use).reshape(STEPS, STEP).sum(axis=1) * TICK_S
        (xx, xy), (yx, yy) = rate_walk[:2, :2].tolist()
        walked = np.array([[yy, -yx], [-xy, xx]])  # a turn about y moves the vertical along x
        cuts = [0, *(k for k in np.flatnonzero(used < STEP).tolist() if k), STEPS]
        for first, stop in pairwise(cuts):
            P = self._covariance = 0.5 * (self._covariance + self._covariance.T)
            diagonal = P.ravel()[:: STATES + 1]
            diagonal += (stop - first) * self._walk
            P[UP, UP] += (stop - first) * STEP_S * walked
            diagonal[UP] += (self._drifts.lost * (STEP - used[first])) ** 2
            held = np.flatnonzero(used[first:stop] >= STEP // 2)
            path = self._path(turns[first:stop])
            self._take(path, means[first:stop], held, float(passed[first:stop].sum()), slopes)
            self._steps += stop - first

    def found(self) -> Drift:
        """Return the present estimate of a drift: its probability and its size."""
        ramps = self._ramps
        if not len(ramps.began):
            return NONE
        d, since = self._drifts, (self._steps - ramps.began) * STEP_S
        prior = np.empty((2, len(since)))  # of a warm-up, of a fault
        prior[0], prior[1] = np.minimum(d.warming, d.warmed / np.maximum(since, STEP_S)), d.rate
        variance = np.square(prior)[:, :, None, None]
        information = ramps.information + _ONE / variance
        covariance = inverse(information)
        rate = (covariance @ ramps.score[:, :, None])[..., 0]
        log = self._log + 0.5 * (rate * ramps.score).sum(axis=2)
        log -= 0.5 * np.log(np.linalg.det(information * variance))
        share = np.exp(log - log.max(axis=1, keepdims=True))
        total = share.sum(axis=1)
        odds = log.max(axis=1) + np.log(total) - LOG_ONSETS
        usual, of_drift = share / total[:, None]
        sizes = self._before + rate * since[:, None]
        each = covariance * np.square(since)[:, None, None] + _squares(sizes)
        size, squares = of_drift @ sizes[1], np.tensordot(of_drift, each[1], 1)
        square = covariance[1] + _squares(rate[1])
        mean, rates = of_drift @ rate[1], np.tensordot(of_drift, square, 1)
        return Drift(
            float(odds[1] - np.logaddexp(0.0, odds[0])),
            size,
            squares - _squares(size),
            mean,
            rates - _squares(mean),
            np.tensordot(usual, each[0], 1) * probability(float(odds[0])),
        )

    def axis_of_turning(self) -> tuple[Array, Array]:
        """Return the tilt of the gyroscope's axis of turning relative to the vertical.

        The vertical is the axis along which the accelerometer measures gravity on level ground. The
        result is the horizontal part (2,) of the tilt [rad] and its covariance (2, 2).
        """
        rows = np.zeros((2, STATES))
        rows[:, GYRO] = np.eye(2)
        rows[:, ZERO.start : ZERO.start + 2] = -np.eye(2) / GRAVITY
        wide = np.diag(self.found().variance()[:2]) / GRAVITY**2
        return rows @ self._mean, rows @ self._covariance @ rows.T + wide

    def sudden_change(self) -> SuddenChange | None:
        """Return the most likely sudden change in the last blocks; None before any block."""
        if not len(self._sudden.began):
            return None
        level = GRAVITY + float(self._mean[ZERO][2])
        found = likeliest_change(self._sudden, self._steps, STEPS, _LOG_BLOCKS, level)
        is_open = found.is_certain and not found.is_decided
        self._kept = found.began if is_open else math.nan
        return found

    def _begin_ramp(self) -> None:
        if self._ramps.begin(self._steps, np.zeros((STATES, 3)), ONSETS):
            self._log, self._before = self._log[:, 1:], self._before[1:]
        self._log = np.hstack([self._log, np.zeros((2, 1))])
        self._before = np.concatenate([self._before, np.zeros((1, 3))])
        if self._past is not None:
            self._go_on_from(self._past)
            self._past = None

    def _go_on_from(self, past: Drift) -> None:
        """Make an earlier drift the first onset. The former estimate of the drift rate becomes the
        prior.
        """
        prior, information = self._drifts.rate**2, inverse(past.rate_covariance)
        self._ramps.information[0] = information - _ONE / prior
        self._ramps.score[0] = information @ past.rate
        known = 0.5 * (past.rate @ self._ramps.score[0] - np.linalg.slogdet(information * prior)[1])
        self._log[:, 0] = -NEVER, past.log_odds + LOG_ONSETS - known
        self._before[0] = past.size

    # the filter ----------------------------------------------------------------------------------

    def _path(self, turns: Array) -> _Path:
        """Return the vertical over n steps. turns: (n, 3) rotation of the vehicle in each step
        [rad].
        """
        x, n = self._mean, len(turns)
        until = _UNTIL[[*range(n), STEPS], :n]
        p, q, r = (turns - x[RATE_ZERO] * STEP_S).T
        theta = until @ r
        back = np.exp(-1j * theta)
        tilts = 1j * back[:-1].conj()  # of a step by one, in the axes of the block's start
        start, gyro = complex(*x[UP]), complex(*x[GYRO])
        tilted = tilts * (p + 1j * q - gyro * r)
        turned = 1j * STEP_S * (start + until[:-1] @ tilted)
        made = until @ np.array([tilted, -STEP_S * tilts, -tilts * r, turned]).T
        made[:, 0] += start
        made *= back[:, None]
        slopes = np.zeros((len(theta), 2, STATES))
        slopes[:, :, UP] = _as_matrices(back)
        slopes[:, :, RATE_ZERO.start : RATE_ZERO.start + 2] = _as_matrices(made[:, 1])
        slopes[:, :, GYRO] = _as_matrices(made[:, 2])
        slopes[:, 0, 4], slopes[:, 1, 4] = made[:, 3].real, made[:, 3].imag
        return _Path(np.array([made[:, 0].real, made[:, 0].imag]).T, slopes)

    def _take(
        self, path: _Path, means: Array, held: NDArray[np.int_], passed: float, slopes: Array
    ) -> None:
        """Update the state with the mean forces of n steps.

        Then update the vertical at the end of the last step with the prior of road slopes. The
        variance of this prior is slopes (2,) [m] divided by the distance passed [m], see
        `slope_way`. Finally predict the state at the end of the steps.

        means: (steps, 10) of all steps of the path: force minus the motion's part (3), the six
        motions of the matrix B, and the speed, see `_means`. held: (n,) indices of the steps with
        enough ticks; only their means are used.
        """
        n, end = 3 * len(held), path.slopes[-1]
        rows = n + 2 if passed > 0.0 else n
        H, off, noise = np.zeros((rows, STATES)), np.zeros(rows), np.zeros(rows)
        H[:n], off[:n] = self._force_rows(path, means, held)
        if passed > 0.0:
            H[n:] = end
            H[n, TILT.start] = H[n + 1, TILT.start + 1] = -1.0
            off[n:] = self._mean[TILT] - path.up[-1]
            noise[n:] = slopes / passed
        P, ramps, sudden = self._covariance, self._ramps, self._sudden
        seen = H @ P
        since = (self._steps + 0.5 + held[:, None] - ramps.began) * STEP_S
        answer = -(H @ ramps.shift)
        answer[:n].reshape(-1, 3, len(ramps.began), 3)[:, _AXES, :, _AXES] += since
        stepped = -(H @ sudden.shift)
        columns = np.concatenate([off[:, None], seen, answer], axis=1)
        whiten = self._whitening(seen @ H.T, noise, off, len(held))
        made, stepped = whiten @ columns, whiten @ stepped
        first = made[:, : 1 + STATES]
        both = first.T @ made
        ramps.add_answers(made[:, 1 + STATES :], both[:, 1 + STATES :])
        sudden.add_answers(stepped, first.T @ stepped)
        found = both[0, 1 : 1 + STATES]
        self._mean += found
        self._mean[UP] = path.up[-1] + end @ found
        P -= both[1:, 1 : 1 + STATES]
        P[UP] = end @ P
        P[:, UP] = P @ end.T
        for one in (ramps, sudden):
            one.shift[UP] = end @ one.shift

    def _force_rows(self, path: _Path, means: Array, held: NDArray[np.int_]) -> tuple[Array, Array]:
        """Return the derivatives (3 n, STATES) of the mean forces with respect to the state, and
        the residuals (3 n,) of the mean forces.
        """
        x, taken = self._mean, means[held]
        moved, speed = taken[:, 3 : 3 + MOTIONS], taken[:, 3 + MOTIONS]
        H = np.zeros((len(held), 3, STATES))
        H[:, :2] = GRAVITY * path.slopes[held]
        H[:, :, ZERO] = _ONE
        for i in range(3):
            H[:, i, ANSWER.start + MOTIONS * i : ANSWER.start + MOTIONS * (i + 1)] = moved
        H[:, 1, 4] -= speed
        H[:, 2, 3] += speed
        off = taken[:, :3] - x[ZERO] - moved @ x[ANSWER].reshape(3, MOTIONS).T
        off[:, :2] -= GRAVITY * path.up[held]
        off[:, 1] += speed * x[4]
        off[:, 2] -= GRAVITY + speed * x[3]
        return H.reshape(-1, STATES), off.ravel()

    def _whitening(self, S: Array, noise: Array, off: Array, n: int) -> Array:
        """Return the matrix (m, m) that whitens the innovations off (m,).

        The matrix is the inverse of the Cholesky root of the covariance of the innovations. This
        covariance is the sum of three parts: S (m, m) from the state, the variances `noise` (m,),
        and the noise of n means. Means with large innovations get less weight.
        """
        free, each = self._drifts.loudness, np.tile(self._noise, n)
        diagonal = S.ravel()[:: len(S) + 1]
        diagonal += noise
        diagonal[: 3 * n] += each
        root = _root(S)
        white = solved(root, off)[: 3 * n].reshape(n, 3)
        loud = (free + np.square(white).sum(axis=0)) / (free + n)
        if self._steps > LEARNT / 5.0:  # from then on the axes' own tilt is known
            self._learn_noise(root, white)
        diagonal[: 3 * n] += each * np.tile(loud - 1.0, n)
        return inverse(_root(S))

    def _learn_noise(self, root: Array, white: Array) -> None:
        """Estimate the noise of each axis. white: (n, 3) whitened innovations. root: Cholesky root
        of the covariance of the innovations.
        """
        n, places = len(white), np.arange(len(white))
        blocks = root[: 3 * n, : 3 * n].reshape(n, 3, n, 3)[places, :, places]
        square = (blocks @ white[:, :, None])[:, :, 0] ** 2
        square += self._noise - np.square(blocks).sum(axis=2)
        square = np.minimum(np.maximum(square, 0.0), HEAVY * self._noise)
        usual = self._drifts.noise**2
        learnt = self._noise + (square - self._noise).sum(axis=0) / LEARNT
        self._noise = np.minimum(np.maximum(learnt, LEAST * usual), MOST * usual)


def _means(left: Array, r: Array, speed: Array, accel: Array, use: Flags, used: Array) -> Array:
    """Return means (STEPS, 10) over the usable ticks. The columns are the force minus the motion's
    part, the six motions of the matrix B, and the speed.
    """
    every = np.empty((4 + MOTIONS, len(r)))
    every[:3], every[3], every[4] = left.T, accel, speed * r
    every[5], every[6], every[7] = _slope(r), r * r, every[4] ** 2
    every[8], every[9] = _slope(every[4]), speed
    sums = (every * use).reshape(len(every), STEPS, STEP).sum(axis=2)
    return np.asarray((sums / np.maximum(used, 1)).T)


def _slope(x: Array) -> Array:
    """Return the slope of x (N,) [1/s]. The first and the last tick have the slope of their
    neighbours."""
    made = np.empty_like(x)
    made[1:-1] = (x[2:] - x[:-2]) * (0.5 / TICK_S)
    made[[0, -1]] = made[[1, -2]]
    return made


def _as_matrices(values: Complex) -> Array:
    """Return the matrices (n, 2, 2) of complex factors (n,). A matrix acts on a horizontal vector
    in the same way as the complex factor acts on a complex number.
    """
    made = np.empty((len(values), 2, 2))
    made[:, 0, 0] = made[:, 1, 1] = values.real
    made[:, 1, 0] = values.imag
    made[:, 0, 1] = -values.imag
    return made


def _squares(rows: Array) -> Array:
    return np.asarray(rows[..., :, None] * rows[..., None, :])


def _root(matrix: Array) -> Array:
    return np.asarray(np.linalg.cholesky(matrix), dtype=float)
