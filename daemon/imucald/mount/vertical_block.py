"""One block of the vertical's filter (`gravity_observer`): the vertical carried tick by tick, and
the residuals.

With T the rotation and g the gain of a tick, the state y = (u, B) follows y_i = (1 - g_i) T_i
y_(i-1) + g_i target_i. All sums of products use one order, because the matrix products of a library
use a different order on each processor.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, Flags
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S

SETTLE_TICKS = 25
"""Number of first ticks that take a running mean."""
FORCE_NOISE = 0.06
"""Innovation of a tick without disturbance [m/s^2], rms."""
FORCE_LARGE = 0.25
"""Innovations beyond this count as this [m/s^2] (Huber)."""
_EYE = np.eye(3)


class BlockForces(Struct, frozen=True):
    """Signals of N ticks through which the vertical is carried.

    rate: (N, 3) [rad/s]. drift: (3,) drift to subtract from the rate. force, motion: (N, 3)
    [m/s^2]. The motion is the expected part of the force; None while R is not known. bias: (3,) of
    the accelerometer. use: (N,) ticks at which the vertical is pulled to the force.
    """

    rate: Array
    drift: Array
    ok_rate: Flags
    force: Array
    motion: Array | None
    bias: Array
    use: Flags


class Carried(Struct, frozen=True):
    """Result of a block.

    lone: (N, 3) specific force minus gravity along the vertical, and minus the effect of the bias
    [m/s^2]. up: (3,) vertical at the last tick. state: (3, 4) at the end, None if there is none
    yet. left: (3,) sum of the unexplained force; zero if no motion is known.
    """

    lone: Array
    up: Array
    state: Array | None
    left: Array


def carried(p: BlockForces, state: Array | None, count: int, pull: float) -> Carried:
    """Carry the vertical through a block.

    state: (3, 4) at its beginning, None before any force. count: ticks that were pulled to the
    force so far. pull: gain of a tick.
    """
    first = 0
    if state is None and p.use.any():
        first = int(np.argmax(p.use))
        force = p.force[first] if p.motion is None else p.force[first] - p.motion[first]
        state = np.concatenate([force[:, None] / GRAVITY, _EYE], axis=1)
    force = (p.force if p.motion is None else p.force - p.motion).T
    states = np.zeros((3, 4, len(p.use)))  # ticks last: long loops
    if state is not None:
        step = np.ascontiguousarray((-TICK_S * (p.rate - p.drift) * p.ok_rate[:, None]).T)
        gain = _gains(p.use, count, pull)
        states, state = _states(_turned(step), force, gain, state, first)
    gravity = GRAVITY * states[:, 0]
    answer = _EYE[:, :, None] - states[:, 1:4]  # to a bias
    answered = answer[:, 0] * p.bias[0] + answer[:, 1] * p.bias[1] + answer[:, 2] * p.bias[2]
    lone = (p.force.T - gravity - answered).T
    left = np.zeros(3)
    if p.motion is not None:
        left = (force - gravity - answered).sum(axis=1)
    return Carried(np.ascontiguousarray(lone), states[:, 0, -1].copy(), state, left)


def _turned(step: Array) -> Array:
    """Return rotations (3, 3, n) by small rotation vectors (3, n), to second order."""
    turn: Array = 0.5 * step[:, None] * step
    x, y, z = step
    rest = 1.0 - (turn[0, 0] + turn[1, 1] + turn[2, 2])
    turn[0, 0] += rest
    turn[1, 1] += rest
    turn[2, 2] += rest
    turn[0, 1] -= z
    turn[0, 2] += y
    turn[1, 2] -= x
    turn[1, 0] += z
    turn[2, 0] -= y
    turn[2, 1] += x
    return turn


def _gains(use: Flags, count: int, pull: float) -> Array:
    """Return the gain of each tick (N,): that of a running mean at first, then `pull`."""
    counts = count + use.cumsum()
    gain = np.where(counts > SETTLE_TICKS, pull, np.maximum(pull, 1.0 / np.maximum(counts, 1)))
    return np.where(use, gain, 0.0)


def _states(
    turn: Array, force: Array, gain: Array, state: Array, first: int
) -> tuple[Array, Array]:
    """Return the state (u, B) before each pull (3, 4, N), and after the last one (3, 4).

    A tick is an affine map. Each map is combined with all before it, twice as many in each step,
    and all are then applied at once.
    """
    carry = np.empty((3, 7, len(gain)))  # what turns the state (3, 3), what u and B get (3, 4)
    np.multiply(1.0 - gain, turn, out=carry[:, :3])
    if first:
        carry[:, :3, :first] = _EYE[:, :, None]  # nothing to turn yet
    np.multiply(gain / GRAVITY, force, out=carry[:, 3])
    np.multiply(gain, _EYE[:, :, None], out=carry[:, 4:])
    apart = 1
    while apart < len(gain):
        later = carry[:, :, apart:]
        both = _applied(later[:, :3], carry[:, :, :-apart])
        both[:, 3:] += later[:, 3:]
        carry[:, :, apart:] = both
        apart *= 2
    after = _applied(carry[:, :3], state[:, :, None])
    after += carry[:, 3:]
    drawn = np.concatenate([state[:, :, None], after[:, :, :-1]], axis=2)
    states = _applied(turn, drawn)
    states[:, :, :first] = 0.0
    return states, after[:, :, -1].copy()


def _applied(matrices: Array, columns: Array) -> Array:
    """Return matrices (3, 3, n) times (3, k, n), summed from left to right."""
    out: Array = matrices[:, 0, None] * columns[0]
    out += matrices[:, 1, None] * columns[1]
    out += matrices[:, 2, None] * columns[2]
    return out
