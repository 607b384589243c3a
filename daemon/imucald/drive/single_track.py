"""Tyres of a car: its sideslip, and its yaw rate from the steering angle, by a linear single-track
model with tyre relaxation.

The model uses S_k = a^k C_f + (-b)^k C_r, and h = 1 + s sigma/v for the build-up of the tyre force:

    m h v_y' = C_f d - S_0 v_y/v - S_1 r/v - m h v r,   I h r' = a C_f d - S_1 v_y/v - S_2 r/v

(Rajamani, Vehicle Dynamics and Control, ch. 2; Pacejka, Tyre and Vehicle Dynamics, ch. 5)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.drive.equations import Complex
from imucald.model.vehicle import STEERING_GEAR_S, Chassis
from imucald.motion.ticks import TICK_S

SLOW_MPS = 2.5
"""Speed [m/s] below which play and tyres determine the yaw rate, and not the steering angle."""
RELAXATION_M = 0.4
"""Distance over which the side force of a tyre builds up [m]: 0.2 to 0.6 m in cars."""
LEVEL_MPS = 4.0
"""Spacing of the speeds at which the model is solved [m/s]. Solutions are interpolated between
these speeds."""


def _called(make: Callable[..., Any], *inputs: Any) -> Any:
    return make(*inputs)


def followed_angle(
    steer: Array, speed: Array, chassis: Chassis, gradient: float,
    once: Callable[..., Any] = _called,
) -> Array:  # fmt: skip
    """Return the steering angle that the yaw rate has followed. The gain is 1 for a steady angle.

    steer: (N,) [rad], speed: (N,) [m/s], both at intervals of `TICK_S`. gradient: understeer
    gradient [rad/(m/s^2)]. once: calls a function, and may keep its result.
    """
    spectrum = once(spectrum_of, steer)
    place = np.maximum(speed, SLOW_MPS) / LEVEL_MPS
    made = np.zeros(len(steer))
    for level in range(int(place.min()), int(place.max()) + 2):
        share = np.clip(1.0 - np.abs(place - level), 0.0, 1.0)
        if share.any():
            response = once(response_at, len(steer), level, chassis, gradient)
            made += share * once(at_level, spectrum, response, len(steer))
    return made


def frequencies(n: int) -> Complex:
    """Return s = i w (n + 1,) [rad/s] for n samples of the grid. The series of samples is mirrored
    at its end."""
    return np.asarray(2j * np.pi * np.fft.rfftfreq(2 * n, TICK_S))


def spectrum_of(steer: Array) -> Complex:
    """Return the spectrum (N + 1,) of the angle behind the steering gear. The series is mirrored at
    its end, so that it has no jump from the last angle to the first."""
    gear = np.exp(-STEERING_GEAR_S * frequencies(len(steer)))
    return np.asarray(np.fft.rfft(np.concatenate([steer, steer[::-1]])) * gear)


def at_level(spectrum: Complex, response: Complex, n: int) -> Array:
    """Return the followed angle (n,) at one speed."""
    return np.asarray(np.fft.irfft(spectrum * response / response[0], 2 * n)[:n])


def response_at(n: int, level: int, chassis: Chassis, gradient: float) -> Complex:
    """Return the frequency response (n + 1,) from the angle to the followed angle, at one speed of
    the spacing `LEVEL_MPS`."""
    c, s = chassis, frequencies(n)
    rear, length, m = c.rear_cornering_stiffness_npr, c.wheelbase_m, c.mass_kg
    a, b, inertia = c.cg_to_front_m, c.cg_to_rear_m, c.yaw_inertia_kgm2
    front = b / max(gradient * length / m + a / rear, 1e-9)
    s0, s1, s2 = front + rear, a * front - b * rear, a * a * front + b * b * rear
    v = max(level * LEVEL_MPS, SLOW_MPS)
    h = 1.0 + s * RELAXATION_M / v
    fixed = (s0 * s2 - s1 * s1) / v**2 - m * h * s1
    under = inertia * m * (h * s) ** 2 + h * s * (m * s2 + inertia * s0) / v + fixed
    return np.asarray((a * m * h * s + rear * length / v) / under)


def slip_delay(speed: Array, slip: Array, chassis: Chassis) -> Array:
    """Return the delay (N,) of the rear tyres' slip relative to speed times yaw rate [s].

    The force of the rear axle balances m l_f (v r + v_y') - I r', with v_y' = (l_r - slip v) r'.
    The force follows the slip with the delay of the relaxation length. slip: kappa v, the sideslip
    per sideways acceleration [s].
    """
    c = chassis
    inertia = c.yaw_inertia_kgm2 / (c.mass_kg * c.cg_to_front_m)
    return (inertia - c.cg_to_rear_m - RELAXATION_M) / np.maximum(np.abs(speed), SLOW_MPS) + slip


def sideways(
    v: Array, r: Array, t: Array, kappa: float, ahead: Array, height: float, chassis: Chassis
) -> Array:
    """Return the lateral speed of the reference point. ahead: dv/dt (N,). height: as in
    `load_transfer`."""
    slip = kappa * np.abs(v)
    late = slip_delay(v, slip, chassis)
    # Acceleration loads the rear axle, so its tyres need less slip for the same force.
    load = np.maximum(1.0 + height / (GRAVITY * chassis.cg_to_front_m) * ahead, 0.5)
    return np.asarray(chassis.cg_to_rear_m * r - slip / load * v * np.interp(t - late, t, r))


def load_transfer(height: float, kappa: float, gradient: float, chassis: Chassis) -> float:
    """Return the growth of the understeer gradient with dv/dt [rad/(m/s^2)^2].

    Acceleration shifts the load m h dv/dt / L between the axles, and the cornering stiffness of an
    axle goes with its load.

    height: height of the centre of gravity [m], times the growth of stiffness with load (1:
    proportional). kappa: slip of the rear axle per sideways acceleration [rad/(m/s^2)].
    """
    c = chassis
    return height / GRAVITY * ((kappa + gradient) / c.cg_to_rear_m + kappa / c.cg_to_front_m)


def single_track(
    v: Array, steer: Array, leaning: Array, ratio: float, gradient: float, varying: float,
    wheelbase_m: float, ahead: Array, transfer: float,
) -> Array:  # fmt: skip
    """Return the yaw rate from the steering angle, r = v (delta - K f_lean)/(L + K v^2), with the
    sideways force of the road's lean. K: understeer gradient plus `transfer` times dv/dt (N,)."""
    angle = np.clip(steer / ratio, -1.2, 1.2)
    angle = angle + varying * angle**3
    under = gradient + transfer * ahead
    turn = np.tan(angle) - under * leaning
    return np.asarray(v * turn / np.maximum(wheelbase_m + under * v * v, 0.3))
