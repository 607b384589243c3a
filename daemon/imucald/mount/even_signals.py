"""Signals on an even time grid: interpolation of samples at the middles of ticks."""

from __future__ import annotations

import math

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.motion.coarse_speed import passages
from imucald.motion.ticks import TICK_S

BLOCK_TICKS = 64
"""Ticks of a block: 6.4 s. Data are examined once per block, so this length determines the
computing time."""
LAG = 16
"""Number of ticks by which the processing is behind the data: a speed of 1 Hz with jitter must have
arrived."""
BEFORE = 24
"""Ticks of context in front of a block."""
KEEP = BEFORE + LAG
ROWS = KEEP + BLOCK_TICKS
"""Number of ticks from which a block is computed."""
ACCEL_GAP = 0.35
"""Longest hole in accelerometer or gyroscope data that is bridged [s]: one lost sample at 5 Hz."""
SPEED_GAP = 2.3
"""Longest hole in the speed that is bridged [s]: one lost sample at 1 Hz."""
PART = slice(BEFORE - 1, BEFORE + BLOCK_TICKS + 1)
"""The block's own ticks within `ROWS`, with one more tick at both ends for dv/dt."""
MID = slice(1, BLOCK_TICKS + 1)
"""The block's own ticks within `PART`."""
_BACK = (np.arange(ROWS) - (ROWS - 1)) * TICK_S


def bridged(at: Array, times: Array, values: Array, longest: float) -> tuple[Array, Flags]:
    """Interpolate samples (M,) or (M, w) at times (N,). The second result is False for a time in a
    hole longer than `longest` [s].

    at: middles of the ticks [s].
    """
    m = len(times)
    if m < 1:
        return np.zeros((len(at), *values.shape[1:])), np.zeros(len(at), dtype=bool)
    after = times.searchsorted(at)
    low, high = np.maximum(after - 1, 0), np.minimum(after, m - 1)
    right, left = times[high], times[low]
    width = right - left
    # A tick that a hole cuts has samples of its own, whose mean is not at its middle.
    own = np.minimum(np.abs(at - left), np.abs(right - at)) <= 0.5 * TICK_S
    ok = (width <= longest) | own
    ends = (after == 0) | (after == m)  # before the first sample, or after the last
    if ends.any():
        ok[ends] = np.abs(at - left)[ends] <= 0.3 * longest
    if values.ndim == 1:
        return np.interp(at, times, values), ok
    width[width <= 0.0] = math.inf
    before = values[low]
    return np.asarray(before + ((at - left) / width)[:, None] * (values[high] - before)), ok


def bridged_speed(
    at: Array, times: Array, values: Array, step: float, is_in_each_tick: bool
) -> tuple[Array, Flags, Array | None]:
    """Interpolate speeds (M,) as `bridged` does. The speeds may be coarse.

    Also returns the times (K,) at which the speed is known [s]; None: in each tick. step:
    resolution step of the speeds [m/s]; 0: not coarse. is_in_each_tick: every tick has a speed.
    """
    out, ok = bridged(at, times, values, SPEED_GAP)
    if step:
        times, speeds = passages(times, values, step)
        return np.interp(at, times, speeds), ok, times
    return out, ok, None if is_in_each_tick or not len(times) else times


def times_of(end: float) -> Array:
    """Return the ends of the ticks (ROWS,) of a block [s]. end: end of its last tick [s]."""
    return np.asarray(end + _BACK)


def sampling_walk(times: Array, rates: Array, counts: Array, longest: float) -> Array:
    """Return the growth of the variance (3, 3) of an angle that is integrated from a gyroscope with
    few samples [rad^2/s].

    Such a sensor measures the rate at an instant, and not the mean rate since the previous sample.
    A vibration faster than half of the sample rate then looks like slow turning (aliasing). The
    errors add up: the error of the angle is the sum of h_i e_i. Here e_i is the part of a sample
    that is independent of its neighbours, and h_i is the time between the middles of the two
    neighbouring gaps. The size of e is computed from the samples. A sample differs from the line
    between its neighbours by r_i = e_i - a e_(i-1) - b e_(i+1), a + b = 1, so that E[r r'] = (1 +
    a^2 + b^2) E[e e']. Real quick turning increases r, so the walk is estimated too large rather
    than too small.

    times: (M,) [s]. rates: mean rates (M, 3) [rad/s], each of `counts` (M,) samples. Only a mean of
    a single sample is a measurement at an instant, so the result is zero if there are no such
    means. longest: longer holes are not bridged [s].
    """
    if len(times) < 3:
        return np.zeros((3, 3))
    gaps = np.diff(times)
    before, after = gaps[:-1], gaps[1:]
    stands_for = 0.5 * (before + after)
    use = (counts[1:-1] < 2) & (np.maximum(before, after) <= longest)
    if not np.count_nonzero(use):
        return np.zeros((3, 3))
    b = before[use] / (before[use] + after[use])
    a = 1.0 - b
    left = rates[1:-1][use] - a[:, None] * rates[:-2][use] - b[:, None] * rates[2:][use]
    weight = stands_for[use] ** 2 / (1.0 + a * a + b * b)
    out: Array = (left * weight[:, None]).T @ left / float(stands_for.sum())
    return out
