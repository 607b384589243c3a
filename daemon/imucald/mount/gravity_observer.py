"""Which way is up, in sensor axes: carried by the gyroscope, drawn to the accelerometer.

The specific force is f_s = R^T m + g u + b with u the vertical in sensor axes and m the motion
(dv/dt, v r, -v q). u follows du/dt = -omega x u exactly, whatever the slope; so with a gyroscope
the slope's changes are known and leave f_s. The pull to the accelerometer (time constant
`PULL_S`) holds u against the gyroscope's errors. What is left, the innovation

    e = f_s - g u - R^T m,

answers to an accelerometer bias b by (I - B) b, where B follows the same equation as u: in a
turn the true vertical turns against the sensor and a bias does not, which separates them
(the alignment of inertial navigation; Groves, Principles of GNSS, Inertial and Multisensor
Integrated Navigation Systems, ch. 14).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.gravity_step import GravityStepDetector
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
_EYE, _EYE_4 = np.eye(3), np.eye(4)

PULL_S = 16.0
"""Time constant of the pull to the accelerometer [s]."""
PULL_NO_GYRO_S = 12.0
"""The same where no gyroscope carries the vertical."""
FORCE_LARGE = 0.25
"""An innovation beyond counts less [m/s^2] (Huber)."""
COLOUR, COLOUR_SEGMENTS = 25.0, 4.0
"""The innovation is not white: the bias's variance is so much larger until segments show it."""
SETTLE_TICKS = 25
"""The first ticks take the mean."""
MAX_ALONE, MAX_BLIND = 120, 10
"""After so many ticks that the gyroscope carried the vertical alone, or that nothing did in a
block, no step is looked for ..."""
SETTLING_BLOCKS = 8
"""... for three time constants of the pull."""
SEEKING_BLOCKS = 3
"""After nothing carried the vertical it is found anew, and for so long nothing rests on it."""
DRIFT_S = 150.0
"""Time constant with which a drifting gyro bias is followed while driving [s]."""
FORCE_NOISE = 0.06
"""Innovation of a tick while nothing happens [m/s^2], rms."""
FORCE_SHARE = 0.12
"""Share of the motion that the model may miss (gains, squat, sideslip)."""
CARRY_TICKS = 8
"""Ticks that are carried on as one; a block holds a whole number of them."""
_PULL = {True: TICK_S / PULL_S, False: TICK_S / PULL_NO_GYRO_S}


def _followed(pull: float) -> tuple[Array, Array]:
    """What a first-order lag leaves of a block: (N, N) of its values, (N,) of its state."""
    decay = np.asarray((1.0 - pull) ** np.arange(BLOCK_TICKS), dtype=np.float64)
    lag = np.arange(BLOCK_TICKS)[:, None] - np.arange(BLOCK_TICKS)[None, :] - 1
    taken = np.where(lag >= 0, pull * (1.0 - pull) ** np.maximum(lag, 0), 0.0)
    left = np.asarray(np.eye(BLOCK_TICKS) - taken, dtype=np.float64)
    return left, decay


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


def _sizes(vectors: Array) -> Array:
    """Of vectors (N, 3)."""
    sizes: Array = np.sqrt((vectors * vectors).sum(axis=1))
    return sizes


_REMAINING = {with_gyro: _followed(pull) for with_gyro, pull in _PULL.items()}


class GravityObserver:
    """State: (3, 4) = u and B = d u / d (b / g)."""

    def __init__(self) -> None:
        self._state: Array | None = None
        self._n = 0
        self._open_information = np.zeros((3, 3))
        self._open_score = np.zeros(3)
        self._open_ticks = 0
        self.drift = np.zeros(3)
        self._taken: Array | None = None
        self._use: Flags = np.zeros(BLOCK_TICKS, dtype=bool)
        self._alone = self._settling = self._seeking = 0
        self._closed_information = np.zeros((0, 3, 3))
        self._closed_score = np.zeros((0, 3))
        self._end = np.eye(3)
        self.steps = GravityStepDetector()

    def restart(self) -> None:
        """Forget the vertical (time jumped), keep what is known of the bias."""
        self._state = None
        self._n = 0
        self.steps.restart()

    @property
    def up(self) -> Array | None:
        """The vertical in sensor axes, about unit length; (3,) or None."""
        return None if self._state is None else self._state[:, 0]

    @property
    def seeking(self) -> bool:
        """Whether the vertical was lost and is being found anew."""
        return self._seeking > 0

    def advance(
        self, p: SignalBlock, motion: Array | None, bias: Array | None, sure: bool
    ) -> Array:
        """Carry the vertical through a block; return f_s - g u (N, 3), motion still in it.

        motion: (N, 3) expected motion force in sensor axes, or None while R is not known.
        sure: R is known well enough to learn the bias from what it leaves over.
        bias: what is known of the accelerometer's bias (3,) [m/s^2]; its answer is taken off.
        """
        turn = _turned(-TICK_S * (p.rate - self.drift) * p.ok_rate[:, None])
        force = p.force if motion is None else p.force - motion
        with_gyro = bool(np.count_nonzero(p.ok_rate))
        pull = _PULL[with_gyro]
        # without its speed nobody knows how much of the force is the vehicle's motion
        self._use = p.learn if motion is None else p.learn & (p.ok_speed | p.rest)
        self._note_holes(p.ok_rate)
        before = np.zeros((3, 3)) if self._state is None else self._state[:, 1:]
        states = self._carry(turn, force, self._use, pull)
        gravity = GRAVITY * states[:, :, 0]
        answer = _EYE - states[:, :, 1:4]  # to a bias
        answered = np.zeros(3) if bias is None else (answer.reshape(-1, 3) @ bias).reshape(-1, 3)
        if motion is not None and with_gyro:
            innovation = force - gravity
            unexplained = innovation - answered
            if sure:
                share2 = (FORCE_SHARE * FORCE_SHARE) * (motion * motion).sum(axis=1)
                noise2 = FORCE_NOISE * FORCE_NOISE + share2
                self._learn_bias(p, answer, innovation, noise2)
                if self._settling:
                    self.steps.restart()
                else:
                    weight = (self._use & p.ok_rate) / noise2
                    weight /= np.maximum(_sizes(unexplained) / (2.0 * FORCE_LARGE), 1.0)
                    self.steps.follow_walk(p.rate_walk * PULL_S)
                    self.steps.add(before, answer, states[:, :, 4:], self._end, unexplained, weight)
            self._follow_drift(p, states[-1, :, 0], unexplained, pull)
        lone: Array = p.force - gravity - answered
        return lone

    def _note_holes(self, ok_rate: Flags) -> None:
        """After a long one the vertical has yet to come back from where it was left alone."""
        self._settling = max(self._settling - 1, 0)
        at = self._use.nonzero()[0]
        alone = self._alone + (int(at[0]) if len(at) else len(self._use))
        if alone > MAX_ALONE or np.count_nonzero(~ok_rate) > MAX_BLIND:
            self._settling = SETTLING_BLOCKS
        self._seeking = max(self._seeking - 1, 0)
        if self._state is not None and np.count_nonzero(~ok_rate & ~self._use) > MAX_BLIND:
            self._n, self._seeking = 0, SEEKING_BLOCKS
        self._alone = len(self._use) - 1 - int(at[-1]) if len(at) else alone

    def _carry(self, turn: Array, force: Array, use: Flags, pull: float) -> Array:
        """Turn the state tick by tick and draw it to the force; return it as before each draw.

        Columns: u, B, and what is left of the state at the block's beginning (N, 3, 7).

        With T the turn and g the gain of a tick, y_i = (1 - g_i) T_i y_(i-1) + g_i target_i. That
        is affine, so carries of ticks are put together first, all at once, and then carried on.
        """
        n = len(turn)
        states = np.zeros((n, 3, 7))
        self._end = np.eye(3)
        first = 0
        if self._state is None:
            if not use.any():
                return states
            first = int(np.argmax(use))
            self._state = np.concatenate([force[first, :, None] / GRAVITY, _EYE], axis=1)
        count = self._n + use.cumsum()
        gain = np.where(count > SETTLE_TICKS, pull, np.maximum(pull, 1.0 / np.maximum(count, 1)))
        gain = np.where(use, gain, 0.0)[:, None, None]
        self._n = int(count[-1])
        # a carry is a matrix (7, 7): it turns the state's rows, and adds the target, which stands
        # below them as it is
        whole = np.zeros((n, 7, 7))
        whole[:, :3, :3] = (1.0 - gain) * turn
        if first:
            whole[:first, :3, :3] = _EYE  # nothing to turn yet
        whole[:, :3, 3] = (gain[:, 0] / GRAVITY) * force
        whole[:, :3, 4:] = gain * _EYE
        whole[:, 3:, 3:] = _EYE_4
        carries = whole.reshape(-1, CARRY_TICKS, 7, 7)
        each = carries[:, :, :3].copy()
        for j in range(1, CARRY_TICKS):
            np.matmul(each[:, j], carries[:, j - 1], out=carries[:, j, :3])
        starts = np.zeros((len(carries), 1, 7, 7))
        starts[:, 0, 3:, :4] = _EYE_4
        state = np.concatenate([self._state, _EYE], axis=1)
        np.matmul(turn[0], state, out=states[0])
        for start, end in zip(starts[:, 0], carries[:, -1, :3], strict=True):
            start[:3] = state
            state = end @ start
        drawn = carries[:, :, :3] @ starts
        np.matmul(turn[1:], drawn.reshape(n, 3, 7)[:-1], out=states[1:])
        states[:first] = 0.0
        self._state, self._end = state[:, :4], state[:, 4:]
        return states

    def remaining(self, motion: Array, p: SignalBlock) -> Array:
        """What a wrong R leaves of motion (N, k) in the force, after the vertical took its part.

        The vertical follows the force less the expected motion, so an error e of R shows as
        e x (m - G), with G the motion as the vertical follows it (turning while it does so left
        out).
        """
        with_gyro = bool(np.count_nonzero(p.ok_rate))
        state = self._taken
        if state is None:
            state = np.zeros(motion.shape[1])
        keep, decay = _REMAINING[with_gyro]
        if np.count_nonzero(self._use) == len(motion) == len(decay):
            out: Array = keep @ motion - decay[:, None] * state
            self._taken = motion[-1] - (1.0 - _PULL[with_gyro]) * out[-1]
            return out
        out = np.empty_like(motion)
        for i, use in enumerate(self._use.tolist()):
            out[i] = motion[i] - state
            if use:
                state = state + _PULL[with_gyro] * out[i]
        self._taken = state
        return out

    def _follow_drift(self, p: SignalBlock, up: Array, innovation: Array, pull: float) -> None:
        """Gyro bias about the level axes, from the innovation that it keeps up (Mahony's integral).

        Held against the pull k, a rate error d leaves the innovation e / g with k u x e / g = d.
        up: (3,) at the end.
        """
        if np.count_nonzero(p.rest):
            self.drift *= 0.5  # at rest it is measured
            return
        use = p.learn & p.ok_speed
        if self._n < 300 or np.count_nonzero(use) < 0.8 * len(use):
            return
        mean = (innovation.sum(axis=0) / len(innovation)).tolist()
        mx, my, mz = (min(max(x, -FORCE_LARGE), FORCE_LARGE) / GRAVITY for x in mean)
        ux, uy, uz = up.tolist()
        across = np.array([uy * mz - uz * my, uz * mx - ux * mz, ux * my - uy * mx])
        self.drift += across * (pull / TICK_S * len(p.t) * TICK_S / DRIFT_S)

    def _learn_bias(self, p: SignalBlock, answer: Array, innovation: Array, noise2: Array) -> None:
        """Take a block: answer (N, 3, 3) to a bias, innovation (N, 3), its usual square (N,)."""
        use = p.learn & p.ok_speed & ~p.rest
        if not np.count_nonzero(use) or self._n < 100 or np.abs(answer).max() < 0.02:
            return
        weight = use / noise2
        weight /= np.maximum(_sizes(innovation) / FORCE_LARGE, 1.0)
        rows = answer.reshape(-1, 3)  # one for each axis of each tick
        weighted = (answer * weight[:, None, None]).reshape(-1, 3).T
        self._open_information += weighted @ rows
        self._open_score += weighted @ innovation.reshape(-1)
        self._open_ticks += len(p.t)
        if self._open_ticks >= 400:
            closed = self._closed_information, self._open_information[None]
            self._closed_information = np.concatenate(closed)
            self._closed_score = np.concatenate([self._closed_score, self._open_score[None]])
            self._open_information = np.zeros((3, 3))
            self._open_score = np.zeros(3)
            self._open_ticks = 0

    def bias(self, prior_std: float) -> tuple[Array, Array]:
        """Accelerometer bias [m/s^2] (3,) and covariance (3, 3), sandwich over 40 s segments."""
        prior = _EYE / (prior_std * prior_std)
        if self._state is not None:
            # along the vertical it tilts nothing, and squat would pass for it
            up = self._state[:, 0]
            prior += np.outer(up, up) * 1e6
        a, b = self._closed_information, self._closed_score
        closed = a.sum(axis=0)
        information, score = closed + self._open_information, b.sum(axis=0) + self._open_score
        covariance = np.asarray(np.linalg.inv(information + prior), dtype=np.float64)
        value = covariance @ score
        k = len(a)
        if k < 2:
            scale = COLOUR
        else:
            left = b - a @ value
            model = float((closed * covariance).sum())  # the trace of their product
            spread = float(((left @ covariance) * left).sum())
            seen = k * spread / max(model, 0.05)
            scale = (COLOUR * COLOUR_SEGMENTS + seen) / (COLOUR_SEGMENTS + k)
        scale = max(scale, 1.0)
        covariance = np.asarray(np.linalg.inv(information / scale + prior), dtype=np.float64)
        value = covariance @ (score / scale)
        return value, covariance
