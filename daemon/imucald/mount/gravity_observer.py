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
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.gravity_step import GravityStepDetector
from imucald.mount.signal_blocks import SignalBlock
from imucald.mount.vertical_block import FORCE_LARGE, BlockForces, Carried, carried

PULL_S = 16.0
"""Time constant of the pull to the accelerometer [s]."""
PULL_NO_GYRO_S = 12.0
"""Time constant where no gyroscope carries the vertical [s]."""
MAX_ALONE, MAX_BLIND = 120, 10
"""Limits in ticks: the gyroscope alone carried the vertical, or nothing carried it in a block.
Beyond a limit, steps in gravity are not tested for a while.
"""
SETTLING_BLOCKS = 8
"""Number of blocks without this test: three time constants of the pull."""
DRIFT_S = 150.0
"""Time constant with which a drifting gyro bias is followed while driving [s]."""
_PULL = {True: TICK_S / PULL_S, False: TICK_S / PULL_NO_GYRO_S}


class GravityObserver:
    """State: (3, 4) = u and B = d u / d (b / g)."""

    def __init__(self) -> None:
        self._state: Array | None = None
        self._n = 0
        self._drift = np.zeros(3)
        self._alone = self._settling = 0
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
    def is_held(self) -> bool:
        """True if the force has held the vertical lately.

        A coarse gyroscope alone tilts it by 0.5 deg/s.
        """
        return self._state is not None and self._settling == 0

    def settle(self) -> None:
        """Test no steps for a while, because motion or another bias was in the vertical so far."""
        self._settling = SETTLING_BLOCKS

    def advance(self, p: SignalBlock, motion: Array | None, bias: Array, sure: bool) -> Array:
        """Carry the vertical through a block; return f_s - g u (N, 3), which still contains the
        motion.

        motion: (N, 3) expected motion force in sensor axes, or None while R is not known. bias:
        known bias of the accelerometer (3,) [m/s^2]; its effect is subtracted. sure: R is known
        well enough to look for steps in the innovation.
        """
        with_gyro = bool(np.count_nonzero(p.ok_rate))
        pull = _PULL[with_gyro]
        # Without a speed, the part of the vehicle's motion in the force is unknown.
        use = p.learn if motion is None else p.learn & (p.ok_speed | p.rest)
        self._note_holes(p.ok_rate, use)
        before = np.zeros((3, 3)) if self._state is None else self._state[:, 1:]
        block = BlockForces(p.rate, self._drift, p.ok_rate, p.force, motion, bias, use)
        found = carried(block, self._state, self._n, pull, weighed=sure and with_gyro)
        if found.state is not None:
            self._n += int(np.count_nonzero(use))
        self._state = found.state
        if motion is not None and with_gyro:
            if sure:
                if self._settling:
                    self.steps.restart()
                else:
                    self.steps.follow_walk(p.rate_walk * PULL_S)
                    self.steps.add(before, found.of_steps, found.end)
            self._follow_drift(p, found, pull)
        return found.lone

    def _note_holes(self, ok_rate: Flags, use: Flags) -> None:
        """Note holes of the rate. After a long hole the vertical is wrong and needs time to
        settle.

        use: (N,) ticks in which the vertical follows the force.
        """
        self._settling = max(self._settling - 1, 0)
        at = use.nonzero()[0]
        alone = self._alone + (int(at[0]) if len(at) else len(use))
        if alone > MAX_ALONE or np.count_nonzero(~ok_rate) > MAX_BLIND:
            self._settling = SETTLING_BLOCKS
        if self._state is not None and np.count_nonzero(~ok_rate & ~use) > MAX_BLIND:
            self._n = 0  # nothing carried it: it is found again
        self._alone = len(use) - 1 - int(at[-1]) if len(at) else alone

    def _follow_drift(self, p: SignalBlock, found: Carried, pull: float) -> None:
        """Estimate the gyro bias about the level axes from the innovation that it causes (Mahony's
        integral).

        A rate error d against the pull k leaves the innovation e / g with k u x e / g = d.
        """
        if np.count_nonzero(p.rest):
            self._drift *= 0.5  # at rest it is measured
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
        self._drift += across * (pull / TICK_S * n * TICK_S / DRIFT_S)
