"""Zero offset of the steering-wheel angle, estimated together with the mount.

The offset is needed for straight-line detection.

In steady cornering, delta = n (L + K v^2) r / v + offset. Here delta is the steering-wheel angle, r
the yaw rate and v the speed. The equation is linear in (1, r / v, r v), so three coefficients are
fitted by least squares with slow forgetting. The steering ratio n, the wheelbase L and the
understeer K need not be known. On a road that leans, the driver steers against the lean, by n K g
per radian of lean.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, inverse
from imucald.core.samples import GRAVITY

MIN_SPEED = 4.0
"""Smallest speed [m/s]: below this speed, tyres scrub and r / v is noisy."""
MAX_LATERAL = 3.0
"""Largest lateral acceleration [m/s^2]: above this value, the tyres are not linear."""
KEEP = 0.999
"""Forgetting factor per block of 6.4 s: a memory of more than half an hour."""
NOISE = 0.03
"""Residual of the steering-wheel angle [rad]: play, transients, camber."""
CORRELATION_TICKS = 10.0
"""Correlation time of the residual in ticks: a second."""
BUMPS = 0.004
"""Offset error from hysteresis and side wind [rad]."""
PRIOR = np.diag(np.square([0.15, 60.0, 2.0]) ** -1.0)
"""Prior information about offset [1/rad^2], n L and n K, from their deviations: 0.15 rad, 60 m and
2 rad/(m/s^2)."""
WEIGHT = 1.0 / (NOISE * NOISE * CORRELATION_TICKS)


class SteeringOffsetEstimator:
    """Least-squares fit of the steering offset that is updated with every block."""

    def __init__(self) -> None:
        self._information, self._angles = np.zeros((3, 3)), np.zeros(3)  # of 1, r / v, r v
        self._seen = False
        self._fit: tuple[float, float, float] | None = None  # offset, variance, per lateral force

    def add_block(
        self, angle: Array, speed: Array, yaw_rate: Array, use: NDArray[np.bool_]
    ) -> None:
        """Process a block: steering-wheel angle [rad], speed [m/s], yaw rate [rad/s], all (N,)."""
        lateral = speed * yaw_rate
        use = use & (speed > MIN_SPEED) & (np.abs(lateral) < MAX_LATERAL)
        if not use.any():
            return
        self._seen, self._fit = True, None
        rows = np.array([np.ones(np.count_nonzero(use)), yaw_rate[use] / speed[use], lateral[use]])
        self._information = KEEP * self._information + WEIGHT * (rows @ rows.T)
        self._angles = KEEP * self._angles + WEIGHT * (rows @ angle[use])

    def fitted(self, crown: float, crown_std: float) -> tuple[float, float] | None:
        """Return the offset and its standard deviation [rad], or None without data.

        crown: mean lean of the roads [rad], positive if the left side is higher. The driver steers
        n K g crown against this lean.
        """
        if not self._seen:
            return None
        if self._fit is None:
            self._fit = self._solved()
        offset, variance, per_lateral = self._fit
        against = max(per_lateral, 0.0) * GRAVITY
        std = math.hypot(math.sqrt(variance), against * crown_std, BUMPS)
        return offset - against * crown, std

    def _solved(self) -> tuple[float, float, float]:
        """Return the offset, its variance, and the angle per lateral force."""
        covariance = inverse(self._information + PRIOR)
        offset, _, per_lateral = (covariance @ self._angles).tolist()
        return offset, float(covariance[0, 0]), per_lateral
