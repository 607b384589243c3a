"""Single-track vehicle with saturating tyres: it gives yaw rate and sideslip from the steering
angle.

States: lateral velocity v_y of the centre of gravity and yaw rate r, in road axes.

    m (dv_y/dt + v r + g sin(bank)) = F_f + F_r
    I dr/dt                          = l_f F_f - l_r F_r
    F_i = C_i a_i / sqrt(1 + (C_i a_i / D_i)^2),  D_i = friction * axle load
    a_f = (delta v - v_y - l_f r) / |v|,          a_r = (-v_y + l_r r) / |v|

(Rajamani, Vehicle Dynamics and Control, ch. 2; the tyre is a smooth curve with the slope C and the
limit D.) A minute of driving is solved at once by second-order backward differences, with Newton's
method for the tyre and one banded system per iteration. The stiff equations at low speed therefore
need no small time steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, solve_banded

from imucald.core.arrays import Array
from imucald.core.errors import ConfigError
from imucald.core.samples import GRAVITY
from imucald.model.vehicle import Chassis

LOW_SPEED_MPS = 0.2
"""Speed v0 that avoids a division by zero [m/s]: |v| in the slip angles is replaced by sqrt(v^2 +
v0^2)."""
BLOCK_S = 60.0
LEAD_S = 6.0
"""Time by which each block of the solution starts earlier [s]. A block starts in a steady turn, and
the effect of this start decays within tenths of a second. Small blocks keep the system of equations
in the processor's cache."""
LOST = 15.0
"""Sideways speed [m/s] or yaw rate [rad/s] above which a vehicle has left the road."""


@dataclass(frozen=True)
class VehicleResponse:
    """Response of the vehicle, (N,) each."""

    yaw_rate: Array
    """Yaw rate about the normal of the road [rad/s]."""
    lateral_velocity: Array
    """Lateral velocity of the centre of gravity, positive to the left [m/s]."""
    lateral_velocity_rate: Array
    steer: Array
    """Road-wheel angle [rad], positive to the left."""


def steer_for(chassis: Chassis, speed: Array, curvature: Array, bank: Array) -> Array:
    """Return the steering angle for a steady curvature: delta = L k + K (v^2 k + g bank)."""
    # Drivers do not steer against a bank at standstill, so it counts only when the vehicle rolls.
    rolling = speed * speed / (speed * speed + 1.0)
    felt = speed * speed * curvature + GRAVITY * np.sin(bank) * rolling
    return chassis.wheelbase_m * curvature + chassis.understeer_gradient * felt


def handle(
    chassis: Chassis, speed: Array, steer: Array, bank: Array, rate: float
) -> VehicleResponse:
    """Return the response of the vehicle to speed, steer and bank, (N,) each at `rate` [Hz]. speed:
    signed [m/s]. steer, bank: [rad]."""
    if not chassis.single_track:
        curvature = steer / chassis.wheelbase_m
        zero = np.zeros(len(speed))
        return VehicleResponse(speed * curvature, zero, zero, steer)
    n, block, lead = len(speed), round(BLOCK_S * rate), round(LEAD_S * rate)
    state = np.empty((n, 2))
    for start in range(0, n, block):
        first = max(0, start - lead)
        span = slice(first, min(start + block, n))
        solved = _solved(chassis, speed[span], steer[span], bank[span], rate)
        state[start : span.stop] = solved[start - first :]
    if not np.max(np.abs(state)) < LOST:
        raise ConfigError(
            "the simulated vehicle slides off the road: raise chassis.friction or "
            "chassis.understeer_gradient, or choose gentler bends and banks"
        )
    return VehicleResponse(
        yaw_rate=np.ascontiguousarray(state[:, 1]),
        lateral_velocity=np.ascontiguousarray(state[:, 0]),
        lateral_velocity_rate=np.gradient(state[:, 0]) * rate,
        steer=steer,
    )


def _solved(chassis: Chassis, speed: Array, steer: Array, bank: Array, rate: float) -> Array:
    """Return the states (N, 2) of a segment that begins in a steady turn."""
    state = np.zeros((len(speed), 2))
    state[:, 1] = _steady_yaw_rate(chassis, speed, steer)
    state[:, 0] = chassis.cg_to_rear_m * state[:, 1]
    forcing = np.column_stack((-GRAVITY * np.sin(bank), np.zeros(len(speed))))
    with np.errstate(all="ignore"):
        for _ in range(25):
            acceleration, jacobian = _dynamics(chassis, speed, steer, state)
            try:
                change = _newton_step(state, acceleration + forcing, jacobian, rate)
            except LinAlgError:
                break
            state += change
            if float(np.max(np.abs(change))) < 1e-9:
                return state
    return _stepped(chassis, speed, steer, forcing, rate)


def _stepped(chassis: Chassis, speed: Array, steer: Array, forcing: Array, rate: float) -> Array:
    """Solve by linearly implicit Euler steps. The steps are of first order, and also work for a
    sliding vehicle.

    The function is used for segments in which Newton's method does not converge, as on ice.
    """
    state = np.zeros((len(speed), 2))
    state[0, 1] = float(_steady_yaw_rate(chassis, speed[:1], steer[:1])[0])
    identity = np.eye(2) * rate
    for k in range(1, len(speed)):
        here = slice(k, k + 1)
        f, J = _dynamics(chassis, speed[here], steer[here], state[k - 1 : k])
        state[k] = state[k - 1] + np.linalg.solve(identity - J[0], f[0] + forcing[k])
    return state


def _steady_yaw_rate(chassis: Chassis, speed: Array, steer: Array) -> Array:
    denominator = chassis.wheelbase_m + chassis.understeer_gradient * speed * speed
    return speed * steer / np.maximum(denominator, 0.5)


def _tyre(stiffness: float, limit: float | None, slip: Array) -> tuple[Array, Array]:
    """Return the tyre force and its derivative with respect to the slip angle."""
    if limit is None:
        return stiffness * slip, np.full(len(slip), stiffness)
    root = 1.0 / np.sqrt(1.0 + (stiffness / limit * slip) ** 2)
    return stiffness * slip * root, stiffness * root**3


def _dynamics(
    chassis: Chassis, v: Array, steer: Array, state: Array
) -> tuple[Array, NDArray[np.float64]]:
    """Return the derivative of the state (N, 2) without gravity, and its Jacobian (N, 2, 2)."""
    front, rear, m = chassis.cg_to_front_m, chassis.cg_to_rear_m, chassis.mass_kg
    weight = m * GRAVITY / chassis.wheelbase_m * chassis.friction
    limits = (weight * rear, weight * front) if chassis.tyre_saturation else (None, None)
    vy, r = state[:, 0], state[:, 1]
    inverse = 1.0 / np.sqrt(v * v + LOW_SPEED_MPS**2)
    slip_f = (steer * v - vy - front * r) * inverse
    slip_r = (rear * r - vy) * inverse
    force_f, slope_f = _tyre(chassis.front_cornering_stiffness_npr, limits[0], slip_f)
    force_r, slope_r = _tyre(chassis.rear_cornering_stiffness_npr, limits[1], slip_r)
    slope_f, slope_r = slope_f * inverse, slope_r * inverse
    inertia = chassis.yaw_inertia_kgm2
    rates = np.column_stack(
        ((force_f + force_r) / m - v * r, (front * force_f - rear * force_r) / inertia)
    )
    jacobian = np.empty((len(v), 2, 2))
    jacobian[:, 0, 0] = -(slope_f + slope_r) / m
    jacobian[:, 0, 1] = (rear * slope_r - front * slope_f) / m - v
    jacobian[:, 1, 0] = (rear * slope_r - front * slope_f) / inertia
    jacobian[:, 1, 1] = -(front * front * slope_f + rear * rear * slope_r) / inertia
    return rates, jacobian


def _newton_step(state: Array, f: Array, jacobian: Array, rate: float) -> Array:
    """Solve the linearised difference equations. Node 0 is fixed to its steady state."""
    n = len(state)
    band = np.zeros((6, 2 * n))  # solve_banded with four lower and one upper diagonal
    residual = np.empty((n, 2))
    diagonal = np.full(n, 1.5 * rate)
    diagonal[0], diagonal[1 : min(2, n)] = 0.0, rate
    residual[0] = -f[0]
    residual[1:2] = (state[1:2] - state[0:1]) * rate - f[1:2]
    residual[2:] = (1.5 * state[2:] - 2.0 * state[1:-1] + 0.5 * state[:-2]) * rate - f[2:]
    for i in range(2):
        band[1, i::2] = diagonal - jacobian[:, i, i]
        # Column c of rows k+1 and k+2: values one and two steps earlier.
        band[3, i : 2 * n - 2 : 2] = -2.0 * rate
        band[3, i] = -rate
        band[5, i : 2 * n - 4 : 2] = 0.5 * rate
    band[0, 1::2] = -jacobian[:, 0, 1]
    band[2, 0::2] = -jacobian[:, 1, 0]
    step: Array = solve_banded(
        (4, 1), band, -residual.ravel(), overwrite_ab=True, overwrite_b=True, check_finite=False
    ).reshape(n, 2)
    return step
