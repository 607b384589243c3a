"""Detect a move of the sensor in its mount.

The data after each possible time of a move are compared with the data before this time. Several
such times in the last minutes are tested. A move turns both sensors by the same angle about one
axis of the vehicle. The rotation changes the responses of the force to motion, the axis of turning,
and the horizontal force. The terms of the sensor itself stay the same. For each tested time, the
change of every entry is fitted together with all constant coefficients (`FitSums.changes`). The
errors of an entry have heavy tails. The likelihood is averaged over the axes and the sizes of the
rotation, and divided by the likelihood without a rotation. The sum of these ratios over the tested
times is the statistic of Shiryaev and Roberts, as in `drift`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.motion.ticks import TICK_S
from imucald.mount.creep import ANSWER_TAIL
from imucald.mount.even_signals import BLOCK_TICKS
from imucald.mount.joint.drift import FALSE_ALARM_H, probability
from imucald.mount.joint.response import SEGMENTS

SPANS: Final = np.array((1, 2, 3, 4, 5, 6, 8, 10, 13, 16))
"""Numbers of whole road segments since a move that are tested (26 s to 7 min of driving)."""
LEAST_BEFORE = 3
"""Smallest number of road segments before a move.

The value was chosen on the simulated drives with the seeds 1840010 to 1840041 and 1830000 to
1830029. It was judged on the seeds 1860000 to 1860029 and 1861000 to 1861029.
"""
SIZES: Final = np.radians(np.outer([-1.0, 1.0], np.geomspace(1.0, 30.0, 18))).ravel()
"""Angles of rotation that are tested, with equal probabilities [rad]. Rotations of less than 1 deg
are not tested, because the effect on the results is small.
"""
ROAD_TAIL = 30.0
"""Degrees of freedom (Student's t distribution) of the errors in evidence that depends on roads.
The variance of this evidence already takes into account how long a slope lasts.
"""
_LOG_BEGINNINGS: Final = math.log(FALSE_ALARM_H * 3600.0 / (SEGMENTS[0] * BLOCK_TICKS * TICK_S))


class EntryChange(NamedTuple):
    """Changes of an entry of the error matrix over the last spans of road segments.

    turn: (3,) decrease of the entry for a unit rotation about each axis. size: (S,) change of the
    entry over each span. variance: (S,) variance of each change. tail: degrees of freedom
    (Student's t distribution) of the errors.
    """

    turn: Array
    size: Array
    variance: Array
    tail: float = ANSWER_TAIL


class Move(Struct, frozen=True):
    """Most likely rotation of the sensor.

    axis: 0 roll, 1 pitch, 2 yaw. size: angle [rad]. blocks: number of blocks since the move.
    deviations: root of twice the largest log likelihood ratio, with the sign of `size`. log_odds:
    logarithm of the statistic divided by its threshold. Above zero, the move is certain. At most
    one false alarm is expected in `FALSE_ALARM_H` hours.
    """

    axis: int
    size: float
    deviations: float
    blocks: int
    log_odds: float

    @property
    def is_certain(self) -> bool:
        """True if the sensor was moved."""
        return self.log_odds > 0.0

    @property
    def doubt(self) -> float:
        """Additional standard deviation of the angle because of a move that is not certain [rad],
        weighted by the probability of the move.
        """
        return abs(self.size) * math.sqrt(probability(self.log_odds))


def likeliest_move(entries: Sequence[EntryChange], blocks: Sequence[int]) -> Move:
    """Return the move that fits the changes of all entries best.

    blocks: number of blocks since the beginning of each span.
    """
    turn, change, variance, tails = (np.array(x) for x in zip(*entries, strict=True))
    tail = tails[:, None, None, None]
    spread = tail * variance[:, None, :, None]
    off = change[:, None, :, None] + turn[:, :, None, None] * SIZES
    usual = spread + np.square(change[:, None, :, None])
    log = -0.5 * ((tail + 1.0) * np.log((spread + off * off) / usual)).sum(axis=0)
    most = float(log.max())
    share = np.exp(log - most)
    log_odds = most + math.log(share.sum() / (3 * len(SIZES))) - _LOG_BEGINNINGS
    axis, span = divmod(int(share.sum(axis=2).argmax()), len(blocks))
    part = share[axis, span]
    size = float(part @ SIZES / part.sum())
    deviations = math.copysign(math.sqrt(2.0 * max(most, 0.0)), size)
    return Move(axis, size, deviations, blocks[span], log_odds)
