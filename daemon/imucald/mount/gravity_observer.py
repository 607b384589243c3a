"""The vertical in sensor axes, and the force without gravity.

The specific force is f_s = R^T m + g u + b, with u the vertical in sensor axes, m the motion
(dv/dt, v r, -v q) and b the accelerometer's zero error. The vertical is
integrated with the gyroscope, which works on any slope, and corrected slowly towards the force
(`drive.vertical`). The remaining difference between the force and the motion comes from an error of
the rate: the gyroscope's zero error may drift.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.drive.vertical import CarriedVertical
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import SignalBlock

PULL_S = 16.0
"""Time constant of the correction of the vertical towards the accelerometer [s]. This time constant
is shorter than the time constant in `drive.vertical`, so a zero error of the rate tilts the
vertical less.
"""
MAX_BLIND = 10
"""Number of ticks of a block without rate and without usable force, above which the vertical is
determined anew.
"""
DRIFT_S = 150.0
"""Time constant of the estimate of a drifting gyroscope bias while driving [s]."""
SETTLED_TICKS = 300
"""Number of ticks with correction towards the force after which the residual force shows a drift of
the gyroscope bias."""
FORCE_LARGE = 0.25
"""Largest mean residual force that is used [m/s^2]; larger values are limited to it (Huber)."""


class GravityObserver:
    """Integrates the vertical from block to block, and estimates the gyroscope's zero error while
    driving."""

    def __init__(self) -> None:
        self._vertical = CarriedVertical(PULL_S)
        self._pulled = 0
        self._drift = np.zeros(3)

    def restart(self) -> None:
        """Forget the vertical because time jumped, and keep the estimated bias."""
        self._vertical.restart()
        self._pulled = 0

    @property
    def up(self) -> Array | None:
        """Vertical in sensor axes (3,), with a length of about 1, or None."""
        return self._vertical.up

    def advance(self, p: SignalBlock, motion: Array | None, bias: Array) -> Array:
        """Integrate the vertical through a block. Returns f_s - b - g u (N, 3), which still
        contains the motion.

        motion: (N, 3) expected force of the motion in sensor axes, or None while R is not known.
        bias: (3,) known bias of the accelerometer [m/s^2].
        """
        # Without a speed, the part of the vehicle's motion in the force is unknown.
        use = p.learn if motion is None else p.learn & (p.ok_speed | p.rest)
        if self.up is not None and np.count_nonzero(~p.ok_rate & ~use) > MAX_BLIND:
            self.restart()  # nothing carried it: it is found again
        force = p.force - bias
        if self.up is None and not use.any():
            return force
        rate = (p.rate - self._drift) * p.ok_rate[:, None]
        still = force if motion is None else force - motion
        up, _ = self._vertical.block(rate, still / GRAVITY, use)
        self._pulled += int(np.count_nonzero(use))
        if motion is not None and p.ok_rate.any():
            self._follow_drift(p, (still - GRAVITY * up).mean(axis=0), up[-1])
        return np.asarray(force - GRAVITY * up)

    def _follow_drift(self, p: SignalBlock, left: Array, up: Array) -> None:
        """Estimate the gyroscope bias about the level axes from the mean residual force (3,) that
        this bias causes (integral part of Mahony's filter).

        With a correction gain k, a rate error d causes a residual force e with k u x e / g = d.
        """
        if np.count_nonzero(p.rest):
            self._drift *= 0.5  # at rest it is measured
            return
        use = p.learn & p.ok_speed
        if self._pulled < SETTLED_TICKS or np.count_nonzero(use) < 0.8 * len(use):
            return
        across = np.cross(up, left.clip(-FORCE_LARGE, FORCE_LARGE) / GRAVITY)
        self._drift += across * (len(use) * TICK_S / (PULL_S * DRIFT_S))
