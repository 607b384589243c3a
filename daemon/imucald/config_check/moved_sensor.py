"""Find a sensor that was moved within a recording, from the direction of gravity.

All comparisons of `check` and `init` assume one mount. If the sensor is turned during the
recording, correct signals contradict each other, and the mean of the gravity vectors is too short.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imucald.config_check.motion import MIN_STANDING_TICKS, Motion
from imucald.core.arrays import Array, true_runs
from imucald.core.text import clock
from imucald.motion.ticks import TICK_RATE

MOVED_DEG = 15.0
"""Smallest reported angle between gravity before and after a move [deg]. At stops on opposite
slopes of 12 %, gravity differs by 14 deg; steeper streets are rare."""
ONE_MOVE = 0.75
"""A move is reported only if it explains at least this share of the changes of gravity. A single
move does not explain the changes of a loose sensor, which moves all the time."""
LEAST_GRAVITY = 0.75
"""Smallest accepted magnitude of the mean gravity vector, relative to the usual size of the
specific force. Turns and braking change this size little."""
PART_TICKS = 300
"""Length of the parts of a drive without stops that are compared [ticks of 0.1 s]: half a minute.
"""


@dataclass(frozen=True)
class SensorMove:
    """A move of the sensor. deg: angle between gravity before and after the move, in sensor axes.
    before, after: the move happened between these times [s]."""

    deg: float
    before: float
    after: float

    @property
    def words(self) -> str:
        """Text that states the angle and the time of the move."""
        when = f"between {clock(self.before)} and {clock(self.after)}"
        return f"the sensor was moved {when}: gravity in its axes turns by {self.deg:.0f} deg"


def sensor_move(motion: Motion) -> SensorMove | None:
    """Return the move of the sensor that explains most of the change of gravity, or None.

    Gravity is compared between stops, or between parts of half a minute if there are not two stops.
    """
    if motion.planar or motion.accel is None:
        return None
    force, ticks = motion.accel, len(motion.accel)
    stops = _stops(motion)
    found = _split(force, stops if len(stops) > 1 else _parts(0, ticks))
    if found is None or found[0] < MOVED_DEG:
        return None
    angle, before, after, size = found
    if size < LEAST_GRAVITY * float(np.nanmedian(np.linalg.norm(force, axis=1))):
        return None  # gravity is removed from the readings
    closer = _split(force, _parts(before - PART_TICKS, after + PART_TICKS))
    if closer is not None and len(stops) > 1:
        before, after = max(before, closer[1]), min(after, closer[2])
    # the move may be within either of both parts
    before, after = max(before - PART_TICKS, 0), min(after + PART_TICKS, ticks)
    return SensorMove(angle, before / TICK_RATE, after / TICK_RATE)


def _parts(first: int, stop: int) -> list[tuple[int, int]]:
    """Return the first tick and the tick after the end of each part of half a minute."""
    return [(t, t + PART_TICKS) for t in range(max(first, 0), stop - PART_TICKS + 1, PART_TICKS)]


def _split(force: Array, parts: Sequence[tuple[int, int]]) -> tuple[float, int, int, float] | None:
    """Find the best split of the parts in two groups. Return the angle [deg] between the gravity
    vectors of both groups, the end of the first group, the beginning of the second group, and the
    smaller size of the two vectors.

    force: (n, 3). The best split has the smallest sum of squared distances from the two means.
    Returns None if no split explains the changes.
    """
    known = [(a, b, _mean(force[a:b])) for a, b in parts]
    known = [row for row in known if np.isfinite(row[2]).all()]
    weights = np.array([b - a for a, b, _ in known], np.float64)
    forces = np.array([mean for _, _, mean in known]).reshape(-1, 3)
    total = (
        float(weights @ np.square(forces - _weighted(forces, weights)).sum(axis=1))
        if known
        else 0.0
    )
    best: tuple[float, int, Array, Array] | None = None
    for i in range(1, len(known)):
        first, second = (_weighted(forces[k], weights[k]) for k in (slice(i), slice(i, None)))
        share = weights[:i].sum() * weights[i:].sum() / weights.sum()
        energy = share * float(np.square(first - second).sum())
        if best is None or energy > best[0]:
            best = energy, i, first, second
    if best is None or best[0] < ONE_MOVE * total:
        return None
    _, i, first, second = best
    sizes = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    if min(sizes) <= 0.0:
        return None
    cosine = float(first @ second) / (sizes[0] * sizes[1])
    angle = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
    return angle, known[i - 1][1], known[i][0], min(sizes)


def _stops(motion: Motion) -> list[tuple[int, int]]:
    if motion.standing is None:
        return []
    runs = true_runs(motion.standing).tolist()
    return [(a, b) for a, b in runs if b - a >= MIN_STANDING_TICKS]


def _mean(force: Array) -> Array:
    """Return the mean of the known rows (n, 3); NaN if fewer than half are known."""
    known = np.isfinite(force).all(axis=1)
    if np.count_nonzero(known) < 0.5 * len(force):
        return np.full(3, np.nan)
    return np.asarray(force[known].mean(axis=0))


def _weighted(forces: Array, weights: Array) -> Array:
    return np.asarray(weights @ forces / weights.sum())
