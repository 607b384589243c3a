"""The force that a sensor feels by where it sits: away from the point whose motion is reckoned."""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import SignalBlock


class LeverArm:
    """arm: (3,) from that point to the sensor, vehicle axes [m]."""

    def __init__(self, arm: Array) -> None:
        self._arm = arm
        self._is_long = bool(self._arm.any())
        self._last_rate: Array | None = None

    def __bool__(self) -> bool:
        return self._is_long

    def restart(self) -> None:
        """Time jumped."""
        self._last_rate = None

    def force(self, p: SignalBlock, R: Matrix3) -> Array:
        """Specific force at its end more than at its root, sensor axes (N, 3) [m/s^2].

        dw/dt x l + w x (w x l); the derivative is a central difference, which is not late.
        """
        rate = p.rate @ R.T
        before = rate[:1] if self._last_rate is None else self._last_rate
        self._last_rate = rate[-1:]
        change = np.gradient(np.concatenate([before, rate]), TICK_S, axis=0)[1:]
        carried = np.cross(change, self._arm) + np.cross(rate, np.cross(rate, self._arm))
        return np.asarray((carried * p.ok_rate[:, None]) @ R)
