"""Estimate the cycle time of frames from their time stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.core.arrays import Array

NEAR, NEAR_SHARE, JITTER_SHARE, WANDER_S = 0.85, 0.4, 0.2, 0.01
"""Conditions for a known cycle time: most time stamps are near the cycle, scatter little and do not
drift away from it. A unit that answers requests (OBD-II) has no cycle time."""
ADDED_UP = 0.5
"""Limit of the variance ratio: variance of a sum of many steps divided by the sum of their
variances (Lo and MacKinlay 1988). The ratio is 1 if each step begins when the previous step ends (a
new request after each answer). The ratio is near 0 if a clock triggers the frames."""
LOCKS, NEIGHBOURS = 4, 50
"""`NEIGHBOURS` is the number of neighbouring time stamps with a common phase. Over these time
stamps, an error of 1 % in the cycle time moves the phase by at most half a cycle. `LOCKS` is the
number of iterations."""
PARTS = 8
"""Number of parts of a drive. The scatter of the slopes in these parts gives the accuracy of the
slope in the whole drive."""


@dataclass(frozen=True)
class Clock:
    """Cycle time of frames."""

    cycle_s: float
    se: float
    """Relative standard deviation of the cycle time."""
    steps: Array
    """Number of cycles between successive frames (N - 1,)."""
    is_steady: bool
    """True if the time stamps follow the cycle over the whole drive. Lost frames are also visible
    if the clock of the logger wanders."""


def clock_of(t: Array) -> Clock | None:
    """Estimate the cycle time from time stamps t (N,) [s], with a straight line over the frame
    numbers. None without a clear cycle.

    If frames are lost, the median of the steps is not the cycle time, because it is then another
    quantile of the jitter."""
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
    """True if delays add up from frame to frame. No clock then triggers the frames, and the mean
    step is not the cycle time of a clock. steps: (N,) [s]."""
    late = steps - cycle * np.maximum(np.round(steps / cycle), 1.0)
    late = late[np.abs(late) < NEAR_SHARE * cycle]
    late = late - late.mean()
    total = np.concatenate([[0.0], np.cumsum(late)])
    many = min(NEIGHBOURS, len(late) // 2)
    power = float(np.mean((total[many:] - total[:-many]) ** 2))
    return bool(power > WANDER_S**2 and power > ADDED_UP * many * float(np.mean(late**2)))


def _counted(at: Array, cycle: float) -> Array:
    """Return the number of whole cycles since the first frame (N,). at: (N,) time stamps [s]; the
    first is 0.

    Each time stamp is counted from the phase of its neighbours (circular mean), which moves slowly.
    If each step were rounded separately, two late frames could lose a cycle permanently.
    """
    share = at / cycle
    first = np.arange(0, len(at), NEIGHBOURS)
    turns = np.add.reduceat(np.exp(2j * np.pi * share), first)
    middle = np.add.reduceat(at, first) / np.diff(np.append(first, len(at)))
    phase = np.unwrap(np.angle(turns)) / (2.0 * np.pi)
    return np.asarray(np.round(share - np.interp(at, middle, phase)))
