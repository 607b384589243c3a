"""Estimate the speed in a drive without a speed signal. The speed is an unknown state with a prior.

    dv/dt = f_x - g u_x                 v: speed; f: force, in body axes
    du_x/dt = r u_y - q + z_q           u: horizontal part of the vertical
    du_y/dt = p - z_p - r u_x           (p, q, r): rate of the body; z: zero error
    f_y = v r + g u_y + noise           v = 0 at rest
    u contains the slope of the road, which changes with distance

A Kalman filter estimates the speed v, the vertical u and the zero errors z. The filter predicts
f_y. The unpredicted part of f_y contains the evidence for other errors: cross-talk, a lever arm, a
lag. The effects of these errors on f_x, f_y and u go through the same filter. A fit of these
effects to the unpredicted part is therefore equal to a joint fit of the errors and the speed.

Without gyroscope data, u cannot be integrated. In this case, the model of u is a first-order Markov
process along the road.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.core.samples import GRAVITY
from imucald.drive.roads import SLOPE_M, slope_way
from imucald.drive.vertical import VERTICAL_WALK
from imucald.motion.ticks import TICK_S

NAMES: Final = (
    "left", "xy", "yx", "tilted x", "tilted y", "dp/dt", "dr/dt", "r^2", "v", "d(v r)/dt",
    "dv/dt v r", "(v r)^2", "r^2 ahead", "dr/dt ahead", "gain",
)  # fmt: skip
"""Columns of `EliminatedSpeed`: the unpredicted part of f_y ("left"), and the responses of this
part to errors of size one.

xy: error of v r (speed times yaw rate) in f_x. yx: error of dv/dt in f_y. v: zero error of the turn
rate. tilted: cross-talk of the rate from z to x and to y. ahead: error in f_x. All other errors are
in f_y.
"""
_XY, _TILTED_X, _TILTED_Y, _ROUND_AHEAD, _ARM_AHEAD = (
    NAMES.index(n) for n in ("xy", "tilted x", "tilted y", "r^2 ahead", "dr/dt ahead")
)
_OF_RATES: Final = tuple(NAMES.index(n) for n in ("dp/dt", "dr/dt", "r^2"))
_YX, _TURN, _LAG, _BOTH, _SQUARE, _GAIN = (
    NAMES.index(n) for n in ("yx", "v", "d(v r)/dt", "dv/dt v r", "(v r)^2", "gain")
)
AHEAD, ACROSS = 0.01, 0.02
"""Noise of f_x and f_y in a tick [(m/s^2)^2].

The values have the size of `joint.evidence.USUAL_NOISE` and include the correlation of the noise in
time. The values were chosen on the simulated drives with the seeds 9000 to 9009.
"""
RATE_ZERO, RATE_WALK = 0.001, 1e-9
"""Standard deviation of the rate's zero error after a measurement at rest [rad/s], and growth of
the variance of this zero error [(rad/s)^2/s].

The growth corresponds to a change of 0.014 deg/s in a minute while the sensor warms up
(assumption).
"""
FIRST_SPEED, FIRST_STD = 8.0, 10.0
"""Assumed speed before any evidence about the speed, and standard deviation of this speed [m/s]."""
REST_STD = 0.1
"""Standard deviation of the speed while the vehicle is as still as a parked vehicle [m/s]."""
EXPECTED = 2.0
"""Largest estimated speed, in standard deviations, at which a still sensor means that the vehicle
is at rest. At a higher estimated speed, the vehicle may be cruising smoothly.
"""
BLIND = 1.0
"""Assumed acceleration in a tick without a usable force [m/s^2]."""
STANDING = 1.0
"""Speed that is added to the absolute speed for the computation of distances [m/s]."""
PULLED = 8
"""Number of ticks between two uses of the prior of the slope."""
V, U_X, U_Y = 0, 1, 2


class EliminatedSpeed(NamedTuple):
    """Result for N ticks. speed (N,) [m/s] and turn rate (N,) [rad/s] are the values before the
    measurement of f_y in the tick.

    accel: (N,) f_x - g u_x [m/s^2]. left: (N, 2) level force without the motion [m/s^2], computed
    with the speed after the measurement of f_y. columns: (N, len(NAMES)) scaled by the deviation in
    each tick.
    """

    speed: Array
    accel: Array
    turn: Array
    left: Array
    columns: Array


class Steered(NamedTuple):
    """Turn rates that were computed from a steering angle for a fixed speed [m/s].

    understeer: understeer gradient divided by the wheelbase, K / L [s^2/m^2].
    """

    speed: float
    understeer: float

    def share(self, v: float) -> float:
        """Return the ratio of the turn rate at a speed v [m/s] to the turn rate at the fixed
        speed."""
        s, k = self.speed, self.understeer
        return v / s * (1.0 + k * s * s) / (1.0 + k * v * v)

    def slope(self, v: float) -> float:
        """Return the derivative of v r (speed times yaw rate) with respect to v, as a multiple of
        r.
        """
        return 2.0 / (1.0 + self.understeer * v * v)


class UnknownSpeed:
    """Estimates the speed from block to block.

    is_carried: the vertical is integrated with a gyroscope. steered: the turn rate is computed from
    a steering angle; None: the turn rate is measured. slope: deviation of a road's slope. lean:
    mean slope across the road.
    """

    def __init__(
        self, slope: float, lean: float, is_carried: bool, steered: Steered | None
    ) -> None:
        self._slope, self._lean = slope, lean
        self._is_carried, self._steered = is_carried, steered
        self._states: Array = np.zeros((5, len(NAMES)))
        self.restart()

    def restart(self, is_same_drive: bool = False) -> None:
        """Begin again, because time jumped or the axes have changed.

        is_same_drive: begin with the last speed as the most likely speed. The deviation of this
        speed is the deviation of an unknown speed.
        """
        v = float(self._states[V, 0]) if is_same_drive else FIRST_SPEED
        zero = RATE_ZERO if self._is_carried else 0.0
        std = [FIRST_STD, self._slope, self._slope, zero, zero]
        self._covariance = np.diag(np.square(std))
        self._states = np.zeros((5, len(NAMES)))
        self._states[:3, 0] = v, 0.0, self._lean
        self._transition = np.eye(5)
        self._transition[V, U_X] = -GRAVITY * TICK_S
        walk = [0.0, 0.0, TICK_S * RATE_WALK, TICK_S * RATE_WALK]
        self._growth = np.diag([AHEAD * TICK_S**2, *walk])

    @property
    def std(self) -> float:
        """Deviation of the speed [m/s]."""
        return math.sqrt(max(float(self._covariance[V, V]), 0.0))

    def follow(self, force: Array, rate: Array, rest: Flags, use: Flags) -> EliminatedSpeed:
        """Process N ticks. force, rate: (N, 3) in body axes. rest: (N,) flags: the vehicle is as
        still as a parked vehicle. use: (N,) flags of the usable ticks.
        """
        n = len(force)
        given, seen = self._inputs(force, rate)
        speed, turn, ahead, level = np.empty(n), np.empty(n), np.empty(n), np.empty((n, 2))
        columns, h = np.empty((n, len(NAMES))), np.array([0.0, 0.0, GRAVITY, 0.0, 0.0])
        turns, last = rate[:, 2].tolist(), float("nan")
        for k in range(n):
            before = v = float(self._states[V, 0])
            r = self._turn(turns[k], v)
            given[k, V, _XY] = TICK_S * v * r
            if not use[k]:
                given[k, V, 0] = TICK_S * GRAVITY * self._states[U_X, 0]
            self._predict(given[k], v, r, bool(use[k]))
            if self._is_carried and use[k] and k % PULLED == 0:
                self._pull_to_roads(v)
            if rest[k]:
                self._come_to_rest()
            v = float(self._states[V, 0])
            r = self._turn(turns[k], v)
            accel, lateral = float(force[k, 0] - GRAVITY * self._states[U_X, 0]), v * r
            row = seen[k]
            row[_YX], row[_LAG] = accel, 0.0 if math.isnan(last) else (lateral - last) / TICK_S
            row[_BOTH], row[_SQUARE], row[_GAIN] = accel * lateral, lateral * lateral, lateral
            row[_TURN], h[V], last = v, r, lateral
            if self._steered is not None:
                row[_TURN], h[V] = v * self._steered.share(v), r * self._steered.slope(v)
            off = row - h @ self._states
            off[0] += h[V] * v - lateral
            Ph = self._covariance @ h
            variance = float(h @ Ph) + ACROSS
            speed[k], turn[k], ahead[k] = v, r, accel
            columns[k] = math.sqrt(ACROSS / variance) * off
            if use[k] and not rest[k]:
                self._take(Ph, off, variance)
            after = float(self._states[V, 0])
            level[k] = (after - before) / TICK_S, after * r
        self._covariance = 0.5 * (self._covariance + self._covariance.T)
        return EliminatedSpeed(speed, ahead, turn, force[:, :2] - level, columns)

    def _turn(self, r: float, v: float) -> float:
        return r if self._steered is None else r * self._steered.share(v)

    def _predict(self, given: Array, v: float, r: float, is_usable: bool) -> None:
        """Predict the states over one tick. given: (5, len(NAMES)) inputs of the states."""
        F, Q = self._transition, self._growth
        if self._is_carried and is_usable:
            stays, grows, turned, wrong = 1.0, VERTICAL_WALK**2 * TICK_S, r * TICK_S, TICK_S
        else:
            share = (slope_way(v) + STANDING) * TICK_S / SLOPE_M
            stays, grows = math.exp(-2.0 * share), 4.0 * share * self._slope**2
            turned = wrong = 0.0
            given[U_X : U_Y + 1] = 0.0
            given[U_Y, 0] = (1.0 - stays) * self._lean
        F[U_X, U_X] = F[U_Y, U_Y] = stays
        Q[U_X, U_X] = Q[U_Y, U_Y] = grows
        F[U_X, U_Y], F[U_Y, U_X], F[U_X, 4], F[U_Y, 3] = turned, -turned, wrong, -wrong
        self._states = F @ self._states + given
        self._covariance = F @ self._covariance @ F.T + Q
        if not is_usable:
            self._covariance[V, V] += (BLIND * TICK_S) ** 2

    def _pull_to_roads(self, v: float) -> None:
        """Apply the prior of the slopes for the last `PULLED` ticks."""
        share = PULLED * (slope_way(v) + STANDING) * TICK_S / SLOPE_M
        for i, mean in ((U_X, 0.0), (U_Y, self._lean)):
            off = -self._states[i]
            off[0] += mean
            Ph = self._covariance[:, i].copy()
            self._take(Ph, off, float(Ph[i]) + self._slope**2 / share)

    def _come_to_rest(self) -> None:
        """Set the speed to zero because the vehicle is still, if the speed is close enough to
        zero."""
        Ph = self._covariance[:, V].copy()
        variance = float(Ph[V]) + REST_STD**2
        if self._states[V, 0] ** 2 < EXPECTED**2 * variance:
            self._take(Ph, -self._states[V], variance)

    def _take(self, Ph: Array, off: Array, variance: float) -> None:
        """Correct the states with a measurement. off: (len(NAMES),) innovations."""
        K = Ph / variance
        self._states = self._states + np.outer(K, off)
        self._covariance = self._covariance - np.outer(K, Ph)

    def _inputs(self, force: Array, rate: Array) -> tuple[Array, Array]:
        """Return the inputs of the states (N, 5, columns), and the measurements (N, columns): f_y
        and the errors that add to f_y.
        """
        n, dt = len(force), TICK_S
        p, q, r = rate.T
        slopes = np.gradient(rate[:, ::2], dt, axis=0).T
        given, seen = np.zeros((n, 5, len(NAMES))), np.zeros((n, len(NAMES)))
        given[:, V, 0] = dt * force[:, 0]
        if self._is_carried:
            given[:, U_X, 0], given[:, U_Y, 0] = -dt * q, dt * p
            given[:, U_Y, _TILTED_X], given[:, U_X, _TILTED_Y] = dt * r, -dt * r
        given[:, V, _ROUND_AHEAD], given[:, V, _ARM_AHEAD] = dt * r * r, dt * slopes[1]
        seen[:, 0] = force[:, 1]
        seen[:, _OF_RATES] = np.column_stack([slopes[0], slopes[1], r * r])
        return given, seen
