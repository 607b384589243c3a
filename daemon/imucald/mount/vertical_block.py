"""A block of the vertical's filter (`gravity_observer`): carried tick by tick, and what is left.

With T the turn and g the gain of a tick, the state y = (u, B) follows y_i = (1 - g_i) T_i y_(i-1) +
g_i target_i. All sums of products are taken in one order, so that the compiled part gives the same
bits; a library's matrix products take another one on each processor.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core import compiled
from imucald.core.rotations import applied
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

CARRY_TICKS = 8
"""Ticks that are put together before they are carried on; a block holds a whole number of them."""
SETTLE_TICKS = 25
"""The first ticks take the mean."""
FORCE_NOISE = 0.06
"""Innovation of a tick while nothing happens [m/s^2], rms."""
FORCE_SHARE = 0.12
"""Share of the motion that the model may miss (gains, squat, sideslip)."""
FORCE_LARGE = 0.25
"""An innovation beyond counts less [m/s^2] (Huber)."""
_EYE = np.eye(3)
_NUMBERS = np.array(
    [
        TICK_S, GRAVITY, SETTLE_TICKS, FORCE_NOISE * FORCE_NOISE, FORCE_SHARE * FORCE_SHARE,
        FORCE_LARGE, 2.0 * FORCE_LARGE,
    ]
)  # fmt: skip
"""As `core/kernels/vertical.c` takes them."""


class BlockForces(Struct, frozen=True):
    """What the vertical is carried through, N ticks.

    rate: (N, 3) [rad/s], drift: (3,) to be taken off it. force, motion: (N, 3) [m/s^2], the latter
    expected in the former; None while R is not known. bias: (3,) of the accelerometer. use: (N,)
    where the vertical is drawn to the force; learn: where its bias may be learnt from.
    """

    rate: Array
    drift: Array
    ok_rate: Flags
    force: Array
    motion: Array | None
    bias: Array
    use: Flags
    learn: Flags


class Carried(Struct, frozen=True):
    """What a block came to.

    lone: (N, 3) f - g u, less the answer to the bias. up: (3,) at the last tick. state: (3, 4) at
    the end, None where there is none yet; end: (3, 3) what is then left of the state at the
    beginning. answer: size of the largest answer to a bias. left: (3,) sum of what is unexplained;
    of_bias: (4, 3) information of a bias and, below it, the score; of_steps: (7, 6) the same of
    (I - B, what is left of the state). Those are zero where no motion is known.
    """

    lone: Array
    up: Array
    state: Array | None
    end: Array
    answer: float
    left: Array
    of_bias: Array
    of_steps: Array


def carried(p: BlockForces, state: Array | None, count: int, pull: float, weighed: bool) -> Carried:
    """Carry the vertical through a block.

    state: (3, 4) at its beginning, None before any force. count: ticks that were drawn to the force
    so far. pull: gain of a tick. weighed: what is left over is weighed for bias and steps.
    """
    first = 0
    if state is None and p.use.any():
        first = int(np.argmax(p.use))
        force = p.force[first] if p.motion is None else p.force[first] - p.motion[first]
        state = np.concatenate([force[:, None] / GRAVITY, _EYE], axis=1)
    if state is not None and compiled.kernels is not None:
        return _by_kernel(compiled.kernels, p, state, first, count, pull, weighed)
    force = p.force if p.motion is None else p.force - p.motion
    end = _EYE.copy()
    states = np.zeros((len(force), 3, 7))
    if state is not None:
        turn = _turned(-TICK_S * (p.rate - p.drift) * p.ok_rate[:, None])
        gain = _gains(p.use, count, pull)
        states, last = _states(turn, force, gain, state, first)
        state, end = last[:, :4], last[:, 4:]
    gravity = GRAVITY * states[:, :, 0]
    answer = _EYE - states[:, :, 1:4]  # to a bias
    answered = applied(answer, p.bias[:, None])[:, :, 0]
    lone: Array = p.force - gravity - answered
    largest = float(np.abs(answer).max())
    left, of_bias, of_steps = np.zeros(3), np.zeros((4, 3)), np.zeros((7, 6))
    if p.motion is not None:
        innovation = force - gravity
        unexplained = innovation - answered
        left = unexplained.sum(axis=0)
        if weighed:
            noise2 = FORCE_NOISE * FORCE_NOISE + FORCE_SHARE * FORCE_SHARE * _squares(p.motion)
            weight = p.learn / noise2
            weight /= np.maximum(np.sqrt(_squares(innovation)) / FORCE_LARGE, 1.0)
            of_bias = _weighed(answer, innovation, weight)
            weight = (p.use & p.ok_rate) / noise2
            weight /= np.maximum(np.sqrt(_squares(unexplained)) / (2.0 * FORCE_LARGE), 1.0)
            both = np.concatenate([answer, states[:, :, 4:]], axis=2)
            of_steps = _weighed(both, unexplained, weight)
    return Carried(lone, states[-1, :, 0], state, end, largest, left, of_bias, of_steps)


def _by_kernel(
    kernels: compiled.Kernels,
    p: BlockForces,
    state: Array,
    first: int,
    count: int,
    pull: float,
    weighed: bool,
) -> Carried:
    """As `carried`, from a state that is known."""
    n = len(p.force)
    lone, last = np.empty((n, 3)), np.empty((3, 7))
    sums = np.empty(7)
    of_bias, of_steps = np.zeros((4, 3)), np.zeros((7, 6))
    last[:, :4], last[:, 4:] = state, _EYE
    motion = p.force if p.motion is None else p.motion
    flags = kernels.vertical(
        p.rate, p.drift, p.ok_rate, p.force, motion, p.bias, p.use, p.learn, _NUMBERS, pull, first,
        count, p.motion is not None, weighed, lone, last, sums, of_bias, of_steps,
    )  # fmt: skip
    if flags:
        compiled.note(flags)
    answer = float(sums[3])
    return Carried(lone, sums[4:], last[:, :4], last[:, 4:], answer, sums[:3], of_bias, of_steps)


def _turned(step: Array) -> Array:
    """Rotations (n, 3, 3) by small rotation vectors (n, 3), to second order."""
    turn: Array = 0.5 * step[:, :, None] * step[:, None, :]
    x, y, z = step[:, 0], step[:, 1], step[:, 2]
    rest = 1.0 - (turn[:, 0, 0] + turn[:, 1, 1] + turn[:, 2, 2])
    turn[:, 0, 0] += rest
    turn[:, 1, 1] += rest
    turn[:, 2, 2] += rest
    turn[:, 0, 1] -= z
    turn[:, 0, 2] += y
    turn[:, 1, 2] -= x
    turn[:, 1, 0] += z
    turn[:, 2, 0] -= y
    turn[:, 2, 1] += x
    return turn


def _gains(use: Flags, count: int, pull: float) -> Array:
    """Of each tick (N,): that of a mean over the first ones."""
    counts = count + use.cumsum()
    gain = np.where(counts > SETTLE_TICKS, pull, np.maximum(pull, 1.0 / np.maximum(counts, 1)))
    return np.where(use, gain, 0.0)


def _states(
    turn: Array, force: Array, gain: Array, state: Array, first: int
) -> tuple[Array, Array]:
    """The state turned tick by tick, as before each draw (N, 3, 7), and after the last (3, 7).

    Columns: u, B, and what is left of the state at the block's beginning. A tick's part is affine,
    so ticks are put together first, some at once, and then carried on.
    """
    n = len(turn)
    carry = np.empty((n, 3, 7))  # what turns the state (3, 3), and what is added to u and B (3, 4)
    carry[:, :, :3] = (1.0 - gain)[:, None, None] * turn
    if first:
        carry[:first, :, :3] = _EYE  # nothing to turn yet
    carry[:, :, 3] = (gain / GRAVITY)[:, None] * force
    carry[:, :, 4:] = gain[:, None, None] * _EYE
    groups = carry.reshape(-1, CARRY_TICKS, 3, 7)
    for j in range(1, CARRY_TICKS):
        both = applied(groups[:, j, :, :3], groups[:, j - 1])
        both[:, :, 3:] += groups[:, j, :, 3:]
        groups[:, j] = both
    starts = np.empty((len(groups), 3, 7))
    now = np.concatenate([state, _EYE], axis=1)
    states = np.empty((n, 3, 7))
    states[0] = applied(turn[0], now)
    for start, last in zip(starts, groups[:, -1], strict=True):
        start[:] = now
        now = applied(last[:, :3], start)
        now[:, :4] += last[:, 3:]
    drawn = applied(groups[..., :3], starts[:, None])
    drawn[..., :4] += groups[..., 3:]
    states[1:] = applied(turn[1:], drawn.reshape(n, 3, 7)[:-1])
    states[:first] = 0.0
    return states, now


def _squares(vectors: Array) -> Array:
    """Of vectors (N, 3)."""
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.asarray(x * x + y * y + z * z)


def _weighed(answer: Array, left: Array, weight: Array) -> Array:
    """Information (k, k) and score (k,), as (k + 1, k), of what answers (N, 3, k); left: (N, 3)."""
    k = answer.shape[2]
    rows = answer.reshape(-1, k)  # one for each axis of each tick
    weighted = (answer * weight[:, None, None]).reshape(-1, k)
    out = np.empty((k + 1, k))
    (weighted[:, :, None] * rows[:, None, :]).sum(axis=0, out=out[:k])
    (weighted * left.reshape(-1, 1)).sum(axis=0, out=out[k])
    return out
