"""Parts of the equations as pure functions of arrays: (N,) on the grid, or (N, 3)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.diagnosis.equations.single_track import Complex, slip_delay
from imucald.diagnosis.signals import STEP_S
from imucald.model.vehicle import Chassis

Axes = tuple[Array, Array, Array]
"""(N,) along each of the vehicle's axes."""
SMOOTH_STEPS = 5
"""Quantities from the speed's slopes, and the road's lean, are smoothed over this many steps."""
SMOOTHER = np.ones(SMOOTH_STEPS) / SMOOTH_STEPS
TRANSITION_S = 2.0
"""Superelevation is built up along the transition curve: two seconds of travel (desirable length
of a spiral, AASHTO, A Policy on Geometric Design of Highways and Streets)."""
TRANSITION = np.hanning(round(TRANSITION_S / STEP_S) + 1)
TRANSITION /= TRANSITION.sum()


def column(x: Array, i: int) -> Array:
    """One axis (N,) of x (N, 3), as a contiguous array."""
    return np.ascontiguousarray(x[:, i])


def speed(t: Array, knots: Array, shown: Array, scale: float) -> Array:
    """Speed on the grid. shown: indicated speed at its knots, too large by `scale`."""
    return np.interp(t, knots, shown / (1.0 + scale))


def mean_slope(x: Array, t: Array) -> Array:
    """Mean slope of x between each two knots."""
    return np.asarray(np.diff(x) / np.diff(t))


def of_lever(x: Array, y: Array, z: Array, lever: tuple[float, float, float]) -> Axes:
    """Acceleration of a point at `lever` relative to the reference point, from the angular rates
    about x, y and z: w' x l + w x (w x l)."""
    w = x, y, z
    turning = _cross((slope(x), slope(y), slope(z)), lever)
    round_it = _cross(w, _cross(w, lever))
    return turning[0] + round_it[0], turning[1] + round_it[1], turning[2] + round_it[2]


def _cross(a: Axes, b: Axes | tuple[float, float, float]) -> Axes:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def sideways(v: Array, r: Array, t: Array, kappa: float, chassis: Chassis) -> Array:
    """Lateral speed of the reference point."""
    slip = kappa * np.abs(v)
    late = slip_delay(v, slip, chassis)
    return np.asarray(chassis.cg_to_rear_m * r - slip * v * np.interp(t - late, t, r))


def between_knots(x: Array, knots: Array, t: Array) -> Array:
    """Mean of x between each two knots."""
    area = np.cumsum(x) * STEP_S
    return np.asarray(np.diff(np.interp(knots, t + 0.5 * STEP_S, area)) / np.diff(knots))


def step_of(knots: Array, t: Array) -> NDArray[np.int64]:
    """(N,) index of the knot interval that contains each time."""
    return np.clip(np.searchsorted(knots, t) - 1, 0, len(knots) - 2)


def turned(r: Array, rows: int) -> tuple[Complex, Complex]:
    """e^(i psi) (B, n) by blocks of `rows` rows, and e^(-i psi) (N,), the factor of z0."""
    made: Complex = np.exp(1j * from_middle(r.reshape(-1, rows)))
    back: Complex = np.divide(1.0, made)
    return made, back.ravel()


def carried(p: Array, q: Array, turned: Complex) -> Complex:
    """(N,) u for z0 = 0, carried by the gyroscope."""
    p, q = p.reshape(turned.shape), q.reshape(turned.shape)
    return np.asarray((from_middle(turned * (-q + 1j * p)) / turned).ravel())


def along(force: Array, r: Array, v_y: Array, u: Complex | None) -> Array:
    """Forward acceleration from the forward force. u: gravity as carried by the gyroscope."""
    x = force + r * v_y
    return np.asarray(x if u is None else x - GRAVITY * u.real)


def across(force: Array, v: Array, r: Array, v_y: Array, u: Complex | None) -> Array:
    """Sideways force minus the part that turning explains."""
    y = left_of_turn(force, v, r) - slope(v_y)
    return np.asarray(y if u is None else y - GRAVITY * u.imag)


def left_of_turn(force: Array, v: Array, r: Array) -> Array:
    """Sideways force minus speed times yaw rate."""
    return np.asarray(force - v * r)


def upward(force: Array, v: Array, q: Array) -> Array:
    """Upward force minus one g and the effect of a vertical curve. q: rate nose down."""
    return np.asarray(force - GRAVITY + v * q)


def rolling(across: Array, t: Array, roll: float, late: float, superelevation: float) -> Array:
    """Roll rate that sideways acceleration causes. roll: gradient [rad/(m/s^2)]."""
    leaning = roll * later(across, t, late)
    if superelevation:
        # The road in a curve leans inward with the curvature; a transition curve spreads this over
        # time.
        leaning -= superelevation * np.convolve(across, TRANSITION, "same")
    return np.asarray(np.gradient(leaning, STEP_S))


def pitching(along: Array, t: Array, squat: float, dive: float, late: float) -> Array:
    """Pitch rate, nose up, that forward acceleration causes."""
    nose_up = squat * np.maximum(along, 0.0) + dive * np.minimum(along, 0.0)
    return np.asarray(np.gradient(later(nose_up, t, late), STEP_S))


def later(x: Array, t: Array, late: float) -> Array:
    """Return a quantity with the delay of the body, which follows like a damped spring: 2 zeta /
    omega well below its natural frequency."""
    return np.asarray(np.interp(t - late, t, x))


def slow(x: Array) -> Array:
    """Return x smoothed over `SMOOTH_STEPS` steps."""
    return np.asarray(np.convolve(x, SMOOTHER, "same"))


def beside_wheels(v: Array, shown: Array, own: tuple[float, ...], scale: float) -> Array:
    """Speed minus the mean of the rear wheels. shown: (N, 4). scale: scale error of the rear
    wheels, in addition to that of the file."""
    wheels = shown / (1.0 + np.array(own))
    return np.asarray(np.abs(v) - wheels[:, 2:].mean(axis=1) / scale)


def turning_by(rate: Array | None, steered: Array) -> Array:
    """(N, 3) angular rate with the yaw rate replaced."""
    level = np.zeros((len(steered), 2)) if rate is None else rate[:, :2]
    return np.column_stack([level, steered])


def single_track(
    v: Array, steer: Array, leaning: Array, ratio: float, gradient: float, varying: float,
    wheelbase_m: float,
) -> Array:  # fmt: skip
    """Yaw rate by the steering angle: see `VehicleMotion._by_steering`."""
    angle = np.clip(steer / ratio, -1.2, 1.2)
    angle = angle + varying * angle**3
    turn = np.tan(angle) - gradient * leaning
    return np.asarray(v * turn / np.maximum(wheelbase_m + gradient * v * v, 0.3))


def slope(x: Array) -> Array:
    """Slope of x (N,) on the grid [1/s], to fourth order. The slope is exact to 0.5 % up to 1 Hz; a
    simple difference of two neighbours loses 6.5 % there."""
    padded = np.concatenate([x[:1], x[:1], x, x[-1:], x[-1:]])
    near, far = padded[3:-1] - padded[1:-3], padded[4:] - padded[:-4]
    return np.asarray((8.0 * near - far) / (12.0 * STEP_S))


def from_middle(x: NDArray[Any]) -> NDArray[Any]:
    """Integral from the middle of each block, by trapezoids; (B, n)."""
    area = np.cumsum(0.5 * (x[:, 1:] + x[:, :-1]), axis=1) * STEP_S
    area = np.concatenate([np.zeros_like(x[:, :1]), area], axis=1)
    made: NDArray[Any] = area - area[:, x.shape[1] // 2, None]
    return made
