"""Stuck and clipped samples of a whole recording, found with the tests that watch a sensor while
driving.

A whole recording shows where a stuck run began, all samples on the end of the range, and the
distribution of the values below the end of the range.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, Flags, Index
from imucald.motion.hops import HOP_TICKS, AxisHops, Carry, hop_rows
from imucald.motion.rails import PILE, USUAL_CHANGE, more_often
from imucald.motion.sample_health import NOISE, AxisJudges
from imucald.motion.standstill import ROLLING_SPEED
from imucald.motion.ticks import TICK_RATE


class RecordedHealth(Struct, frozen=True):
    """Faulty samples of a sensor.

    stuck: (N,) True if all axes of the sample repeat their values. on_rail: (N,) True if any axis
    of the sample is at the end of its range. ends: the ends of the ranges that were found, in the
    order of the axes, the upper end before the lower end.
    """

    stuck: Flags
    on_rail: Flags
    ends: tuple[float, ...]


def recorded_health(
    channel: str, t: Array, values: Array, speed: tuple[Array, Array], chance: float
) -> RecordedHealth:
    """Find the faults of all samples of a sensor. t: (N,) [s]. values: (N,) or (N, axes), N > 0,
    SI.

    speed: times [s] and values [m/s] of the vehicle's speed. chance: accepted probability of one
    false finding among all axes and hops (half a second each) of the recording.
    """
    table = values.reshape(len(t), -1)
    hop = np.floor(t * TICK_RATE).astype(np.int64) // HOP_TICKS
    is_next = np.diff(hop, prepend=hop[0] - 1) > 0
    own = hop[is_next] - hop[0]  # a pause has no hops: nothing is asked there
    hop = np.cumsum(is_next) - 1
    hops, axes = len(own), table.shape[1]
    moving = np.ones(hops, dtype=bool)
    for edge in (own, own + 1):
        at = t[0] + edge * HOP_TICKS / TICK_RATE
        moving &= np.abs(np.interp(at, *speed)) > ROLLING_SPEED
    rows = hop_rows(table, hop, hops, Carry.none(axes))
    # Each hop asks of each axis whether it is stuck, and of both its ends whether it is a rail.
    surprise = math.log(3.0 * axes * hops / chance)
    on_rail = np.zeros(len(t), dtype=bool)
    # Equal rows of all axes are runs of a count of their changes.
    changes = np.cumsum((np.diff(table, axis=0, prepend=table[:1]) != 0.0).any(axis=1))
    whole = hop_rows(changes[:, None].astype(float), hop, hops, Carry.none(1))
    is_stuck, _, _ = AxisJudges(0.0, (surprise, math.inf)).judge(AxisHops(0, whole), moving)
    stuck = _runs_at(changes, whole.edges[1:][is_stuck] - 1)
    ends: list[float] = []
    for axis in range(axes):
        judges = AxisJudges(NOISE.get(channel, 0.0), (surprise, surprise))
        is_stuck, _, _ = judges.judge(AxisHops(axis, rows), moving)
        x = table[:, axis]
        repeats = _runs_at(x, rows.edges[1:][is_stuck] - 1)
        rails, step = judges.rails.ends, float(rows.step[axis, -1])
        extremes = float(x.max()), float(x.min())
        found = [
            end
            for end, rail in zip(extremes, rails, strict=True)
            if (end == rail or _is_crowded(x, end, step, surprise)) and _is_full(x, end, step)
        ]
        for end in extremes:
            here = x == end
            # A range has two ends: an axis that repeats its other extreme is at the other end.
            if end in found or (found and (here & repeats).any()):
                on_rail |= here
                ends.append(end)
    return RecordedHealth(stuck, on_rail, tuple(ends))


def _runs_at(x: Array, places: Index) -> Flags:
    """Return which values (N,) belong to a run of equal values that contains one of these
    places."""
    run = np.cumsum(np.diff(x, prepend=x[0]) != 0.0)
    return np.isin(run, run[places])


def _beside(x: Array, end: float, step: float) -> tuple[int, int]:
    """Return the number of values (N,) one step and two steps before the end of the range."""
    away = np.abs(x - end) / step
    one, two = (np.count_nonzero(np.abs(away - k) < 0.5) for k in (1.0, 2.0))
    return int(one), int(two)


def _is_full(x: Array, end: float, step: float) -> bool:
    """Return whether at least as many values (N,) are at the end as on each of the two steps before
    the end.

    All values that would lie beyond a rail are on the rail. An axis of a vector of constant length
    is often near its largest value, although there is no rail.
    """
    return bool(PILE * np.count_nonzero(x == end) > max(_beside(x, end, step)))


def _is_crowded(x: Array, end: float, step: float, surprise: float) -> bool:
    """Return whether values (N,) reach their end too often, compared with the two steps before the
    end.

    A stay counts once, because a slow signal stays at any value. An axis reaches a rail with its
    usual changes. A jump to the end therefore does not count, because it comes from a sender's
    spike or a loose contact.
    """
    here, change = x == end, np.abs(np.diff(x))
    is_usual = change <= USUAL_CHANGE * change.sum() / max(np.count_nonzero(change), 1)
    visits = int(np.count_nonzero((here[1:] > here[:-1]) & is_usual)) + int(here[0])
    count = visits + sum(_beside(x, end, step))
    return more_often(visits, count, -math.log(PILE / (PILE + 2.0))) > surprise
