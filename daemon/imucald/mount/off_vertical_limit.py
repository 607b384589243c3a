"""The 25 degree limit: gravity through the mount points further off the vertical than any road.

`is_off_vertical` checks blocks while the estimator learns. `PlumbLine` checks tick by tick for a
mount that is only served. A few seconds are enough while the vehicle stands. While it drives, or
where that is unknown, the check takes half a minute. No vehicle keeps up 0.5 g for so long, which
would look the same.
"""

from __future__ import annotations

import math

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3, times
from imucald.core.samples import GRAVITY
from imucald.motion.standstill import ZERO_SPEED
from imucald.motion.ticks import ACCEL, SPEED, TickRow
from imucald.mount.block_sums import masked_sums
from imucald.mount.estimate import Correction
from imucald.mount.large_change import LEAST_TICKS
from imucald.mount.signal_blocks import SignalBlock

MAX_OFF_VERTICAL = math.radians(25.0)
"""The steepest street has 35 % (19.3 deg, Baldwin Street).

The rest is the possible error of a mount that was levelled on one slope.
"""

STANDING_TICKS = 32
DRIVING_TICKS = 256
_COS = math.cos(MAX_OFF_VERTICAL)


def is_off_vertical(p: SignalBlock, R: Matrix3, turn: Array) -> bool:
    """True if gravity, through R, points further from the vertical than any road does.

    Gravity must be off the vertical both as measured and with the motion removed, so that neither
    hard driving nor a wrong speed or turn rate triggers the limit. While the vehicle drives and no
    signal shows turns, a bend may be arbitrarily sharp, so a block is not judged; `large_change`
    uses more blocks.
    """
    use = p.ok_force & (p.ok_rate | p.ok_yaw | p.rest)
    n, *sums = masked_sums(p.force, use)
    if n < LEAST_TICKS:
        return False
    u, v, w = (x / n for x in sums)
    x, y, z = (a * u + b * v + c * w for a, b, c in R.tolist())
    if not math.hypot(x, y, z) >= 0.5 * GRAVITY:
        return False
    if math.atan2(math.hypot(x, y), z) <= MAX_OFF_VERTICAL:
        return False
    ahead, across = float(p.accel[use].sum()) / n, float(turn[use].sum()) / n
    return math.atan2(math.hypot(x - ahead, y - across), z) > MAX_OFF_VERTICAL


class PlumbLine:
    """Sums of the force since the vehicle stands, or over half a minute."""

    def __init__(self) -> None:
        self._standing = False
        self._clear()
        self.is_off = False
        """True if gravity was off the vertical when its direction was last known."""

    def _clear(self) -> None:
        self._n, self._x, self._y, self._z = 0, 0.0, 0.0, 0.0

    def take_tick(self, tick: TickRow, correction: Correction | None) -> None:
        """Take a tick and the correction that is applied to it."""
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
        up = times(correction.rotation, (x, y, z))[2]
        if math.isfinite(size) and size > 0.0:
            self.is_off = up < _COS * size
        self._clear()
