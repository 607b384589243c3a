"""Methods B and C together: corrected samples in, attitude with its uncertainty out.

A run begins with the start: 5 s of rest, or 5 s of motion if the vehicle does not stand. After the
start, the gyroscope updates the attitude at every sample. The filter runs at the end of every
interval between two average speeds. After 30 s of rest, the sensor check runs once. The filter does
no I/O and reads no clock. The filter takes the samples one by one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucald.attitude.endpoints import EndpointMaker
from imucald.attitude.estimate import SETTLED_STD, STALE_S, UNKNOWN, AttitudeEstimate, AttitudeState
from imucald.attitude.grade import GradeFilter
from imucald.attitude.heading_source import HeadingSource, Verdict
from imucald.attitude.interval import Endpoint, Interval, along_body, interval, shared
from imucald.attitude.kalman import NineStateFilter, of_axes
from imucald.attitude.measurements import (
    MIN_UP,
    heading_difference,
    rest_rates,
    rounding,
    tilt,
)
from imucald.attitude.motion_compensation import MotionCompensation
from imucald.attitude.propagation import Propagator
from imucald.attitude.rest import is_rest
from imucald.attitude.right_forward_up import (
    rfu_from_vehicle,
    vehicle_angles,
    vehicle_from_rfu,
    wrapped,
)
from imucald.attitude.sensor_check import CheckResult, rest_errors
from imucald.config.attitude import AttitudeSettings
from imucald.config.base import per_axis
from imucald.core.rotations import (
    IDENTITY,
    Quaternion,
    Rows,
    Vector,
    levelling_rotation,
    matrix_times,
    quaternion_from_rotation,
    quaternion_from_vector,
    quaternion_product,
    rows_from_quaternion,
    times,
    transposed_times,
)
from imucald.motion.lost_time import LostTime

START_REST_STD = math.radians(10.0)
MOVING_STD = math.radians(15.0)
"""Assumed deviation of the tilt at the start [rad], at rest and in motion. The second also holds
after a gap of the gyroscope shorter than `STALE_S`: ramps, kerbs and swerves turn a body by less
than 20 deg/s about the level axes.

The deviation is so large that the first interval corrects the tilt. With a small deviation, the
filter would take an error of the tilt as an error of the accelerometer, which the filter forgets
slowly.
"""
UNSEEN_YAW_RATE = 0.8
"""Standard deviation of a yaw rate without measurement [rad/s].

The grip of tyres is 1 g, and cars can drive on circles of 10 m diameter. The rate is therefore at
most sqrt(g / 5 m) = 1.4 rad/s. A uniform distribution up to this rate is assumed.
"""
UNSEEN_CHANGE = 0.7
"""Random walk of the rate between two samples [rad/s per root of a second]: 0.5 rad/s in half a
second, as in a double lane change (ISO 3888-1).
"""
BRIDGED_S = 0.1
"""Longest time without a sample for which a straight line between two rates causes an error of at
most 0.4 deg [s].
"""
SCATTER_S = 1.0
"""Shortest time over which the scatter of the samples is computed [s], also if the intervals are
shorter.
"""
HEADING_KNOWN_STD = math.radians(20.0)
"""Deviation of a heading above which the heading counts as not known [rad]."""
HEADING_FOUND_STD = 1.0
"""Deviation of a heading above which the heading of the source replaces it [rad], because any
source is more accurate.
"""
ROLLS_ON_S = 2.0
"""Time in which gentle braking stops a vehicle from 1 m/s [s]. Below this speed, the speed signal
may be zero.
"""
HEADING_LATE_S = 1.0
"""Largest age of a heading [s]. Headings from satellite receivers are half a second old and
more."""
HEADING_SPACING_S = 0.5
"""Shortest time between two headings that are used [s]."""
HEADING_ERRORS_S = 60.0
"""Duration of an error of a heading source [s]. All headings within this time together count as one
heading.

A fused heading drifts, and the effect of steel near the road persists. Rests therefore have more
weight than headings in the estimate of the gyroscope's zero error.
"""


class AttitudeFilter:
    """Processes samples in vehicle axes (ISO 8855), SI units, with stream time. The settings are
    `AttitudeSettings`."""

    def __init__(self, settings: AttitudeSettings | None = None) -> None:
        self.settings = settings or AttitudeSettings()
        compensation, of_filter = self.settings.compensation, self.settings.filter
        self.kalman = NineStateFilter(of_filter)
        self.constant_bias: Vector = (0.0, 0.0, 0.0)
        """Constant gyroscope error bs of the publication [rad/s], right-forward-up axes."""
        self.constant_accel_error: Vector = (0.0, 0.0, 0.0)
        """Constant accelerometer error ds of the publication [m/s^2], right-forward-up axes."""
        self.checked = False
        """True if the sensor check was made."""
        self._check_is_restored = False  # since then the gyroscope has been off, or has warmed up
        self._propagator = Propagator(
            of_filter.longest_step, rfu_from_vehicle(*compensation.lever_arm)
        )
        self._endpoints = EndpointMaker(compensation, self._propagator)
        self._grade = GradeFilter(self.settings.squat, self.settings.grade_time)
        self._motion = MotionCompensation(compensation) if compensation.send else None
        self._source = HeadingSource(of_filter.gate)
        self._resolution = of_filter.gyro_resolution or 0.0
        self._heading_noise = {
            "free": 0.0,
            "signal": of_filter.heading_noise,
            "magnetometer": of_filter.magnetometer_noise,
        }[of_filter.heading]
        self._lost_time = LostTime()
        self.reset()

    # verbs -----------------------------------------------------------------------------------

    def reset(self) -> None:
        """Forget the attitude, because the mount is no longer known or time has jumped."""
        self._forget_attitude()
        self._restart()
        self._endpoints.restart()
        self._sign = 1.0
        if self._motion is not None:
            self._motion.restart()

    def _forget_attitude(self) -> None:
        self.running = False
        self._correction: Quaternion = IDENTITY
        self._propagator.q = IDENTITY
        self._source.restart()
        self._net_turn = self._heading_before = 0.0
        """Total turn to the right since the heading began [rad], and the heading at the last update
        of this turn [rad].
        """

    def _restart(self) -> None:
        """Restart: earlier measurements are not joined with later measurements, except speeds."""
        self._propagator.restart()
        self._start: Endpoint | None = None
        self._rest: Endpoint | None = None
        self._still: Interval | None = None
        self._accel_seen = self._heading_seen = -math.inf
        self._predicted = -math.inf
        self._grade.restart()
        self._free: Vector = UNKNOWN

    def gyro(self, t: float, values: Sequence[float]) -> None:
        """Process an angular rate [rad/s]."""
        step = t - self._propagator.t
        if step < math.inf:
            lost = self._lost_time.take_time_step(max(step, 0.0))
            unseen = step if step > self.settings.filter.longest_step else lost
            if unseen:
                self._turned_unseen(unseen)
            elif self._lost_time.skipped > BRIDGED_S:
                self._bridged(step)
        rate = rfu_from_vehicle(values[0], values[1], values[2])
        self._propagator.gyro(t, rate, self._bias)
        for first, last in self._endpoints.complete():
            self._close(first, last)
        if (piece := self._endpoints.piece()) is not None and self.running:
            self._update(shared(self._interval(*piece)), None)

    @property
    def _bias(self) -> Vector:
        p, b = self.constant_bias, self.kalman.bias
        return p[0] + b[0], p[1] + b[1], p[2] + b[2]

    def _turned_unseen(self, seconds: float) -> None:
        """Note that the turn rate was not measured for this time [s].

        After a long time, the attitude restarts. A heading that counts from the start also
        restarts. After a time of up to `STALE_S`, the attitude continues, and its deviation is
        enlarged by the possible turn.
        """
        if self.running and seconds <= max(STALE_S, self.settings.filter.longest_step):
            self._propagator.restart()
            self._start = self._rest = self._still = None
            self._grade.restart()
            self.kalman.turned_unseen(MOVING_STD, UNSEEN_YAW_RATE * seconds)
        else:
            self._forget_attitude()
            self._restart()

    def _bridged(self, seconds: float) -> None:
        """Add to the covariance the error of a rate that is interpolated linearly over a gap.

        seconds: length of the gap.

        The integral of a rate with a random walk of q per second differs from the integral of the
        line by a variance of q T^3 / 12.
        """
        std = UNSEEN_CHANGE * math.sqrt(seconds**3 / 12.0)
        self.kalman.turned_unseen(std, std)

    def accel(self, t: float, values: Sequence[float]) -> None:
        """Process a specific force [m/s^2]."""
        x, y, z = rfu_from_vehicle(values[0], values[1], values[2])
        d = self.constant_accel_error
        self._accel_seen = t
        force = (x - d[0], y - d[1], z - d[2])
        self._propagator.accel(t, force)
        if self._motion is not None:
            found = self._motion.take_sample(t, force, self._propagator.rate)
            self._free = vehicle_from_rfu(*found.force) if found.known else UNKNOWN

    def speed(self, t: float, speed: float) -> None:
        """Process a speed [m/s], not negative. `reverse` sets the direction."""
        self._endpoints.speed(t, self._sign * speed)
        if self._motion is not None:
            self._motion.speed(t, self._sign * speed)

    def reverse(self, is_reverse: bool) -> None:
        """Set whether the vehicle drives backwards."""
        self._sign = -1.0 if is_reverse else 1.0

    def heading(self, t: float, heading: float) -> None:
        """Process a heading [rad], clockwise from north."""
        if self.settings.filter.heading == "signal" and self.running:
            self._take_heading(t, heading)

    def mag(self, t: float, values: Sequence[float]) -> None:
        """Process a magnetic field in vehicle axes [T].

        The level part of the field points north.
        """
        if self.settings.filter.heading != "magnetometer" or not self.running:
            return
        m = rfu_from_vehicle(values[0], values[1], values[2])
        east, north, _ = times(self._C(), m)
        if math.hypot(east, north) > 0.0:
            # The field seems turned by the same angle as the estimate, in the opposite direction.
            estimated = vehicle_angles(self._C())[2]
            measured = estimated - math.atan2(east, north) + self.settings.filter.declination
            self._take_heading(t, measured)

    def turned(self, old: Sequence[float], new: Sequence[float]) -> None:
        """Note that the rotation of the mount (9 numbers, row by row) changes from now on.

        The sensor has not moved. The new mount is only more accurate, so the vehicle's axes rotate
        relative to the sensor.
        """
        before, after = np.array(old).reshape(3, 3), np.array(new).reshape(3, 3)
        A = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])  # text from vehicle
        D_new_from_old = A @ after @ before.T @ A.T
        self._propagator.turn_body(quaternion_from_rotation(D_new_from_old.T))
        self.kalman.turn_body(D_new_from_old)
        self.constant_bias = matrix_times(D_new_from_old, self.constant_bias)
        self.constant_accel_error = matrix_times(D_new_from_old, self.constant_accel_error)

    def take_zeros_off(self, rate: Vector, force: Vector) -> None:
        """Set the additional zero errors that are subtracted from the samples from now on, vehicle
        axes (3,) [rad/s], [m/s^2].

        The zero error of the rate is estimated, so the estimate is reduced by the same value. The
        zero error of the force is known only from a sensor check, and is then reduced too. Without
        a check, the subtraction makes the force more accurate.
        """
        p, q, r = rfu_from_vehicle(*rate)
        x, y, z = self.constant_bias
        self.constant_bias = x - p, y - q, z - r
        if self.checked:
            a, b, c = rfu_from_vehicle(*force)
            x, y, z = self.constant_accel_error
            self.constant_accel_error = x - a, y - b, z - c

    def check_again(self) -> None:
        """Repeat the sensor check at the next rest that is long enough."""
        self.checked = False
        self._rest = None

    @property
    def heading_is_doubted(self) -> bool:
        """True if the heading source contradicts the gyroscope, or has contradicted it and is not
        yet accepted again.
        """
        return self._source.doubt > 0.0

    @property
    def check(self) -> CheckResult | None:
        """Result of the sensor check, in vehicle axes; None before the check."""
        if not self.checked:
            return None
        return CheckResult(
            vehicle_from_rfu(*self.constant_bias), vehicle_from_rfu(*self.constant_accel_error)
        )

    def restore_check(self, found: CheckResult) -> None:
        """Use the result of an earlier sensor check, in vehicle axes, in place of a new check."""
        self.constant_bias = rfu_from_vehicle(*found.rate)
        self.constant_accel_error = rfu_from_vehicle(*found.force)
        self.checked = self._check_is_restored = True

    # result ----------------------------------------------------------------------------------

    def state(self, now: float | None = None) -> AttitudeState:
        """Return the state at stream time `now` [s]."""
        t = self._propagator.t
        if now is not None and now - min(t, self._accel_seen) > STALE_S:
            return AttitudeState.NOT_AVAILABLE
        if math.isinf(t):
            return AttitudeState.NOT_AVAILABLE
        if not self.running:
            return AttitudeState.STARTING
        kalman = self.kalman
        if self._unseen(now) or max(kalman.P[0, 0], kalman.P[1, 1]) > SETTLED_STD**2:
            return AttitudeState.SETTLING
        is_known = self._stated_heading_std() < HEADING_KNOWN_STD
        if is_known and self.settings.filter.heading != "free":
            return AttitudeState.FULL
        return AttitudeState.RELATIVE_HEADING

    def estimate(self, now: float | None = None) -> AttitudeEstimate:
        """Return the attitude at the newest gyroscope sample. The state and the deviations are
        valid for the time `now`.
        """
        C = self._C()
        kalman = self.kalman
        roll, pitch, heading = vehicle_angles(C)
        s, c = math.sin(heading), math.cos(heading)
        std = (
            kalman.std_along(s, c, 0.0),
            kalman.std_along(c, -s, 0.0),
            self._stated_heading_std(),
        )
        rate = vehicle_from_rfu(*self._propagator.rate)
        if unseen := self._unseen(now):
            tilt, yaw = MOVING_STD, UNSEEN_YAW_RATE * unseen
            std = (math.hypot(std[0], tilt), math.hypot(std[1], tilt), math.hypot(std[2], yaw))
            rate = UNKNOWN
        spread = [math.sqrt(max(float(kalman.P[i, i]), 0.0)) for i in (3, 4, 5)]
        return AttitudeEstimate(
            state=self.state(now),
            t=self._propagator.t,
            roll=roll,
            pitch=pitch,
            heading=heading,
            std=std,
            rate=rate,
            rate_std=(spread[1], spread[0], spread[2]),
            grade=self._grade.grade,
            grade_std=math.hypot(std[1], self._grade.spread),
            bias=vehicle_from_rfu(*self._bias),
            free_acceleration=self._free,
        )

    def _unseen(self, now: float | None) -> float:
        """Return the time for which no turn rate was measured [s]; 0 within the longest step of the
        gyroscope.
        """
        silent = 0.0 if now is None else now - self._propagator.t
        if self.settings.filter.longest_step < silent < math.inf:
            return silent
        return self._lost_time.standing

    def _heading_std(self) -> float:
        """Return the deviation of the gyroscope's heading [rad]. The gain error of the gyroscope
        has the same relative effect on all turns.
        """
        of_gain = self.settings.filter.gyro_gain * self._net_turn
        return math.hypot(math.sqrt(max(float(self.kalman.P[2, 2]), 0.0)), of_gain)

    def _stated_heading_std(self) -> float:
        """Return the deviation of the heading, including the error of the heading source [rad].
        Further headings do not reduce the error of the source.
        """
        return math.hypot(self._heading_std(), self._heading_noise, self._source.doubt)

    def _C(self) -> Rows:
        """Return C_nav_from_body: the product of the correction and the gyroscope's matrix."""
        return rows_from_quaternion(quaternion_product(self._correction, self._propagator.q))

    # intervals -------------------------------------------------------------------------------

    def _close(self, first: Endpoint | None, endpoint: Endpoint) -> None:
        if first is None:
            self._start = self._rest = self._still = None
            return
        found = self._interval(first, endpoint)
        resting = is_rest(first, endpoint, found, self.constant_bias, self.settings.filter)
        if not resting:
            self._rest = None
        elif self._rest is None:
            self._rest = first
        if not self.running:
            self._try_start(first, endpoint, resting)
            return
        self._filter(found, self._surely_still(found))
        if resting and self._rest is not None and not self.checked:
            self._check(self._rest, endpoint)

    def _surely_still(self, found: Interval) -> Interval | None:
        """Return the previous interval if it was an interval of rest, else None.

        The present interval is not used, because the vehicle may have started to drive at its end.
        """
        rest, still = self._rest, self._still
        is_over = rest is not None and found.t0 - rest.snapshot.t > ROLLS_ON_S - 1e-6
        self._still = found if is_over else None
        return still if rest is not None else None

    def _interval(self, first: Endpoint, last: Endpoint) -> Interval:
        s = self.settings
        c = s.compensation
        if c.speed_is == "horizontal":
            up = transposed_times(rows_from_quaternion(self._correction), (0.0, 0.0, 1.0))
            first, last = along_body(first, up), along_body(last, up)
        since = first.snapshot
        if last.snapshot.t - since.t < 0.5 * SCATTER_S:
            since = self._propagator.at(last.snapshot.t - SCATTER_S) or since
        noise, unknown = per_axis(s.filter.accel_noise), s.filter.unknown_motion
        return interval(first, last, c, noise, unknown, since)

    def _try_start(self, first: Endpoint, last: Endpoint, resting: bool) -> None:
        if self._start is None or (resting and self._rest is first):
            self._start = first
        if last.snapshot.t - self._start.snapshot.t < self.settings.filter.start - 1e-6:
            return
        found = self._interval(self._start, last)
        if math.isnan(found.speed) and not resting:
            self._start = None  # nothing separates gravity from motion: wait for a rest or a speed
            return
        if math.sqrt(sum(c * c for c in found.up)) < MIN_UP:
            self._start = None
            return
        self._correction = quaternion_from_rotation(levelling_rotation(found.up))
        heading = vehicle_angles(self._C())[2]
        self._correction = quaternion_product(
            quaternion_from_vector(0.0, 0.0, heading), self._correction
        )
        s = self.settings.filter
        tilt = START_REST_STD if resting else MOVING_STD
        free = 0.0 if s.heading == "free" else math.pi
        is_own = self.checked and not self._check_is_restored
        self.kalman.start(tilt, free, s.gyro_random if is_own else s.gyro_start)
        self.running = True
        self._net_turn, self._heading_before = 0.0, vehicle_angles(self._C())[2]
        self._predicted = found.t1
        self._filter(found, None)

    def _filter(self, found: Interval, still: Interval | None) -> None:
        """Use an interval between two speeds for the filter and for the road's slope. See
        `_update`.
        """
        if self._endpoints.has_pieces:
            self._endpoints.has_pieces = False
            found = shared(found)
        self._update(found, still)
        self._grade.take_interval(found, -vehicle_angles(self._C())[1])

    def _update(self, found: Interval, still: Interval | None) -> None:
        """Predict to the end of the interval, then use the measurements of the interval.

        still: an interval of rest, or None.
        """
        dt = max(found.t1 - self._predicted, 0.0)
        self._predicted = max(found.t1, self._predicted)  # a speed comes after pieces that it is of
        C = self._C()
        rounded = rounding(found.rate_variance, self._resolution)
        self.kalman.predict(C, dt, found.angle, rounded)
        gravity = times(rows_from_quaternion(self._correction), found.up)
        lag = max(self._propagator.t - 0.5 * (found.t0 + found.t1), 0.0)
        measurements = tilt(found, gravity, C, self.kalman.accel_error, lag)
        if still is not None and self.settings.filter.rest_update:
            x, y, z = (float(self.kalman.P[i, i]) for i in (3, 4, 5))
            noise, step = of_axes(self.settings.filter.gyro_noise), self._resolution
            measurements += rest_rates(still, self._bias, noise, (x, y, z), step)
        self._apply(self.kalman.update(measurements))
        heading = vehicle_angles(self._C())[2]
        self._net_turn += wrapped(heading - self._heading_before)
        self._heading_before = heading

    def _take_heading(self, t: float, heading: float) -> None:
        if t - self._heading_seen < HEADING_SPACING_S:
            return
        self._heading_seen = t
        kalman, C, noise = self.kalman, self._C(), self._heading_noise
        variance, estimated = self._heading_std() ** 2, vehicle_angles(C)[2]
        late = HEADING_LATE_S * abs(self._propagator.rate[2])
        is_bend = late > noise
        if variance < HEADING_FOUND_STD**2 or self._source.doubt:
            difference, of_source = wrapped(heading - estimated), noise * noise + late * late
            verdict = self._source.judge_heading(
                t, difference, variance, of_source, estimated, is_bend
            )
            if verdict is Verdict.REFUSED:
                return
            if verdict is Verdict.BEGUN_AGAIN:
                kalman.forget_heading()
            else:
                noise *= math.sqrt(HEADING_ERRORS_S / HEADING_SPACING_S)
        elif is_bend:
            return
        P = float(kalman.P[2, 2])
        error = kalman.update([heading_difference(heading, C, noise)])
        self._apply(error)
        kalman.turn_north(error[2])
        self._net_turn *= noise * noise / (P + noise * noise)
        self._heading_before += vehicle_angles(self._C())[2] - estimated  # a correction, no turn

    def _apply(self, error: Vector) -> None:
        self._correction = quaternion_product(quaternion_from_vector(*error), self._correction)

    def _check(self, first: Endpoint, last: Endpoint) -> None:
        """Do the sensor check at rest, which gives constant errors of gyroscope and
        accelerometer."""
        s = self.settings.filter
        if last.snapshot.t - first.snapshot.t < s.check - 1e-6:
            return
        found = self._interval(first, last)
        low, high, n = first.snapshot.body, last.snapshot.body, found.n
        mean = ((high[0] - low[0]) / n, (high[1] - low[1]) / n, (high[2] - low[2]) / n)
        bias, extra = rest_errors(found.rate, mean, s.check_level)
        old = self.constant_accel_error
        result = CheckResult(bias, (old[0] + extra[0], old[1] + extra[1], old[2] + extra[2]))
        if not result.is_believable:  # the sensor is broken: the next rest is judged again
            self._rest = None
            return
        self.constant_bias, self.constant_accel_error = result
        self.kalman.forget_bias(rounding(found.rate_variance, self._resolution))
        self.checked, self._check_is_restored = True, False
