"""Force without gravity, and turn rate, of each block, computed with the rotation that is known so
far.

The specific force is f_s = R^T m + g u + b, with u the vertical in sensor axes, m the motion
(dv/dt, v r, -v q) and b the accelerometer's zero error. The vertical is integrated with the
gyroscope (`gravity_observer`). The tests for faults and for a moved sensor compare the force
without gravity, and the turn rate, with the motion that the vehicle's signals show.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3, levelling_rotation, rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.drive.roads import road_slopes, road_weight
from imucald.motion.ticks import TICK_S
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.gravity_observer import GravityObserver
from imucald.mount.joint.evidence import Evidence
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock

KNOWN_STD = 0.2
"""Deviation below which a delay counts as known [s]: dv/dt of a manoeuvre of some seconds then
still correlates with the force.
"""
SURE = 0.035
"""Deviation of the cross-talk below which little of the motion remains in the estimated gravity."""


class Delay(NamedTuple):
    """Delay of the speed against the force, and its deviation [s].

    is_beyond: the best delay is the largest searched delay, so the true delay may be larger.
    """

    value: float = 0.0
    std: float = math.inf
    is_beyond: bool = False

    @property
    def is_known(self) -> bool:
        """True if the delay is known well enough to compare the shifted speed with the force."""
        return self.std < KNOWN_STD and not self.is_beyond


class MeanGravity:
    """Mean of the specific force over the road driven, for a mount that is levelled by gravity
    alone.

    metres: distance [m]. stops: number of stops.
    """

    def __init__(self) -> None:
        self._weight, self._sum = 0.0, np.zeros(5)  # force (3,), dv/dt, v r
        self.metres, self.stops, self._is_resting = 0.0, 0, False

    def add_block(self, p: SignalBlock, turn: Array) -> None:
        """Process a block. turn: (N,) v r (speed times yaw rate) [m/s^2]."""
        use = p.learn & (p.ok_speed | p.rest)
        if not use.any():
            return
        speed = np.where(p.ok_speed, p.speed, 0.0)
        weight = road_weight(speed, use)
        self._weight += float(weight.sum())
        self._sum += weight @ np.column_stack([p.force, p.accel, turn])
        self.metres += float((np.abs(speed) * use).sum()) * TICK_S
        is_resting = bool((p.rest & use).any())
        self.stops += is_resting and not self._is_resting
        self._is_resting = is_resting

    @property
    def known(self) -> bool:
        """True if a direction of gravity is known."""
        return self._weight > 0.0

    def levelled(self, slope: float) -> tuple[Matrix3, Array]:
        """Return the rotation from gravity alone and its variances about x and y [rad^2].

        The mean motion counts as an error, because it cannot be subtracted while the yaw is
        unknown. slope: deviation of a road's slope.
        """
        mean = self._sum / self._weight
        along, across = road_slopes(np.zeros((0, 4)), slope).over(np.array([self.metres]))[0]
        motion = float(mean[3:] @ mean[3:]) / GRAVITY**2
        return levelling_rotation(mean[:3]), np.array([across, along]) + motion


class CarriedForce:
    """The direction of gravity, integrated through all blocks since the sensor was moved, and the
    present estimates.

    R: (3, 3) rotation from the sensor to axes whose z is the mean vertical of the roads driven; the
    lean of the vehicle on a crowned road is therefore still in R. R is None before there is any
    evidence. gains: gains of the force relative to dv/dt and v r (speed times yaw rate). bias: zero
    error of the accelerometer in sensor axes [m/s^2]. is_sure: the cross-talk is known well enough
    to subtract the motion from the force. lone: (N, 3) force of the last block without gravity, in
    sensor axes; the motion is still in it.
    turn_rate: (N,) turn rate of the last block [rad/s]. own_gyro: True if the turn rate comes from
    the sensor's own gyroscope.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._settings = settings
        self.vertical = GravityObserver()
        self.gravity = MeanGravity()
        self.own_gyro = True
        self.turn_rate: Array = np.zeros(BLOCK_TICKS)
        self.lone: Array = np.zeros((BLOCK_TICKS, 3))
        self.R: Matrix3 | None = None
        self.delay, self.gains, self.bias = Delay(), (1.0, 1.0), np.zeros(3)
        self.is_sure = False
        self.variances: Mapping[str, float] = {}
        """Variance of the angle from each kind of evidence alone [rad^2]."""

    def start_from(self, other: CarriedForce, turn: Array | None = None) -> None:
        """Begin with the rotation, gains, zero error and delay of another object.

        turn: rotation vector (3,) by which the sensor has turned since, in vehicle axes [rad].
        """
        self.R, self.gains, self.bias, self.delay = other.R, other.gains, other.bias, other.delay
        if turn is not None and self.R is not None:
            self.R = rotation_from_vector(turn) @ self.R

    def gap(self) -> None:
        """Note a jump of time."""
        self.vertical.restart()

    def follow(self, evidence: Evidence) -> bool:
        """Use the present estimates of the evidence. Returns True if these estimates contain the
        first rotation."""
        rotation, solution = evidence.rotation, evidence.solution
        if rotation is None:
            return False
        is_first = self.R is None
        self.R = rotation_from_vector([self._settings.crown, 0.0, 0.0]) @ rotation
        self.delay = Delay(evidence.delay, evidence.delay_std, evidence.is_delay_beyond)
        self.gains, self.bias, self.variances = evidence.gains, evidence.bias, evidence.variances
        if solution is not None and evidence.signals.speed:  # else the motion is in the vertical
            sent = solution.sent()
            self.is_sure = max(sent.xy, sent.yx) < SURE
        return is_first

    def take_block(self, p: SignalBlock) -> tuple[Array, Array]:
        """Process a block.

        Returns dv/dt and v r (speed times yaw rate) (N,), with zeros in the ticks that are not
        trusted."""
        R = self.R
        r = self._turn_rate(p, self.vertical.up)
        turn = p.speed * r
        self.lone = self._without_gravity(p, turn)
        self.gravity.add_block(p, turn)
        self.turn_rate = r
        use = p.learn & p.ok_speed
        if R is not None and not p.has_speed:
            return self.lone @ R[0] * use, self.lone @ R[1] * use
        return p.accel * use, turn * use

    def _turn_rate(self, p: SignalBlock, up: Array | None) -> Array:
        if up is not None and np.count_nonzero(p.ok_rate) > 0.5 * len(p.ok_rate):
            self.own_gyro = True
            return np.asarray(p.rate @ up)
        self.own_gyro = False
        return p.yaw_rate * p.ok_yaw

    def _without_gravity(self, p: SignalBlock, turn: Array) -> Array:
        """Integrate the vertical through a block, and return f_s - b - g u (N, 3). turn: (N,) v r
        [m/s^2]."""
        motion = None
        if self.R is not None and p.has_speed:
            a, b = self.gains
            motion = np.column_stack([a * p.accel, b * turn]) * p.ok_speed[:, None] @ self.R[:2]
        return self.vertical.advance(p, motion, self.bias)

    def levelled(self, zero_std: float) -> tuple[Matrix3, Array] | None:
        """Return the rotation from gravity alone and its variances about x and y, or None before
        gravity is known.

        zero_std: deviation of the accelerometer's zero error [m/s^2].
        """
        if not self.gravity.known:
            return None
        level, variance = self.gravity.levelled(self._settings.slope)
        crown = rotation_from_vector([-self._settings.crown, 0.0, 0.0])
        return crown @ level, variance + (zero_std / GRAVITY) ** 2
