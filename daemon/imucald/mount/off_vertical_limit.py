"""The 25 degree limit: it is exceeded if gravity, rotated by the mount, is further from the
vertical than on any road.

`is_off_vertical` checks blocks while the estimator learns. `PlumbLine` checks every tick for a
mount that is only applied. While the vehicle stands, a few seconds of data are enough. While the
vehicle drives, or if this is unknown, the check needs half a minute. A lasting acceleration of 0.5
g would look the same, but no vehicle accelerates so long.
"""

from __future__ import annotations

import math

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3, times
from imucald.core.samples import GRAVITY
from imucald.motion.standstill import ZERO_SPEED
from imucald.motion.ticks import ACCEL, SPEED, TickRow
from imucald.mount.estimate import Correction
from imucald.mount.signal_blocks import SignalBlock

MAX_OFF_VERTICAL = math.radians(25.0)
"""Limit of the angle between gravity and the vertical [rad].

The steepest street has a slope of 35 % (19.3 deg, Baldwin Street). The remaining angle allows for
the error of a mount that was levelled on a slope.
"""

LEAST_TICKS, DRIVING_TICKS = 32, 256
"""Number of ticks that are enough while standing or in a block, and while driving."""


def is_off_vertical(p: SignalBlock, R: Matrix3, turn: Array) -> bool:
    """True if gravity, rotated by R, is further from the vertical than on any road.

    Gravity must exceed the limit both with and without the motion in the force. Hard driving, a
    wrong speed or a wrong turn rate therefore cannot exceed the limit. Without a signal that shows
    turns, a block of driving is not judged, because its bend may be arbitrarily sharp.
    """
    use = p.ok_force & (p.ok_rate | p.ok_yaw | p.rest)
    if np.count_nonzero(use) < LEAST_TICKS:
        return False
    x, y, z = (R @ p.force[use].mean(axis=0)).tolist()
    if not math.hypot(x, y, z) >= 0.5 * GRAVITY:
        return False
    if math.atan2(math.hypot(x, y), z) <= MAX_OFF_VERTICAL:
        return False
    ahead, across = float(p.accel[use].mean()), float(turn[use].mean())
    return math.atan2(math.hypot(x - ahead, y - across), z) > MAX_OFF_VERTICAL


class PlumbLine:
    """Sums of the force since the vehicle stands, or over half a minute."""

    def __init__(self) -> None:
        self._standing = False
        self._clear()
        self.is_off = False
        """True if gravity exceeded the limit when its direction was last known."""

    def _clear(self) -> None:
        self._n, self._x, self._y, self._z = 0, 0.0, 0.0, 0.0

    def take_tick(self, tick: TickRow, correction: Correction | None) -> None:
        """Process a tick and the correction that is applied to the tick."""
        if tick[SPEED.n]:
            standing = abs(tick[SPEED.mean]) < ZERO_SPEED
            if standing is not self._standing:
                self._standing = standing
                self._clear()
        if not tick[ACCEL.n] or correction is None:
            return
        self._n += 1
        self._x += tick[ACCEL.x]
        self._y += tick[ACCEL.y]
        self._z += tick[ACCEL.z]
        if self._n < (LEAST_TICKS if self._standing else DRIVING_TICKS):
            return
        x, y, z = self._x, self._y, self._z
        size = math.sqrt(x * x + y * y + z * z)
        up = times(correction.rotation, (x, y, z))[2]
        if math.isfinite(size) and size > 0.0:
            self.is_off = up < math.cos(MAX_OFF_VERTICAL) * size
        self._clear()
