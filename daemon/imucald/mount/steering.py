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

from imucald.core.arrays import Array
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
PRIOR_STD = (0.15, 60.0, 2.0)
"""Prior deviations of offset [rad], n L [m], n K [rad/(m/s^2)]."""
_PRIOR = [1.0 / (s * s) for s in PRIOR_STD]
_WEIGHT = 1.0 / (NOISE * NOISE * CORRELATION_TICKS)


class SteeringOffsetEstimator:
    """Least-squares fit of the steering offset that is updated with every block."""

    def __init__(self) -> None:
        self._sums = [0.0] * 9  # of 1, x = r / v, y = r v; x x, x y, y y; the angle by 1, x, y
        self.seen = False
        self._fit: tuple[float, float, float] | None = None  # offset, variance, per lateral force

    def add_block(
        self, angle: Array, speed: Array, yaw_rate: Array, use: NDArray[np.bool_]
    ) -> None:
        """Process a block: steering-wheel angle [rad], speed [m/s], yaw rate [rad/s], all (N,)."""
        new = _sums_of(angle, speed, yaw_rate, use)
        if new[0]:
            self.seen, self._fit = True, None
            both = zip(self._sums, new, strict=True)
            self._sums = [KEEP * before + _WEIGHT * now for before, now in both]

    def fitted(self, crown: float, crown_std: float) -> tuple[float, float] | None:
        """Return the offset and its standard deviation [rad], or None without data.

        crown: mean lean of the roads [rad], positive if the left side is higher. The driver steers
        n K g crown against this lean.
        """
        if not self.seen:
            return None
        if self._fit is None:
            self._fit = self._solved()
        offset, variance, per_lateral = self._fit
        against = max(per_lateral, 0.0) * GRAVITY
        std = math.hypot(math.sqrt(variance), against * crown_std, BUMPS)
        return offset - against * crown, std

    def _solved(self) -> tuple[float, float, float]:
        """Return the offset, its variance, and the angle per lateral force. The equations are
        solved by elimination, as L D L'."""
        n, x, y, xx, xy, yy, *right = self._sums
        p, q, r = _PRIOR
        first = n + p
        a, b = x / first, y / first
        second = xx + q - a * x
        below = xy - a * y
        c = below / second
        third = yy + r - b * y - c * below

        def solution(u: float, v: float, w: float) -> tuple[float, float]:
            v -= a * u
            last = (w - b * u - c * v) / third
            return u / first - a * (v / second - c * last) - b * last, last

        offset, per_lateral = solution(*right)
        return offset, solution(1.0, 0.0, 0.0)[0], per_lateral


def _sums_of(angle: Array, speed: Array, yaw_rate: Array, use: NDArray[np.bool_]) -> list[float]:
    """Return the sums of a block over the ticks that show the offset. The sums are listed in
    `SteeringOffsetEstimator`.
    """
    lateral = speed * yaw_rate
    use = use & (speed > MIN_SPEED) & (np.abs(lateral) < MAX_LATERAL)
    y, angle = lateral[use], angle[use]
    x, one = yaw_rate[use] / speed[use], np.ones(len(y))
    columns = one, x, y, x * x, x * y, y * y, angle, angle * x, angle * y
    summed: list[float] = np.stack(columns, axis=1).sum(axis=0).tolist()
    return summed
