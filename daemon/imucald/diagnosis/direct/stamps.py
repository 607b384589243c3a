"""The cycle in which frames are sent, from their time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.core.arrays import Array

NEAR, NEAR_SHARE, JITTER_SHARE, WANDER_S = 0.85, 0.4, 0.2, 0.01
"""A cycle is known where most stamps are near it, scatter little, and do not walk away from it: who
is asked for each value (OBD-II) has none."""
ADDED_UP = 0.5
"""Variance of the sum of many steps over the sum of their variances: 1 where each begins when the
one before it ends (who is asked again on the answer), near 0 where a clock sends (variance ratio;
Lo and MacKinlay 1988)."""
LOCKS, NEIGHBOURS = 4, 50
"""Stamps that share a phase: a cycle known to 1 % moves it by half a cycle at most."""
PARTS = 8
"""Of a drive: their slopes tell how well that of the whole is known."""


@dataclass(frozen=True)
class Clock:
    """Cycle time of frames."""

    cycle_s: float
    se: float
    """Its relative deviation."""
    steps: Array
    """(N - 1,) cycles between frames."""
    is_steady: bool
    """Whether stamps keep to it over the drive; a logger's clock that wanders still shows what is
    lost."""


def clock_of(t: Array) -> Clock | None:
    """The clock that stamps t (N,) [s] show, by a line through them over the number of each frame;
    None without a clear cycle. The median of the steps is no cycle where frames are lost: with a
    share p of them it lies at another quantile of the jitter."""
    steps = np.diff(t)
    if len(steps) < 50:
        return None
    cycle = float(np.median(steps))
    near = np.abs(steps - cycle) < NEAR_SHARE * cycle
    if near.mean() < NEAR or np.std(steps[near]) > JITTER_SHARE * cycle:
        return None
    at = t - t[0]
    for _ in range(LOCKS):
        count = _counted(at, cycle)
        centred = count - count.mean()
        slope = float(centred @ (at - at.mean()) / (centred @ centred))
        if abs(slope / cycle - 1.0) > 0.02:
            return None
        cycle = slope
    left = at - at.mean() - cycle * centred
    is_steady = bool(np.std(left) <= WANDER_S + 0.3 * cycle) and not _adds_up(steps, cycle)
    # What wanders from stamp to stamp adds up: slopes of parts are compared, not samples.
    parts = zip(np.array_split(count, PARTS), np.array_split(at, PARTS), strict=True)
    slopes = [np.polyfit(n, t, 1)[0] for n, t in parts]
    se = float(np.std(slopes, ddof=1) / np.sqrt(PARTS))
    return Clock(cycle, se / cycle, np.round(steps / cycle), is_steady)


def _adds_up(steps: Array, cycle: float) -> bool:
    """Whether delay adds up from frame to frame: then nothing sends in a cycle, and the mean of
    the steps is no clock's. steps: (N,) [s]."""
    late = steps - cycle * np.maximum(np.round(steps / cycle), 1.0)
    late = late[np.abs(late) < NEAR_SHARE * cycle]
    late = late - late.mean()
    total = np.concatenate([[0.0], np.cumsum(late)])
    many = min(NEIGHBOURS, len(late) // 2)
    power = float(np.mean((total[many:] - total[:-many]) ** 2))
    return bool(power > WANDER_S**2 and power > ADDED_UP * many * float(np.mean(late**2)))


def _counted(at: Array, cycle: float) -> Array:
    """(N,) whole cycles since the first frame. at: (N,) stamps [s], one comes at 0.

    Each stamp is counted from the phase of its neighbours (circular mean), which moves slowly.
    Steps that are rounded one by one lose a cycle for good wherever two late frames lie just so.
    """
    share = at / cycle
    first = np.arange(0, len(at), NEIGHBOURS)
    turns = np.add.reduceat(np.exp(2j * np.pi * share), first)
    middle = np.add.reduceat(at, first) / np.diff(np.append(first, len(at)))
    phase = np.unwrap(np.angle(turns)) / (2.0 * np.pi)
    return np.asarray(np.round(share - np.interp(at, middle, phase)))
