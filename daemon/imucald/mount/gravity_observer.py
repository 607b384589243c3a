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

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import SignalBlock
from imucald.mount.vertical_block import FORCE_LARGE, BlockForces, Carried, carried

PULL_S = 16.0
"""Time constant of the pull to the accelerometer [s]."""
PULL_NO_GYRO_S = 12.0
"""Time constant where no gyroscope carries the vertical [s]."""
MAX_BLIND = 10
"""Number of ticks in a block in which nothing carries the vertical, from which it is found again.
"""
DRIFT_S = 150.0
"""Time constant with which a drifting gyro bias is followed while driving [s]."""
_PULL = {True: TICK_S / PULL_S, False: TICK_S / PULL_NO_GYRO_S}


class GravityObserver:
    """State: (3, 4) = u and B = d u / d (b / g)."""

    def __init__(self) -> None:
        self._state: Array | None = None
        self._n = 0
        self._drift = np.zeros(3)

    def restart(self) -> None:
        """Forget the vertical because time jumped; keep what is known of the bias."""
        self._state = None
        self._n = 0

    @property
    def up(self) -> Array | None:
        """Vertical in sensor axes, about unit length; (3,) or None."""
        return None if self._state is None else self._state[:, 0]

    def advance(self, p: SignalBlock, motion: Array | None, bias: Array) -> Array:
        """Carry the vertical through a block; return f_s - g u (N, 3), which still contains the
        motion.

        motion: (N, 3) expected motion force in sensor axes, or None while R is not known. bias:
        known bias of the accelerometer (3,) [m/s^2]; its effect is subtracted.
        """
        with_gyro = bool(np.count_nonzero(p.ok_rate))
        pull = _PULL[with_gyro]
        # Without a speed, the part of the vehicle's motion in the force is unknown.
        use = p.learn if motion is None else p.learn & (p.ok_speed | p.rest)
        if self._state is not None and np.count_nonzero(~p.ok_rate & ~use) > MAX_BLIND:
            self._n = 0  # nothing carried it: it is found again
        block = BlockForces(p.rate, self._drift, p.ok_rate, p.force, motion, bias, use)
        found = carried(block, self._state, self._n, pull)
        if found.state is not None:
            self._n += int(np.count_nonzero(use))
        self._state = found.state
        if motion is not None and with_gyro:
            self._follow_drift(p, found, pull)
        return found.lone

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
