"""Detect a step in gravity that the gyroscope did not see: the sensor was moved against the
vehicle.

The vertical that the gyroscope carries (`gravity_observer`) follows every slope and every lean of
the body. If the sensor is moved between two samples, gravity points elsewhere in sensor axes from
then on, as if a bias d had begun. The innovation responds by C(t) d = (I - B(t)) d, where B starts
at zero at that time and follows the equation of the vertical. For each of the last block beginnings
as the time of the step, d is fitted by least squares (a generalised likelihood ratio test, Willsky
and Jones, IEEE Trans. Autom. Control 21, 1976). The usual size of d without a step is estimated
from the drive, for every age and axis.

If the gyroscope has few samples, the vertical walks at random (`gyro_walk`), and d walks with it.
The vertical walks by q per second and is pulled back with the time constant T, so its error has the
covariance q T / 2 exp(-|t - s| / T). A fit of d exp(-t / T) to this error has the variance q T if
it is longer than T, and less if it is shorter. The spread of d therefore includes g^2 q T besides
what the drive has shown.
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3, applied
from imucald.core.samples import GRAVITY

AGES = 10
"""Numbers of blocks since the step that are tested (64 s). The pull makes a step disappear in 16
s."""
FIRST_AGE = 4
"""Smallest age of a candidate: in younger ones, a gust or a bad road looks like a step."""
SPREAD_PRIOR, SPREAD_WEIGHT = 0.05, 20.0
"""Size of d without a step [m/s^2] before the drive has shown it, and the weight of this prior in
blocks.
"""
SPREAD_MEMORY = 600.0
"""Blocks over which the spread is estimated (an hour)."""
SETTLED = 45
"""Blocks after which the drive has shown its own spread.

Until then, a step is found only while the rotation is good, and must be large.
"""
YOUNG_SIZE = 8.0 * SPREAD_PRIOR
"""Smallest step [m/s^2] until then. The step must also exceed `LIMIT` times the prior's spread."""
LIMIT = 7.5
"""A step must exceed this many spreads."""
OTHER_AXIS = 0.25
"""Share of the other axis in the squared spread: a road that is rough along is also rough
across.
"""
MIN_SIZE = 0.15
"""Smallest step [m/s^2]: 0.9 deg."""


class GravityStep(Struct, frozen=True):
    """A step that was found: axis (0 roll, 1 pitch), size [rad], size in spreads, age in blocks."""

    axis: int
    size: float
    deviations: float
    blocks: int


_SIGNS = np.array([1.0, -1.0])
_PRIOR = 1.0 / (4.0 * SPREAD_PRIOR) ** 2


class GravityStepDetector:
    """Fits of d for the beginnings of the last blocks, renewed block by block."""

    def __init__(self) -> None:
        self._start = np.zeros((AGES, 3, 3))  # B at the candidate's time, carried on
        self._score = np.zeros((AGES, 3))
        self._information = np.zeros((AGES, 3, 3))
        self._square = np.full((AGES, 2), SPREAD_PRIOR**2)
        self._walked = np.zeros((3, 3))
        self._blocks = 0
        self._seen = 0

    def start_from(self, other: GravityStepDetector) -> None:
        """Begin with the usual spread that another detector has learnt, but without its
        candidates.
        """
        self._square, self._seen = other._square.copy(), other._seen
        self._walked = other._walked.copy()

    def restart(self) -> None:
        """Restart because the vertical starts again: no candidate may be older."""
        self._blocks = 0

    def follow_walk(self, walked: Array) -> None:
        """Take the covariance (3, 3) [rad^2] of the vertical's random walk until the pull removes
        it, sensor axes.

        The walk is the mean over the blocks that a step may have been in.
        """
        self._walked += (walked - self._walked) / AGES

    def add(self, before: Array, sums: Array, end: Array) -> None:
        """Take a block.

        before: B at its beginning (3, 3). sums: (7, 6) information and, below it, score of I - B
        and of the remaining initial state, see `vertical_block`. end: the remaining initial state
        at the block's end (3, 3).
        """
        self._blocks += 1
        for kept in (self._start, self._score, self._information):
            kept[1:] = kept[:-1].copy()
            kept[0] = 0.0
        self._start[0] = before
        # C = (I - B) + left start, so the sums of C follow from those of both parts
        start, turned = self._start, self._start.transpose(0, 2, 1)
        both = applied(sums[:3, 3:], start)
        self._information += sums[:3, :3] + both + both.transpose(0, 2, 1)
        self._information += applied(turned, applied(sums[3:6, 3:], start))
        self._score += sums[6, :3] + applied(turned, sums[6, 3:, None])[:, :, 0]
        self._start = applied(end, start)

    def found(self, R_vehicle_from_sensor: Matrix3, is_good: bool = False) -> GravityStep | None:
        """Return the most significant step, if any; learn the usual spread as well.

        is_good: the rotation is served as good. A young rotation that is still wrong leaves motion
        in the force. Only the drive's own spread then tells such motion from a step.
        """
        ages = min(self._blocks, AGES)
        if ages == 0:
            return None
        self._seen += 1
        part = 1.0 / min(SPREAD_WEIGHT + self._seen, SPREAD_MEMORY)
        is_young = self._seen < SETTLED
        least = YOUNG_SIZE if is_young else MIN_SIZE
        found = self._largest(R_vehicle_from_sensor, ages, part, least)
        if found is None or (is_young and not is_good) or abs(found[3]) < LIMIT:
            return None
        age, axis, turned, spreads = found
        return GravityStep(axis, turned / GRAVITY, spreads, age + 1)

    def _largest(
        self, R: Matrix3, ages: int, part: float, least: float
    ) -> tuple[int, int, float, float] | None:
        """Return age, axis, size [m/s^2] and deviations of the most significant step among those
        larger than `least`, or None. part: share of the usual spread that is learnt now.
        """
        walked = np.zeros(2)
        if self._walked.any():  # a turn about y moves gravity ahead, one about x aside
            walked = (R @ self._walked @ R.T).diagonal()[1::-1].copy()
        level = R[:2]
        J = applied(applied(level, self._information[:ages]), level.T)
        aside, ahead = (applied(level, self._score[:ages, :, None])[:, i, 0] for i in (1, 0))
        a, b, c, d = J[:, 0, 0] + _PRIOR, J[:, 0, 1], J[:, 1, 0], J[:, 1, 1] + _PRIOR
        det = a * d - b * c
        size = np.stack([(d * ahead - b * aside) / det, (a * aside - c * ahead) / det], axis=1)
        now = self._square[:ages]
        usual = now + GRAVITY * GRAVITY * walked
        deviations = size / np.sqrt(usual + OTHER_AXIS * usual[:, ::-1])
        now += part * (np.minimum(size * size, 9.0 * now) - now)
        if ages < FIRST_AGE:
            return None
        # Gravity seen to the left means that the sensor rolled to the right about x; gravity ahead
        # means a rotation about -y.
        turned, spreads = size[:, ::-1] * _SIGNS, deviations[:, ::-1] * _SIGNS
        large = np.abs(spreads) * (np.abs(turned) > least)
        large[: FIRST_AGE - 1] = 0.0
        k, axis = divmod(int(large.argmax()), 2)
        if large[k, axis] == 0.0:
            return None
        return k, axis, float(turned[k, axis]), float(spreads[k, axis])
