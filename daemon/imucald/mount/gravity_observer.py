"""The vertical in sensor axes: carried by the gyroscope, pulled slowly to the accelerometer.

The specific force is f_s = R^T m + g u + b, with u the vertical in sensor axes and m the motion
(dv/dt, v r, -v q). The vertical follows du/dt = -omega x u exactly, on any slope. A gyroscope
therefore makes the changes of slope known, and they can be removed from f_s. The pull to the
accelerometer (time constant `PULL_S`) limits the effect of the gyroscope's errors on u. The
innovation is the rest of the force:

    e = f_s - g u - R^T m,

The innovation responds to an accelerometer bias b by (I - B) b, where B follows the same equation
as u. In a turn, the true vertical rotates against the sensor and a bias does not, which separates
the two (the alignment of inertial navigation; Groves, Principles of GNSS, Inertial and Multisensor
Integrated Navigation Systems, ch. 14).

`MotionWindow` holds the last ticks of force and motion as one window for the frequency domain.

Each block pushes the oldest one out, so windows overlap (Welch, IEEE Trans. Audio Electroacoust.
15, 1967). Ticks that may not be learnt from are masked.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.rotations import inverse_of_symmetric
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.evidence_spectra import (
    MEASURED,
    RATE,
    SPEED_RATE,
    WINDOW,
    Measured,
    Spectra,
    spectra,
)
from imucald.mount.gravity_step import GravityStepDetector
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock
from imucald.mount.vertical_block import FORCE_LARGE, BlockForces, Carried, carried

Flags = NDArray[np.bool_]
_EYE = np.eye(3)

PULL_S = 16.0
"""Time constant of the pull to the accelerometer [s]."""
PULL_NO_GYRO_S = 12.0
"""Time constant where no gyroscope carries the vertical [s]."""
COLOUR, COLOUR_SEGMENTS = 25.0, 4.0
"""Factor on the bias's variance until segments show it, and its weight in segments: the innovation
is not white.
"""
MAX_ALONE, MAX_BLIND = 120, 10
"""Limits in ticks: the gyroscope alone carried the vertical, or nothing carried it in a block.
Beyond a limit, steps in gravity are not tested for a while.
"""
SETTLING_BLOCKS = 8
"""Number of blocks without this test: three time constants of the pull."""
SEEKING_BLOCKS = 3
"""Blocks in which the vertical is found again after nothing carried it.

During these blocks the vertical is not used.
"""
DRIFT_S = 150.0
"""Time constant with which a drifting gyro bias is followed while driving [s]."""
TAKEN = 7
"""Terms of the motion that the vertical follows in part."""
_PULL = {True: TICK_S / PULL_S, False: TICK_S / PULL_NO_GYRO_S}


class GravityObserver:
    """State: (3, 4) = u and B = d u / d (b / g)."""

    def __init__(self) -> None:
        self._state: Array | None = None
        self._n = 0
        self._open_information = np.zeros((3, 3))
        self._open_score = np.zeros(3)
        self._open_ticks = 0
        self.drift = np.zeros(3)
        self.taken: Array = np.zeros(TAKEN)
        """Share of each motion term that the vertical has followed."""
        self.use: Flags = np.zeros(BLOCK_TICKS, dtype=bool)
        self.pull = _PULL[False]
        """Ticks of the last block in which the vertical followed the force (N,), and the gain of
        the pull.
        """
        self._alone = self._settling = self._seeking = 0
        self._closed_information = np.zeros((0, 3, 3))
        self._closed_score = np.zeros((0, 3))
        self._closed: tuple[Array, Array] = np.zeros((3, 3)), np.zeros(3)  # the sums of both
        self.steps = GravityStepDetector()

    def restart(self) -> None:
        """Forget the vertical because time jumped; keep what is known of the bias."""
        self._state = None
        self._n = 0
        self.steps.restart()

    @property
    def up(self) -> Array | None:
        """Vertical in sensor axes, about unit length; (3,) or None."""
        return None if self._state is None else self._state[:, 0]

    @property
    def seeking(self) -> bool:
        """True if the vertical was lost and is being found again."""
        return self._seeking > 0

    @property
    def is_held(self) -> bool:
        """True if the force has held the vertical lately.

        A coarse gyroscope alone tilts it by 0.5 deg/s.
        """
        return self._state is not None and self._settling == 0

    def advance(
        self, p: SignalBlock, motion: Array | None, bias: Array | None, sure: bool
    ) -> Array:
        """Carry the vertical through a block; return f_s - g u (N, 3), which still contains the
        motion.

        motion: (N, 3) expected motion force in sensor axes, or None while R is not known. sure: R
        is known well enough to learn the bias from the innovation. bias: known bias of the
        accelerometer (3,) [m/s^2]; its effect is subtracted.
        """
        with_gyro = bool(np.count_nonzero(p.ok_rate))
        self.pull = pull = _PULL[with_gyro]
        # Without a speed, the part of the vehicle's motion in the force is unknown.
        self.use = p.learn if motion is None else p.learn & (p.ok_speed | p.rest)
        self._note_holes(p.ok_rate)
        before = np.zeros((3, 3)) if self._state is None else self._state[:, 1:]
        learn = p.learn & p.ok_speed & ~p.rest
        known = np.zeros(3) if bias is None else bias
        block = BlockForces(p.rate, self.drift, p.ok_rate, p.force, motion, known, self.use, learn)
        found = carried(block, self._state, self._n, pull, weighed=sure and with_gyro)
        if found.state is not None:
            self._n += int(np.count_nonzero(self.use))
        self._state = found.state
        if motion is not None and with_gyro:
            if sure:
                if np.count_nonzero(learn):
                    self._learn_bias(found, len(p.t))
                if self._settling:
                    self.steps.restart()
                else:
                    self.steps.follow_walk(p.rate_walk * PULL_S)
                    self.steps.add(before, found.of_steps, found.end)
            self._follow_drift(p, found, pull)
        return found.lone

    def _note_holes(self, ok_rate: Flags) -> None:
        """Note holes of the rate. After a long hole the vertical is wrong and needs time to
        settle.
        """
        self._settling = max(self._settling - 1, 0)
        at = self.use.nonzero()[0]
        alone = self._alone + (int(at[0]) if len(at) else len(self.use))
        if alone > MAX_ALONE or np.count_nonzero(~ok_rate) > MAX_BLIND:
            self._settling = SETTLING_BLOCKS
        self._seeking = max(self._seeking - 1, 0)
        if self._state is not None and np.count_nonzero(~ok_rate & ~self.use) > MAX_BLIND:
            self._n, self._seeking = 0, SEEKING_BLOCKS
        self._alone = len(self.use) - 1 - int(at[-1]) if len(at) else alone

    def remaining(self, motion: Array) -> Array:
        """Return the motion (N, TAKEN) that a wrong R leaves in the force, minus the part that the
        vertical followed.

        The vertical follows the force minus the expected motion. An error e of R therefore shows as
        e x (m - G), with G the motion as the vertical follows it. Turning during this time is
        neglected.
        """
        gain = np.where(self.use, self.pull, 0.0)
        decay = 1.0 - gain
        part = gain[:, None] * motion  # of each tick, and then of all up to it
        apart = 1
        while apart < len(gain):
            part[apart:] += decay[apart:, None] * part[:-apart]
            decay[apart:] *= decay[:-apart]
            apart *= 2
        taken = decay[:, None] * self.taken + part
        out: Array = motion.copy()
        out[0] -= self.taken
        out[1:] -= taken[:-1]
        self.taken[:] = taken[-1]
        return out

    def _follow_drift(self, p: SignalBlock, found: Carried, pull: float) -> None:
        """Estimate the gyro bias about the level axes from the innovation that it causes (Mahony's
        integral).

        A rate error d against the pull k leaves the innovation e / g with k u x e / g = d.
        """
        if np.count_nonzero(p.rest):
            self.drift *= 0.5  # at rest it is measured
            return
        use = p.learn & p.ok_speed
        if self._n < 300 or np.count_nonzero(use) < 0.8 * len(use):
            return
        n = len(p.t)
        mx, my, mz = (
            min(max(x / n, -FORCE_LARGE), FORCE_LARGE) / GRAVITY for x in found.left.tolist()
        )
        ux, uy, uz = found.up.tolist()
        across = np.array([uy * mz - uz * my, uz * mx - ux * mz, ux * my - uy * mx])
        self.drift += across * (pull / TICK_S * n * TICK_S / DRIFT_S)

    def _learn_bias(self, found: Carried, ticks: int) -> None:
        """Use a block to learn the bias, unless the block hardly responds to a bias."""
        if self._n < 100 or found.answer < 0.02:
            return
        self._open_information += found.of_bias[:3]
        self._open_score += found.of_bias[3]
        self._open_ticks += ticks
        if self._open_ticks >= 400:
            closed = self._closed_information, self._open_information[None]
            self._closed_information = np.concatenate(closed)
            self._closed_score = np.concatenate([self._closed_score, self._open_score[None]])
            self._closed = self._closed_information.sum(axis=0), self._closed_score.sum(axis=0)
            self._open_information = np.zeros((3, 3))
            self._open_score = np.zeros(3)
            self._open_ticks = 0

    def bias(self, prior_std: float) -> tuple[Array, Array]:
        """Return the accelerometer bias [m/s^2] (3,) and its covariance (3, 3), a sandwich over 40
        s segments.
        """
        prior = _EYE / (prior_std * prior_std)
        if self._state is not None:
            # A bias along the vertical causes no tilt, and squat would look like such a bias.
            up = self._state[:, 0]
            prior += np.outer(up, up) * 1e6
        a, b = self._closed_information, self._closed_score
        closed, score = self._closed
        information, score = closed + self._open_information, score + self._open_score
        covariance = inverse_of_symmetric(information + prior)
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
        covariance = inverse_of_symmetric(information / scale + prior)
        value = covariance @ (score / scale)
        return value, covariance


MIN_POWER = 1e-3
"""A window with less squared motion per tick [(m/s^2)^2] is not used."""
LEAST_TICKS = BLOCK_TICKS
"""A window with fewer ticks to learn from is not used either."""
_TAKEN = [
    Measured.DVDT_2,
    Measured.LATERAL_2,
    Measured.YAW_2,
    Measured.DVDT_ABS,
    Measured.DVDT_LATERAL,
    Measured.DVDT_REMAINING,
    Measured.LATERAL_REMAINING,
]
"""Terms that are not subtracted from the force before the vertical follows it."""


class MotionWindow:
    """Columns of `Measured` over the last `WINDOW` ticks."""

    def __init__(self) -> None:
        self._values = np.zeros((WINDOW, MEASURED))
        self._mask = np.zeros(WINDOW, dtype=bool)

    def restart(self) -> None:
        """Restart after a jump of time."""
        self._values[:] = 0.0
        self._mask[:] = False

    def add(
        self, p: SignalBlock, lone: Array, turn: Array, yaw_rate: Array, vertical: GravityObserver
    ) -> None:
        """Take a block.

        lone: (N, 3) force without gravity [m/s^2], sensor axes. turn: (N,) v r [m/s^2]. yaw_rate:
        (N,) r [rad/s]. vertical: the observer that has carried the vertical through the block.
        """
        w, m, new = self._values, self._mask, slice(-BLOCK_TICKS, None)
        learn = p.learn & p.ok_speed & (not vertical.seeking)
        w[:-BLOCK_TICKS] = w[BLOCK_TICKS:].copy()
        m[:-BLOCK_TICKS] = m[BLOCK_TICKS:].copy()
        a, r, rate = p.accel, yaw_rate, p.rate * p.ok_rate[:, None]
        w[new, :3] = lone
        w[new, Measured.DVDT] = a
        w[new, Measured.LATERAL] = turn
        w[new, SPEED_RATE] = rate * p.speed[:, None]
        w[new, RATE] = rate
        terms = np.empty((BLOCK_TICKS, len(_TAKEN)))
        for k, term in enumerate((a * a, turn * turn, r * r, a * np.abs(a), a * turn, a, turn)):
            terms[:, k] = term
        w[new, _TAKEN] = vertical.remaining(terms)
        w[new, Measured.DVDT_YAW] = a * r
        w[new, Measured.LATERAL_YAW] = turn * r
        m[new] = learn

    def spectra(self, keep_mean: bool, needs_motion: bool) -> Spectra | None:
        """Return the spectra (BINS, MEASURED) of the window; None if it cannot be used.

        keep_mean: the means of the columns count as well. needs_motion: a window without motion by
        the speed is not used.
        """
        if np.count_nonzero(self._mask) < LEAST_TICKS:
            return None
        s = spectra(self._values, self._mask, keep_mean=keep_mean)
        motion = s[:, 3:5]
        is_still = needs_motion and np.vdot(motion, motion).real < MIN_POWER * BLOCK_TICKS
        return None if is_still else s
