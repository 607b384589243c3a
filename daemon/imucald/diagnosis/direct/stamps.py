"""Estimate the cycle time of frames from their time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.core.arrays import Array

NEAR, NEAR_SHARE, JITTER_SHARE, WANDER_S = 0.85, 0.4, 0.2, 0.01
"""A cycle is known if most stamps are near it, scatter little and do not drift away from it. A unit
that is asked for each value (OBD-II) has no cycle."""
ADDED_UP = 0.5
"""Limit of the variance of a sum of many steps over the sum of their variances (variance ratio; Lo
and MacKinlay 1988). The ratio is 1 if each step begins when the one before ends (a new request
after each answer), and near 0 if a clock triggers the frames."""
LOCKS, NEIGHBOURS = 4, 50
"""Number of neighbouring stamps with a common phase. Over these, an error of 1 % in the cycle moves
the phase by at most half a cycle."""
PARTS = 8
"""Number of parts of a drive; the scatter of their slopes gives the accuracy of the whole slope."""


@dataclass(frozen=True)
class Clock:
    """Cycle time of frames."""

    cycle_s: float
    se: float
    """Relative standard deviation of the cycle time."""
    steps: Array
    """(N - 1,) cycles between frames."""
    is_steady: bool
    """True if stamps follow the cycle over the whole drive. Lost frames show even if the logger's
    clock wanders."""


def clock_of(t: Array) -> Clock | None:
    """Estimate the cycle time from stamps t (N,) [s], by a straight line over the frame numbers;
    None without a clear cycle. The median of the steps is not the cycle if frames are lost: it then
    lies at another quantile of the jitter."""
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
    # Errors that wander from stamp to stamp add up, so slopes of parts are compared, not samples.
    parts = zip(np.array_split(count, PARTS), np.array_split(at, PARTS), strict=True)
    slopes = [np.polyfit(n, t, 1)[0] for n, t in parts]
    se = float(np.std(slopes, ddof=1) / np.sqrt(PARTS))
    return Clock(cycle, se / cycle, np.round(steps / cycle), is_steady)


def _adds_up(steps: Array, cycle: float) -> bool:
    """True if delays add up from frame to frame: then no clock triggers the frames, and the mean
    step is no clock's cycle. steps: (N,) [s]."""
    late = steps - cycle * np.maximum(np.round(steps / cycle), 1.0)
    late = late[np.abs(late) < NEAR_SHARE * cycle]
    late = late - late.mean()
    total = np.concatenate([[0.0], np.cumsum(late)])
    many = min(NEIGHBOURS, len(late) // 2)
    power = float(np.mean((total[many:] - total[:-many]) ** 2))
    return bool(power > WANDER_S**2 and power > ADDED_UP * many * float(np.mean(late**2)))


def _counted(at: Array, cycle: float) -> Array:
    """(N,) whole cycles since the first frame. at: (N,) stamps [s], with one at 0.

    Each stamp is counted from the phase of its neighbours (circular mean), which moves slowly. If
    each step were rounded by itself, two late frames could lose a cycle permanently.
    """
    share = at / cycle
    first = np.arange(0, len(at), NEIGHBOURS)
    turns = np.add.reduceat(np.exp(2j * np.pi * share), first)
    middle = np.add.reduceat(at, first) / np.diff(np.append(first, len(at)))
    phase = np.unwrap(np.angle(turns)) / (2.0 * np.pi)
    return np.asarray(np.round(share - np.interp(at, middle, phase)))
