"""Vehicle dynamics: Runge-Kutta in time, a drive cut into many stretches solved side by side.

A vehicle forgets how it got here within a few seconds, so each stretch begins `LEAD_S` early from
rest and only what follows is kept.

Sideways, per unit mass m: lateral velocity v_y, yaw rate r, two axle forces that build up over the
relaxation length s, road-wheel angle d behind the hands, and a load that may swing:

    v_y' = (F_f + F_r) / m - v r - g sin(fall) + wind + slosh
    r'   = (a F_f - b F_r) / I + twist
    x_i' = (v d_i - v_y - a_i r) - |v| x_i / s        x_i: sideways stretch of the tyre's carcass
    F_i  = D_i tanh(C_i x_i / (s D_i))
    d'   = (hands / ratio - d) / lag

At standstill the carcass holds the vehicle like a spring, rolling in reverse needs nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hidden.numerics import GRAVITY, Array, running_mean, stream
from hidden.world import World

LEAD_S = 5.0
STRETCH_S = 9.0
SIDE_DAMPING = 6.0
"""[1/s] of sway on the tyres' carcass; matters at standstill only."""
UNSPRUNG_SHARE = 0.12
HOP_HZ = 11.0
SLOSH_DAMPING = 0.05


@dataclass(frozen=True)
class Handling:
    """(N,) each: what the vehicle does in the plane of the road."""

    hands: Array
    """Steering-wheel angle [rad]."""
    steer: Array
    """Road-wheel angle [rad]."""
    lateral_velocity: Array
    yaw_rate: Array
    load_pull: Array
    """Side force of a load that swings on the body, per mass of the load [m/s^2]."""


@dataclass(frozen=True)
class Body:
    """(N,) each: the body against the road plane."""

    heave: Array
    pitch: Array
    """[rad], positive nose down."""
    roll: Array
    """[rad], positive left side up."""


def in_stretches(
    step: Callable[[Array, Array, Array], Array], start: Array, inputs: Array, rate: float
) -> Array:
    """Solve x_(n+1) = step(x_n, u_n, u_(n+1)) over inputs (N, m); states (N, len(start)).

    step works on columns: (n, K), (m, K), (m, K) -> (n, K).
    """
    n = len(inputs)
    lead, length = round(LEAD_S * rate), round(STRETCH_S * rate)
    firsts = np.arange(0, n, length)
    at = firsts[None, :] + np.arange(-lead, length)[:, None]
    u = np.ascontiguousarray(inputs[np.clip(at, 0, n - 1)].transpose(0, 2, 1))
    x = np.repeat(start[:, None], len(firsts), axis=1)
    kept = np.empty((length, len(start), len(firsts)))
    for k in range(len(u)):
        if k >= lead:
            kept[k - lead] = x
        if k + 1 < len(u):
            x = step(x, u[k], u[k + 1])
    return kept.transpose(2, 0, 1).reshape(-1, len(start))[:n]


def handle(world: World, speed: Array, curvature: Array, fall: Array, rate: float) -> Handling:
    """Drive an intended curvature: the hands do what this vehicle needs for it."""
    felt = running_mean(GRAVITY * np.sin(fall), round(0.4 * rate))
    felt = felt * np.clip(np.abs(speed) / 3.0, 0.0, 1.0) + speed * speed * curvature
    wanted = world.wheelbase * curvature + world.understeer * felt
    hands = world.steering_ratio * wanted
    push, twist = _wind_and_trailer(world, speed, rate)
    down = -GRAVITY * np.sin(fall)
    inputs = np.column_stack([speed, hands / world.steering_ratio, down, push, twist])
    state = in_stretches(_lateral_step(world, 1.0 / rate), np.zeros(7), inputs, rate)
    swinging = _swing(world) * state[:, 5]
    return Handling(hands, state[:, 4], state[:, 0], state[:, 1], swinging)


def _swing(world: World) -> float:
    return float((2.0 * np.pi * world.slosh_hz) ** 2)


def _lateral_step(world: World, h: float) -> Callable[[Array, Array, Array], Array]:
    m, inertia, a = world.mass, world.yaw_inertia, world.to_front
    b = world.wheelbase - a
    rear = world.rear_stiffness
    # The understeer gradient K fixes the front axle: K = m (b / C_f - a / C_r) / L.
    front = b / (world.understeer * world.wheelbase / m + a / rear)
    s = world.relaxation_m
    most_f = world.friction * m * GRAVITY * b / world.wheelbase
    most_r = world.friction * m * GRAVITY * a / world.wheelbase
    swing, slosh = _swing(world), world.slosh_mass
    loss = 2.0 * SLOSH_DAMPING * np.sqrt(swing)

    def rates(x: Array, u: Array) -> Array:
        vy, r, xf, xr, d, y, dy = x
        v, hands, down, push, twist = u
        away = np.abs(v) / s
        force_f = most_f * np.tanh(front / (s * most_f) * xf)
        force_r = most_r * np.tanh(rear / (s * most_r) * xr)
        # At standstill the carcass' own damping ends the sway; a rolling tyre has none to speak of.
        drag = SIDE_DAMPING / (1.0 + 10.0 * v * v)
        back = swing * y
        # Of the mass m only the share 1 - slosh is body; gravity pulls both.
        lateral = ((force_f + force_r) / m + push + slosh * back) / (1.0 - slosh)
        out = np.empty_like(x)
        out[0] = lateral + down - v * r - drag * vy
        out[1] = (a * force_f - b * force_r) / inertia + twist - drag * r
        out[2] = v * d - vy - a * r - away * xf
        out[3] = b * r - vy - away * xr
        out[4] = (hands - d) / world.hands_lag_s
        out[5] = dy
        out[6] = -back - loss * dy - lateral
        return out

    def step(x: Array, u0: Array, u1: Array) -> Array:
        half = 0.5 * (u0 + u1)
        k1 = rates(x, u0)
        k2 = rates(x + 0.5 * h * k1, half)
        k3 = rates(x + 0.5 * h * k2, half)
        k4 = rates(x + h * k3, u1)
        result: Array = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        return result

    return step


def _wind_and_trailer(world: World, speed: Array, rate: float) -> tuple[Array, Array]:
    """Side push per mass [m/s^2] and twist [rad/s^2] from outside; zeros unless an effect asks."""
    push, twist = np.zeros(len(speed)), np.zeros(len(speed))
    t = np.arange(len(speed)) / rate
    if world.gusts > 0.0:
        rng = stream(world.seed, "gusts")
        wind = np.zeros(len(t))
        for start in np.cumsum(rng.uniform(2.0, 10.0, int(t[-1] / 5.0) + 9)):
            width, size = rng.uniform(0.4, 1.8), rng.normal(0.0, 1.0)
            near = np.abs(t - start) < 4.0 * width
            wind[near] += size * np.exp(-(((t[near] - start) / width) ** 2))
        # The moving air meets a moving vehicle: it grows with speed.
        amount = wind / np.sqrt(np.mean(wind**2)) * np.clip(np.abs(speed) / 20.0, 0.0, 1.3)
        push += world.gusts * amount
        # The wind acts ahead of the centre of gravity.
        twist += world.gusts * amount * 0.45 * world.mass / world.yaw_inertia
    if world.sway > 0.0:
        rng = stream(world.seed, "sway")
        phase = 2.0 * np.pi * np.cumsum(0.55 + 0.006 * np.abs(speed)) / rate
        envelope = np.zeros(len(t))
        for start in np.cumsum(rng.exponential(14.0, int(t[-1] / 14.0) + 20)):
            after = t - start
            envelope += rng.uniform(0.5, 1.5) * np.where(
                after > 0.0, np.clip(after, 0, 1) * np.exp(-np.maximum(after, 0.0) / 5.0), 0.0
            )
        fast = np.clip((np.abs(speed) - 7.0) / 13.0, 0.0, 1.2)
        pull = world.sway * fast * envelope * np.sin(phase)
        push += pull
        twist -= pull * (world.wheelbase - world.to_front + 0.9) * world.mass / world.yaw_inertia
    return push, twist


def lean(world: World, force_x: Array, force_y: Array, wheels: Array, rate: float) -> Body:
    """Body on springs: three modes (heave, pitch, roll), each with its unsprung mass.

    force_x, force_y: (N,) specific force in road axes; wheels: (N, 4) heights [m].
    """
    squat = np.where(force_x > 0.0, world.squat, world.dive)
    asked = np.column_stack(
        [np.zeros(len(force_x)), -squat * force_x, world.roll_gradient * force_y]
    )
    front, rear = wheels[:, :2].mean(axis=1), wheels[:, 2:].mean(axis=1)
    left, right = wheels[:, ::2].mean(axis=1), wheels[:, 1::2].mean(axis=1)
    uneven = np.column_stack(
        [0.5 * (front + rear), (rear - front) / world.wheelbase, (left - right) / world.track]
    )
    state = np.zeros((len(force_x), 12))
    inputs = np.concatenate([asked, uneven], axis=1)
    state = in_stretches(_spring_step(world, 1.0 / rate), np.zeros(12), inputs, rate)
    return Body(state[:, 0], state[:, 1], state[:, 2])


def _spring_step(world: World, h: float) -> Callable[[Array, Array, Array], Array]:
    """One Runge-Kutta step of a linear system is a linear map: found once, then applied."""
    A, B = np.zeros((12, 12)), np.zeros((12, 6))
    tyre = (2.0 * np.pi * HOP_HZ) ** 2
    for i, hz in enumerate((world.heave_hz, world.pitch_hz, world.roll_hz)):
        x, dx, z, dz = i, i + 3, i + 6, i + 9
        k = (2.0 * np.pi * hz) ** 2
        # The mode's frequency is that of body on spring and tyre in series.
        k = k / (1.0 - k / (UNSPRUNG_SHARE * tyre))
        c = 2.0 * world.damping * np.sqrt(k)
        A[x, dx] = A[z, dz] = 1.0
        A[dx, [x, z, dx, dz]] = [-k, k, -c, c]
        A[dz, [x, z, dx, dz]] = np.array([k, -k, c, -c]) / UNSPRUNG_SHARE
        A[dz, z] -= tyre
        B[dz, 3 + i] = tyre
        # A steady moment leans the body by what is asked, springs and tyres together.
        B[dx, i] = 1.0 / (1.0 / k + 1.0 / (UNSPRUNG_SHARE * tyre))

    def step(x: Array, u0: Array, u1: Array) -> Array:
        um = 0.5 * (u0 + u1)
        k1 = A @ x + B @ u0
        k2 = A @ (x + 0.5 * h * k1) + B @ um
        k3 = A @ (x + 0.5 * h * k2) + B @ um
        k4 = A @ (x + h * k3) + B @ u1
        return np.asarray(x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4))

    P = step(np.eye(12), np.zeros((6, 12)), np.zeros((6, 12)))
    zero = np.zeros((12, 6))
    G0 = step(zero, np.eye(6), np.zeros((6, 6)))
    G1 = step(zero, np.zeros((6, 6)), np.eye(6))
    return lambda x, u0, u1: P @ x + G0 @ u0 + G1 @ u1
