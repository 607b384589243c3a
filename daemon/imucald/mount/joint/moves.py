"""Detect a move of the sensor.

The data after each possible time of a move are compared with the data before it. A move turns both
sensors by one angle about an axis of the vehicle. The rotation changes the responses of the force
to motion, the axis of turning and the level force. The terms of the sensor itself stay the same.
For each possible beginning in the last minutes, the change of every entry is fitted together with
all constant coefficients (`FitSums.changes`). The likelihoods of all sizes of a rotation about an
axis, each entry with heavy tails, give one ratio against no rotation. The sum of these ratios over
the beginnings is the statistic of Shiryaev and Roberts, as in `drift`.
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
LEAST_BEFORE = 6
"""Smallest number of road segments before a move."""
_HALF: Final = np.radians(np.geomspace(1.0, 30.0, 18))
SIZES: Final = np.concatenate([-_HALF[::-1], _HALF])
"""Rotations that are tested, with equal probabilities [rad]: a rotation of less than 1 deg misleads
no consumer.
"""
ROAD_TAIL = 30.0
"""Degrees of freedom of the errors in evidence that depends on roads: the variance already contains
the length of stretches of road.
"""
_LOG_BEGINNINGS: Final = math.log(FALSE_ALARM_H * 3600.0 / (SEGMENTS[0] * BLOCK_TICKS * TICK_S))


class EntryChange(NamedTuple):
    """Changes (S,) of an entry over the last spans, and their variances (S,).

    turn: (3,) decrease of the entry for a unit rotation about each axis. tail: degrees of freedom.
    """

    turn: Array
    size: Array
    variance: Array
    tail: float = ANSWER_TAIL


class Move(Struct, frozen=True):
    """Most likely rotation: axis (0 roll, 1 pitch, 2 yaw), size [rad], and blocks since then.

    deviations: the root of twice the log of the ratio of likelihoods, signed. log_odds: log of the
    statistic over its threshold. Above zero the sensor was moved; a false alarm comes once in
    `FALSE_ALARM_H`.
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
        """Additional deviation while the move is not certain, weighted by its probability [rad]."""
        return abs(self.size) * math.sqrt(probability(self.log_odds))


def likeliest_move(entries: Sequence[EntryChange], blocks: Sequence[int]) -> Move:
    """Return the move that fits the changes of all entries best.

    blocks: blocks since the beginning of each span.
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
