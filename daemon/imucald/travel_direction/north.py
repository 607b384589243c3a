"""Direction of north from a magnetometer with iron near it and a gyroscope with a zero error.

The field model uses a level frame P, which is tracked with the gyroscope: m = h + C^T M + noise. h
is the hard iron of the terminal, in terminal axes. M is the earth's field in P. M turns about the
vertical because of the gyroscope's zero error. When the terminal turns, h is constant in terminal
axes and C^T M is not, so the filter can separate h and M. A Kalman filter with seven states (h, M
in uT; zero error in rad/s) estimates h, M and the zero error.
"""

from __future__ import annotations

import math

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Rows, Vector

MICRO = 1e6
"""Factor from tesla to uT. With numbers near one, the covariance is accurate."""
STEP_S = 0.2
"""Time over which fields are averaged before use [s]."""
HARD_IRON_STD = 15.0
"""Deviation of the hard iron [uT]. A magnetised case has more hard iron, which is estimated when
the terminal turns."""
FIELD_STD = 50.0
"""Deviation of the earth's field [uT]. The earth's field is 25 to 65 uT."""
ZERO_ERROR_STD = math.radians(0.5)
"""Deviation of the gyroscope's zero error without a rest [rad/s]."""
RESTED_STD = math.radians(0.05)
"""Deviation of the zero error after a rest [rad/s]."""
NOISE = 35.0
"""Noise of a field that is averaged over 0.2 s [uT]. It represents a disturbance of 5 uT that lasts
for some ten seconds (steel, cables)."""
HARD_IRON_WALK = 0.03
"""Random walk of the hard iron [uT/sqrt(s)]."""
FIELD_WALK = 0.2
"""Random walk of the earth's field [uT/sqrt(s)]: the field changes along streets."""
ZERO_WALK = math.radians(0.002)
"""Random walk of the gyroscope's zero error [rad/s/sqrt(s)]."""
DISTURBANCE = 5.0
"""Disturbance for which `NOISE` is chosen [uT]."""
DISTURBANCE_S = 120.0
"""Time over which the disturbance is measured from the magnitude of the field [s]."""
DISTURBANCE_PARTS = (0.3, 3.0)
"""Limits of the measured disturbance, relative to `DISTURBANCE`. A short walk does not show the
whole disturbance."""


class NorthFilter:
    """Estimates the horizontal direction of the earth's field in P."""

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Forget everything."""
        self.x: Array = np.zeros(7)
        self.P: Array = np.diag([HARD_IRON_STD**2] * 3 + [FIELD_STD**2] * 3 + [ZERO_ERROR_STD**2])
        self.ready = False
        self._sum: Array = np.zeros(3)
        self._count = 0
        self._since = -math.inf
        self._t = math.nan
        self._size: Array = np.zeros(2)  # slow mean of level and vertical field [uT]
        self._variance = 0.0
        self._seen = 0

    def rested(self) -> None:
        """Note that the gyroscope's zero error has just been measured, so its remaining error is
        small."""
        self.x[6] = 0.0
        self.P[6, :] = 0.0
        self.P[:, 6] = 0.0
        self.P[6, 6] = RESTED_STD**2

    def add_field(self, t: float, field: Vector, C_level_from_terminal: Rows) -> None:
        """Process a field [T] in terminal axes."""
        if t - self._since > 10.0 * STEP_S:
            self._sum[:], self._count, self._since = 0.0, 0, t
        self._sum += field
        self._count += 1
        if t - self._since >= STEP_S:
            self._take(t, self._sum / self._count * MICRO, C_level_from_terminal)
            self._sum[:], self._count, self._since = 0.0, 0, t

    def _take(self, t: float, field: Array, C_level_from_terminal: Rows) -> None:
        if self.ready:
            self._predict(min(max(t - self._t, 0.0), 10.0))
        self._t = t
        C = np.array(C_level_from_terminal).reshape(3, 3)
        H = np.zeros((3, 7))
        H[:, 0:3] = np.eye(3)
        H[:, 3:6] = C.T
        # The first fields show north at once; only later fields get the noise of disturbance.
        noise = NOISE**2 if self.ready else 1.0
        innovation = field - H @ self.x
        S = H @ self.P @ H.T + noise * np.eye(3)
        K = np.linalg.solve(S, H @ self.P).T
        self.x = self.x + K @ innovation
        A = np.eye(7) - K @ H
        P = A @ self.P @ A.T + noise * (K @ K.T)
        self.P = 0.5 * (P + P.T)
        self.ready = True
        self._watch(C @ (field - self.x[0:3]))

    def _watch(self, level_field: Array) -> None:
        """Measure the disturbance. The level and the vertical magnitude of the earth's field are
        constant, so changes of these sizes are the disturbance.
        """
        sizes = np.array([math.hypot(level_field[0], level_field[1]), level_field[2]])
        self._seen += 1
        part = max(1.0 / self._seen, STEP_S / DISTURBANCE_S)
        off = sizes - self._size
        self._size = self._size + part * off
        self._variance += part * ((1.0 - part) * float(off @ off) / 2.0 - self._variance)

    def _predict(self, dt: float) -> None:
        """Predict over dt [s]: P turns with the zero error, so the field in P turns in the opposite
        direction."""
        east, north, zero = float(self.x[3]), float(self.x[4]), float(self.x[6])
        F = np.eye(7)
        turn = zero * dt
        s, c = math.sin(turn), math.cos(turn)
        F[3:5, 3:5] = [[c, -s], [s, c]]
        self.x[3], self.x[4] = c * east - s * north, s * east + c * north
        F[3, 6], F[4, 6] = -self.x[4] * dt, self.x[3] * dt
        walk = [HARD_IRON_WALK**2] * 3 + [FIELD_WALK**2] * 3 + [ZERO_WALK**2]
        P = F @ self.P @ F.T + np.diag(walk) * dt
        self.P = 0.5 * (P + P.T)

    @property
    def yaw(self) -> float | None:
        """Rotation of P about the vertical that turns the field to the north [rad]; None if not
        known."""
        east, north = float(self.x[3]), float(self.x[4])
        if not self.ready or math.hypot(east, north) < 1.0:
            return None
        return math.atan2(east, north)

    @property
    def std(self) -> float:
        """Deviation of `yaw` [rad]: the deviation of the filter, scaled by the measured
        disturbance."""
        east, north = float(self.x[3]), float(self.x[4])
        size = east * east + north * north
        if size < 1.0:
            return math.pi
        g = np.array([north, -east]) / size
        low, high = DISTURBANCE_PARTS
        part = min(max(math.sqrt(self._variance) / DISTURBANCE, low), high)
        return part * math.sqrt(max(float(g @ self.P[3:5, 3:5] @ g), 0.0))
