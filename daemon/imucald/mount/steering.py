"""Zero offset of the steering angle, beside the mount: it gates straight-line detection.

Steady cornering: delta = n (L + K v^2) r / v + offset. With delta the steering-wheel angle, r the
yaw rate and v the speed this is linear in (1, r / v, r v), so three coefficients are fitted by
least squares with slow forgetting; the steering need not be calibrated for that. On a leaning
road the driver steers against the lean, by n K g per radian of it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.samples import GRAVITY

Array = NDArray[np.float64]

MIN_SPEED = 4.0
"""Below, tyres scrub and r / v is noisy [m/s]."""
MAX_LATERAL = 3.0
"""Beyond, tyres are not linear [m/s^2]."""
KEEP = 0.999
"""Forgetting per block of 6.4 s: half an hour's memory and more."""
NOISE = 0.03
"""Residual of the steering-wheel angle [rad]: play, transients, camber."""
CORRELATION_TICKS = 10.0
"""Neighbouring ticks say the same for a second."""
BUMPS = 0.004
"""Offset that hysteresis and side wind leave [rad]."""
PRIOR_STD = (0.15, 60.0, 2.0)
"""Offset [rad], n L [m], n K [rad/(m/s^2)] before data speak."""
_PRIOR = np.diag([1.0 / (s * s) for s in PRIOR_STD])


class SteeringOffsetEstimator:
    """Running least squares; `offset` and `std` [rad]."""

    def __init__(self) -> None:
        self._normal = np.zeros((3, 3))
        self._right = np.zeros(3)
        self.seen = False
        self._fit: tuple[float, float, float] | None = None  # offset, variance, per lateral force

    def add(self, angle: Array, speed: Array, yaw_rate: Array, use: NDArray[np.bool_]) -> None:
        """Take a block: steering-wheel angle [rad], speed [m/s], yaw rate [rad/s], all (N,)."""
        use = use & (speed > MIN_SPEED) & (np.abs(speed * yaw_rate) < MAX_LATERAL)
        if not np.count_nonzero(use):
            return
        self.seen, self._fit = True, None
        v, r = speed[use], yaw_rate[use]
        rows = np.ones((len(v), 3))
        np.divide(r, v, out=rows[:, 1])
        np.multiply(r, v, out=rows[:, 2])
        weight = 1.0 / (NOISE * NOISE * CORRELATION_TICKS)
        self._normal = KEEP * self._normal + weight * (rows.T @ rows)
        self._right = KEEP * self._right + weight * (rows.T @ angle[use])

    def fitted(self, crown: float, crown_std: float) -> tuple[float, float] | None:
        """Offset and its standard deviation [rad], or None without data.

        crown: mean lean of the roads [rad], left side up; the driver steers n K g crown against it.
        """
        if not self.seen:
            return None
        if self._fit is None:
            inverse = np.linalg.inv(self._normal + _PRIOR)
            offset, _, per_lateral = (inverse @ self._right).tolist()
            self._fit = offset, float(inverse[0, 0]), per_lateral
        offset, variance, per_lateral = self._fit
        against = max(per_lateral, 0.0) * GRAVITY
        std = math.hypot(math.sqrt(variance), against * crown_std, BUMPS)
        return offset - against * crown, std
