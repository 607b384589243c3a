"""The equations of motion of a car and of a sensor in it, as pure functions of arrays (N,).

    f_x = dv/dt - r v_y + g u_x     f_y = v r + dv_y/dt + g u_y     f_z = g - v q
    f(sensor) = f + w' x l + w x (w x l)
    p = d(roll v r)/dt              q = -d(squat dv/dt)/dt          of a body on its springs

Vehicle axes: x forward, y left, z up. f: force, w = (p, q, r): angular rate, l: lever arm, u: the
vertical, v_y: lateral speed. All signals are on the grid of ticks, a tenth of a second apart.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S

Complex = NDArray[np.complex128]
Axes = tuple[Array, Array, Array]
"""Components (N,) along each of the vehicle's axes."""
SMOOTH_STEPS = 5
"""Number of steps over which quantities from slopes of the speed, and the lean of the road, are
smoothed."""
TRANSITION = np.hanning(round(2.0 / TICK_S) + 1)
TRANSITION /= TRANSITION.sum()
"""Weights by which superelevation is built up along a transition curve: two seconds of travel
(desirable length of a spiral, AASHTO, A Policy on Geometric Design of Highways and Streets).
"""


def speed(t: Array, knots: Array, shown: Array, scale: float) -> Array:
    """Return the speed on the grid. shown: indicated speed at its knots, too large by the factor 1
    + `scale`."""
    return np.interp(t, knots, shown / (1.0 + scale))


def mean_slope(x: Array, t: Array) -> Array:
    """Return the mean slope of x between successive knots."""
    return np.asarray(np.diff(x) / np.diff(t))


def of_motion(accel: Array, v: Array, rate: Array) -> Array:
    """Return the force (N, 3) of a motion without lateral speed. accel: dv/dt. rate: (N, 3)."""
    return np.column_stack([accel, v * rate[:, 2], -v * rate[:, 1]])


def of_lever(rate: Axes, turning: Axes, lever: tuple[float, float, float]) -> Axes:
    """Return the acceleration of a point at `lever` relative to the reference point: w' x l + w x
    (w x l). rate: w, turning: w'."""
    (x, y, z), round_it = _cross(turning, lever), _cross(rate, _cross(rate, lever))
    return x + round_it[0], y + round_it[1], z + round_it[2]


def _cross(a: Axes, b: Axes | tuple[float, float, float]) -> Axes:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def between_knots(x: Array, knots: Array, t: Array) -> Array:
    """Return the mean of x between successive knots."""
    area = np.cumsum(x) * TICK_S
    return np.asarray(np.diff(np.interp(knots, t + 0.5 * TICK_S, area)) / np.diff(knots))


def step_of(knots: Array, t: Array) -> NDArray[np.int64]:
    """Return the index (N,) of the knot interval that contains each time."""
    return np.clip(np.searchsorted(knots, t) - 1, 0, len(knots) - 2)


def turned(r: Array, rows: int) -> tuple[Complex, Complex]:
    """Return e^(i psi) (B, n) by blocks of `rows` rows, and e^(-i psi) (N,), which is the factor of
    z0."""
    made: Complex = np.exp(1j * from_middle(r.reshape(-1, rows)))
    back: Complex = np.divide(1.0, made)
    return made, back.ravel()


def carried(p: Array, q: Array, turned: Complex) -> Complex:
    """Return u (N,) for z0 = 0, integrated with the gyroscope."""
    p, q = p.reshape(turned.shape), q.reshape(turned.shape)
    return np.asarray((from_middle(turned * (-q + 1j * p)) / turned).ravel())


def along(force: Array, r: Array, v_y: Array, u: Complex | None) -> Array:
    """Return the forward acceleration from the forward force. u: gravity from the integrated
    gyroscope."""
    x = force + r * v_y
    return np.asarray(x if u is None else x - GRAVITY * u.real)


def across(force: Array, v: Array, r: Array, v_y: Array, u: Complex | None) -> Array:
    """Return the sideways force minus the part that turning explains."""
    y = left_of_turn(force, v, r) - slope(v_y)
    return np.asarray(y if u is None else y - GRAVITY * u.imag)


def left_of_turn(force: Array, v: Array, r: Array) -> Array:
    """Return the sideways force minus speed times yaw rate."""
    return np.asarray(force - v * r)


def upward(force: Array, v: Array, q: Array) -> Array:
    """Return the upward force minus one g and the effect of a vertical curve. q: pitch rate, nose
    down."""
    return np.asarray(force - GRAVITY + v * q)


def rolling(
    across: Array, roll: float, superelevation: float = 0.0, t: Array | None = None,
    late: float = 0.0,
) -> Array:  # fmt: skip
    """Return the roll rate that sideways acceleration causes. roll: roll gradient [rad/(m/s^2)]. t,
    late: times and delay of the body [s]; without times there is no delay."""
    leaning = roll * later(across, t, late)
    if superelevation:
        # The road in a curve leans inward with the curvature; a transition curve spreads this over
        # time.
        leaning -= superelevation * np.convolve(across, TRANSITION, "same")
    return np.asarray(np.gradient(leaning, TICK_S))


def pitching(
    along: Array, squat: float, dive: float, t: Array | None = None, late: float = 0.0
) -> Array:
    """Return the pitch rate, nose up, that forward acceleration causes. squat, dive: gradients
    [rad/(m/s^2)]. t, late: as in `rolling`."""
    nose_up = squat * np.maximum(along, 0.0) + dive * np.minimum(along, 0.0)
    return np.asarray(np.gradient(later(nose_up, t, late), TICK_S))


def later(x: Array, t: Array | None, late: float) -> Array:
    """Return a quantity with the delay of the vehicle body. The body responds as a damped spring,
    with the delay 2 zeta / omega well below its natural frequency."""
    return x if t is None else np.asarray(np.interp(t - late, t, x))


def slow(x: Array) -> Array:
    """Return x smoothed over `SMOOTH_STEPS` steps."""
    return np.asarray(np.convolve(x, np.ones(SMOOTH_STEPS) / SMOOTH_STEPS, "same"))


def beside_wheels(v: Array, shown: Array, own: tuple[float, ...], scale: float) -> Array:
    """Return the speed minus the mean speed of the rear wheels. shown: (N, 4) wheel speeds. scale:
    scale error of the rear wheels, in addition to the scale error of the model file."""
    wheels = shown / (1.0 + np.array(own))
    return np.asarray(np.abs(v) - wheels[:, 2:].mean(axis=1) / scale)


def slope(x: Array) -> Array:
    """Return the slope of x (N,) on the grid [1/s], to fourth order. The slope is exact to 0.5 % up
    to 1 Hz. A simple difference of two neighbours is 6.5 % too small at 1 Hz."""
    padded = np.concatenate([x[:1], x[:1], x, x[-1:], x[-1:]])
    near, far = padded[3:-1] - padded[1:-3], padded[4:] - padded[:-4]
    return np.asarray((8.0 * near - far) / (12.0 * TICK_S))


def from_middle(x: NDArray[Any]) -> NDArray[Any]:
    """Return the integral from the middle of each block (B, n), by trapezoids."""
    area = np.cumsum(0.5 * (x[:, 1:] + x[:, :-1]), axis=1) * TICK_S
    area = np.concatenate([np.zeros_like(x[:, :1]), area], axis=1)
    made: NDArray[Any] = area - area[:, x.shape[1] // 2, None]
    return made
