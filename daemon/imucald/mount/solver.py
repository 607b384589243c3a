"""Combine all evidence: from blocks of signals to one rotation with its variances."""

from __future__ import annotations

import math
import operator
from collections import deque
from collections.abc import Mapping

import numpy as np
from msgspec.structs import replace

from imucald.core.arrays import Array
from imucald.core.rotations import (
    Matrix3,
    orthonormalised,
    rotation_from_vector,
)
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.block_sums import BlockMotion
from imucald.mount.common_errors import common_errors
from imucald.mount.creep import Creep, creep
from imucald.mount.cross_axis import CrossAxisFusion, ForceSeen
from imucald.mount.delay import DelaySearch, LeverArm
from imucald.mount.estimator_settings import DelayPrior, EstimatorSettings
from imucald.mount.evidence_gravity import ROAD_SHARE, GravityEvidence
from imucald.mount.evidence_response import GROUP, ResponseEvidence
from imucald.mount.evidence_rows import SAME_NOISE
from imucald.mount.first_rotation import first_rotation
from imucald.mount.fusion import Fused
from imucald.mount.gravity_observer import GravityObserver, MotionWindow
from imucald.mount.gravity_step import GravityStep
from imucald.mount.road_segments import AngleEvidence, ScoreSeries
from imucald.mount.saved_information import (
    GRAVITY_KINDS,
    PastDrives,
    SavedInformation,
    named_series,
    saved_sources,
    together,
)
from imucald.mount.shift import (
    MIN_BEFORE,
    NO_STEPS,
    SPANS,
    Shift,
    largest_change,
)
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock
from imucald.mount.source_variances import widened

SETTLED_BLOCKS = 20
"""Up to this many blocks (128 s), each fit iterates twice, because the rotation still changes
much.
"""
DELAY_AFTER, DELAY_AGAIN = (4, 6, 8, 12, 16), 32
"""Numbers of windows after which the delay is searched at first, and the interval afterwards."""
START_AGAIN = 0.3
"""Largest change of the delay [s], equal to its prior deviation, after which sums with the old
delay stay in use. At a wrong delay, the response to dv/dt may point anywhere, even backwards.
"""
SURE_STD = 0.035
"""Deviation of yaw [rad] below which little of the motion remains in the force."""


class MountSolver:
    """Holds the evidence of one mounting and fits R to it.

    R turns the sensor to axes whose z is the mean vertical of the roads driven, so it still
    contains the crown.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = s = settings
        self.vertical = GravityObserver()
        self.gravity = GravityEvidence()
        self.response = ResponseEvidence()
        self.delay_speed = DelaySearch(s.delays.get("speed", DelayPrior()))
        self.delay_turn = DelaySearch(s.delays.get("yaw_rate", DelayPrior(0.05, 0.1)))
        self.own_gyro = True
        self.turn_rate: Array = np.zeros(BLOCK_TICKS)
        self.lone: Array = np.zeros((BLOCK_TICKS, 3))
        self._window = MotionWindow()
        self.R: Matrix3 | None = None
        self.yaw_known = False
        self.starts = 0
        """Number of times that a first rotation was found."""
        self.fitted_segment = 0
        """Road segment of the last fit."""
        self.fused: Fused | None = None
        self.sources: dict[str, AngleEvidence] = {}
        self.bias: Array | None = None
        self.blocks = 0
        self._cross_axis = CrossAxisFusion(settings)
        self.past_drives: PastDrives | None = None
        self.creep: Creep | None = None
        self._tilt_bias = (0.0, 0.0)
        self._began: deque[int] = deque([0], maxlen=int(SPANS[-1]))  # blocks, of road segments
        self.response.delays = (self.delay_speed.value, 0.0)
        self._gains_of: Array | None = None
        self._motion_of: tuple[object, ...] = (None,) * 3
        self._motion: BlockMotion
        self._gains = (0.0, 0.0)
        self._lever_arm = LeverArm(np.array(settings.lever_arm))

    def start_from(self, other: MountSolver) -> None:
        """Begin with the rotation, gains and delay of another solver, but without its evidence."""
        self.R, self.yaw_known = other.R, other.yaw_known
        self.response.start_from(other.response)
        self.delay_speed, self.delay_turn = other.delay_speed, other.delay_turn
        self.response.without_speed = other.response.without_speed
        self.vertical.steps.start_from(other.vertical.steps)
        self.past_drives = other.past_drives

    def gap(self) -> None:
        """Note a jump of time."""
        self.vertical.restart()
        self._window.restart()
        self._lever_arm.restart()

    def add(self, p: SignalBlock) -> tuple[Array, Array]:
        """Take a block; return dv/dt and v r (N,), zero if they are not trusted."""
        self.blocks += 1
        R = self.R if self.yaw_known else None
        if R is not None and self._lever_arm:
            p = replace(p, force=p.force - self._lever_arm.force(p, R))
        up = self.vertical.up
        r = self._turn_rate(p, up)
        turn = p.speed * r
        gains = self.gains()
        motion = None
        if R is not None and not self.response.without_speed:
            planned = np.zeros((BLOCK_TICKS, 3))
            planned[:, 0] = gains[0] * p.accel * p.ok_speed
            planned[:, 1] = gains[1] * turn * p.ok_speed
            motion = planned @ R
        lone = self.vertical.advance(p, motion, self.bias, self.sure())
        self.lone = lone
        self.gravity.add(p, turn)
        segment = self.response.segment
        self._window.add(p, lone, turn, r, self.vertical)
        self._take_window(float(p.t[-1]))
        if self.response.segment != segment:
            self.gravity.close_segment()
            self._began.append(self.blocks)
        use = p.learn & p.ok_speed
        self.turn_rate = r
        if self.response.without_speed and R is not None:
            return lone @ R[0] * use, turn * use
        return p.accel * use, turn * use

    def motion(self, p: SignalBlock, R: Matrix3) -> BlockMotion:
        """Return the motion of the block that was taken last, in axes of R."""
        gains, delay = self.gains(), self.delay_speed
        made_of = self.lone, R, gains
        if any(map(operator.is_not, made_of, self._motion_of)):  # it is asked for twice a block
            self._motion_of = made_of
            turn = gains[1] * p.speed * self.turn_rate
            force, ahead = self.lone @ R.T, gains[0] * p.accel
            of_delay = delay.value, delay.std
            knots = None if p.speed_knots is None else p.speed_knots - delay.value / TICK_S
            self._motion = BlockMotion(force, ahead, turn, self.turn_rate, *of_delay, knots)
        return self._motion

    def sure(self) -> bool:
        """True if yaw is known well enough to estimate the bias from the residual force.

        The part of yaw's variance that no driving reduces does not count: half of the squared
        cross-axis error.
        """
        if self.fused is None or not self.yaw_known:
            return False
        unseen = 0.5 * self._cross_axis.probable**2
        return self.fused.variance.item(2) - unseen < SURE_STD**2

    def _turn_rate(self, p: SignalBlock, up: Array | None) -> Array:
        if up is not None and np.count_nonzero(p.ok_rate) > 0.5 * len(p.ok_rate):
            self.own_gyro = True
            return np.asarray(p.rate @ up)
        self.own_gyro = False
        return p.yaw_rate * p.ok_yaw

    def gains(self) -> tuple[float, float]:
        """Mean gains of dv/dt and v r in the low bands."""
        of = self.response.gains
        if of is not self._gains_of:  # a fit makes new ones, and never changes them
            self._gains_of = of
            x, y = of[:2, 2:6].sum(axis=1).tolist()
            self._gains = x / 4.0, y / 4.0
        return self._gains

    def _take_window(self, t: float) -> None:
        """Use the window that ends at t [s] for the responses and the delays.

        The delays are searched now and then.
        """
        keep_mean = self.own_gyro and self.yaw_known
        s = self._window.spectra(keep_mean, needs_motion=not self.response.without_speed)
        if s is None:
            return
        self.response.add(s)
        is_new = self.delay_speed.add(s[:, 3], s[:, :3], t)
        if not self.own_gyro:
            self.delay_turn.add(s[:, 4], s[:, :3], t)
        n = self.delay_speed.windows
        if is_new and (n in DELAY_AFTER or n % DELAY_AGAIN == 0):
            tau = self.delay_speed.search()
            late = 0.0 if self.own_gyro else self.delay_turn.search()
            was = self.response.delays
            if abs(tau - was[0]) > START_AGAIN and not self.sure():
                self.yaw_known = False
                self.response.forget_sums()
            if abs(tau - was[0]) > 0.02 or abs(late - was[1]) > 0.02:
                self.response.set_delays(tau, late)

    def fit(self) -> None:
        """Fit the rotation to all evidence so far."""
        self.fitted_segment = self.response.segment
        if not self.gravity.known:
            return
        bias, bias_cov = self.vertical.bias(self._cross_axis.bias_spread)
        if not self.yaw_known:
            self.R, self.yaw_known = first_rotation(self.gravity, self.response)
            self.starts += self.yaw_known and not self.response.without_speed
        for _ in range(2 if self.blocks < SETTLED_BLOCKS else 1):
            if self.R is None:
                return
            responses = self.response.fit(self.R) if self.yaw_known else {}
            sources = self._sources(self.R, bias, bias_cov, responses)
            gains = self.response.slow_gains() if self.own_gyro else None
            turning = self.response.apart(*SAME_NOISE)
            mean = self.gravity.mean_force()
            seen = ForceSeen(mean, bias, bias_cov, gains, responses, turning)
            fused = self._cross_axis.fused(sources, self.R, seen)
            if self.past_drives is not None:
                probable = self._cross_axis.probable
                fused = self.past_drives.fused(sources, self.R, self._tilt_bias, probable)
            self.R = orthonormalised(rotation_from_vector(fused.error) @ self.R)
            self.sources, self.fused = sources, fused
        self.bias = bias

    def _sources(
        self,
        R: Matrix3,
        bias: Array,
        bias_cov: Array,
        responses: Mapping[str, AngleEvidence],
    ) -> dict[str, AngleEvidence]:
        """Return the evidence of responses and of gravity on the error of R, as separate
        sources."""
        s, without_speed = self._settings, self.response.without_speed
        sources: dict[str, AngleEvidence] = {}
        gains, missed = (0.0, 0.0), 1.0
        if self.yaw_known:
            sources = widened(responses, self.own_gyro, without_speed)
            gains, missed = self.gains(), 1.0 if without_speed else 0.1
        ex, ey = self.gravity.tilt(R, bias, gains)
        slope = self.gravity.variance(s.slope_std, s.slope_length, missed)
        b = R @ bias_cov @ R.T / GRAVITY**2
        self._tilt_bias = (float(b[1, 1]), float(b[0, 0]))
        for name, value, of_bias in zip(GRAVITY_KINDS, (ex, ey), self._tilt_bias, strict=True):
            variance = ROAD_SHARE[name] * slope + of_bias
            sources[name] = AngleEvidence(value, variance, 0.0, slope)
        return sources

    def step(self, is_good: bool) -> GravityStep | None:
        """Return a step in gravity in the last minute that the gyroscope did not see.

        This is called for every block.

        is_good: R is served as good.
        """
        if self.R is None or not self.sure() or not self.own_gyro:
            self.vertical.steps.history.go_on()
            return None
        return self.vertical.steps.found(self.R, is_good)

    @property
    def cross_axis_std(self) -> float:
        """Cross-axis error that is assumed (part): the configured or the probable one."""
        return self._cross_axis.std

    @property
    def yaw_seen(self) -> float:
        """Standard deviation of the best single source of yaw [rad], without common errors."""
        found = [one.variance for name, one in self.sources.items() if name.startswith("yaw_")]
        return math.sqrt(min(found, default=math.inf))

    def follow_creep(self, shifts: int) -> None:
        """Test whether the mount creeps; once a road segment. shifts: found in this drive."""
        if self.R is None or self.bias is None or not self.yaw_known:
            return
        series = self.response.series
        if not self.response.without_speed:
            series = series + self._gravity_series(self.R, self.bias)
        sources = dict(self.sources)
        for name, bias in zip(GRAVITY_KINDS, self._tilt_bias, strict=True):
            if name in sources:  # the bias is the same in all segments
                one = sources[name]
                sources[name] = replace(one, variance=one.variance - bias)
        self.creep = found = creep(series, sources, self._settings.CREEP_CHANCE, shifts)
        if found is not None:
            self.response.follow_drift(found.probability * found.rate, found.since_middle)

    @property
    def armed(self) -> bool:
        """True if a change of each angle would be detected. This needs enough road before and after
        it."""
        return self._armed_share(self.response.segment) >= 1.0

    @property
    def armed_share(self) -> float:
        """Share (0 to 1) of the road that `armed` needs."""
        return min(self._armed_share(self.response.blocks / GROUP), 1.0)

    def _armed_share(self, segments: float) -> float:
        before = 0 if self.past_drives is None else self.past_drives.segments
        needed = max(MIN_BEFORE) + SPANS[0]
        return float(min(segments / SPANS[0], (segments + before) / needed))

    def largest_change(self, axes: tuple[int, ...] = (0, 1, 2)) -> Shift | None:
        """Return the change of the mount that fits the last minutes' evidence best."""
        if self.R is None or self.bias is None or not self.yaw_known:
            return None
        if self.response.without_speed:
            return largest_change(self.response.series, (2,))
        series = self._gravity_series(self.R, self.bias)
        found, fresh = self.response.series + series, None
        if self.past_drives is not None:
            fresh = max(len(flow.score) for flow in found)
            found = self.past_drives.series(named_series(found), self.R)
        return largest_change(found, axes, self._steps(), self._settings.unevenness, fresh)

    def _steps(self) -> Array:
        """Return the sizes of steps in gravity at the beginning of the last road segments."""
        steps, began = NO_STEPS.copy(), list(self._began)
        ages = [self.blocks - began[-span] for span in SPANS[: max(len(began) - 1, 0)].tolist()]
        if ages:
            steps[: len(ages)] = self.vertical.steps.history.near(ages)
        return steps

    def _gravity_series(self, R: Matrix3, bias: Array) -> list[ScoreSeries]:
        s = self._settings
        across, along = (s.slope_std * times for times in s.unevenness)
        return self.gravity.series(R, bias, self.gains(), (across, along), s.slope_length)

    def join(self, kept: SavedInformation) -> None:
        """Add the information of past drives; it stays separate and can be dropped again."""
        if self.yaw_known and kept.without_speed == self.response.without_speed:
            crown_std = self._settings.vehicle.crown_std
            self.past_drives = PastDrives(kept, common_errors(self._settings), crown_std)

    def kept(self) -> SavedInformation | None:
        """Return the information for the next start, including that of past drives."""
        if self.R is None or self.fused is None or self.bias is None or not self.yaw_known:
            return None
        gravity = self._gravity_series(self.R, self.bias)
        series = named_series(self.response.series + gravity)
        sources = saved_sources(self.sources, series, self.fused.error, self._tilt_bias)
        now = SavedInformation(self.R, self.response.without_speed, sources)
        return together(None if self.past_drives is None else self.past_drives.kept, now)
