"""The vertical in sensor axes, and the force without gravity.

The specific force is f_s = R^T m + g u + b, with u the vertical in sensor axes, m the motion
(dv/dt, v r, -v q) and b the accelerometer's zero. The vertical is carried by the gyroscope on any
slope and pulled to the force (`drive.vertical`). What the force then shows besides the motion is an
error of the rate: the gyroscope's zero may drift.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.drive.vertical import CarriedVertical
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import SignalBlock

PULL_S = 16.0
"""Time constant of the pull to the accelerometer [s]: a zero of the rate tilts the vertical less
than with that of `drive.vertical`.
"""
MAX_BLIND = 10
"""Number of ticks in a block in which nothing carries the vertical, from which it is found again.
"""
DRIFT_S = 150.0
"""Time constant with which a drifting gyro bias is followed while driving [s]."""
SETTLED_TICKS = 300
"""Ticks that were pulled to the force, from which the rest of the force shows such a drift."""
FORCE_LARGE = 0.25
"""A larger mean rest of the force counts as this [m/s^2] (Huber)."""


class GravityObserver:
    """Carries the vertical from block to block, and follows the zero of the rate while driving."""

    def __init__(self) -> None:
        self._vertical = CarriedVertical(PULL_S)
        self._pulled = 0
        self._drift = np.zeros(3)

    def restart(self) -> None:
        """Forget the vertical because time jumped; keep what is known of the bias."""
        self._vertical.restart()
        self._pulled = 0

    @property
    def up(self) -> Array | None:
        """Vertical in sensor axes, about unit length; (3,) or None."""
        return self._vertical.up

    def advance(self, p: SignalBlock, motion: Array | None, bias: Array) -> Array:
        """Carry the vertical through a block; return f_s - b - g u (N, 3), which still contains the
        motion.

        motion: (N, 3) expected motion force in sensor axes, or None while R is not known. bias:
        (3,) known bias of the accelerometer [m/s^2].
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
        """Estimate the gyro bias about the level axes from the mean rest of the force (3,) that it
        causes (Mahony's integral).

        A rate error d against the pull k leaves the innovation e / g with k u x e / g = d.
        """
        if np.count_nonzero(p.rest):
            self._drift *= 0.5  # at rest it is measured
            return
        use = p.learn & p.ok_speed
        if self._pulled < SETTLED_TICKS or np.count_nonzero(use) < 0.8 * len(use):
            return
        across = np.cross(up, left.clip(-FORCE_LARGE, FORCE_LARGE) / GRAVITY)
        self._drift += across * (len(use) * TICK_S / (PULL_S * DRIFT_S))
