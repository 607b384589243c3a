"""Does a mount that is served still hold gravity upright? Tick by tick, and for any mount.

The steepest street has 35 % (19.3 deg, Baldwin Street), so a vertical that stands `OFF_VERTICAL`
off is no slope. While the vehicle stands a few seconds tell; while it drives, or where nobody
knows, it takes half a minute, over which no vehicle keeps up the 0.5 g that would look the same.
"""

from __future__ import annotations

import math

from imucald.motion.rest_thresholds import ZERO_SPEED
from imucald.motion.ticks import ACCEL, SPEED, TickRow
from imucald.mount.estimate import Correction
from imucald.mount.large_change import OFF_VERTICAL

STANDING_TICKS = 32
DRIVING_TICKS = 256
_COS = math.cos(OFF_VERTICAL)


class PlumbLine:
    """Sums of the force since the vehicle stands, or over half a minute."""

    def __init__(self) -> None:
        self._standing = False
        self._clear()
        self.is_off = False
        """Whether gravity stood off the vertical when it was last known."""

    def _clear(self) -> None:
        self._n, self._x, self._y, self._z = 0, 0.0, 0.0, 0.0

    def step(self, tick: TickRow, correction: Correction | None) -> None:
        """Take a tick and the rotation that holds for it."""
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
        if self._n < (STANDING_TICKS if self._standing else DRIVING_TICKS):
            return
        x, y, z = self._x, self._y, self._z
        size = math.sqrt(x * x + y * y + z * z)
        up = correction[6] * x + correction[7] * y + correction[8] * z
        if math.isfinite(size) and size > 0.0:
            self.is_off = up < _COS * size
        self._clear()
