"""Replace signals by their means between the times at which the speed is known.

Some speed signals have few samples, have coarse steps, or are zero below some km/h. The speed is
then known only at some times. These times are called knots. There are three kinds of knots: times
of samples, times at which the speed passes the middle between two steps, and times at rest.
Interpolation does not give the true speed between two knots. All signals of the drive are therefore
replaced by their means between the knots. The mean of dv/dt between two knots is known exactly. The
equations between the signals are linear, so the equations are also valid for the means.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array, Flags, distinct, true_runs
from imucald.motion.standstill import ZERO_SPEED
from imucald.motion.ticks import TICK_S

GENTLE = 0.5
"""Smallest assumed acceleration [m/s^2] of a vehicle that stops or starts, while the speed is below
the smallest speed that the signal shows. The value is a quarter of 2 m/s^2, the limit of ISO 15622
for an adaptive cruise control.
"""
SURE = 0.99
"""Fraction of the smallest speed that the signal shows. If a value is below this fraction, the
vehicle was at rest in a part of the tick.
"""
DENSE = 1.5
"""Largest distance between two knots [ticks of 0.1 s] for which the speed counts as known in every
tick between the knots.
"""


def known_times(knots: Array, speed: Array, least: float) -> Array:
    """Return the knots, from knots (K,) [ticks of 0.1 s], at which the speed is really known.

    speed: (N,) [m/s]. least: smallest speed that the sender shows [m/s]. The speed of such a sender
    is zero while the vehicle still rolls, and remains zero after the vehicle has started.
    """
    margin = least / GENTLE / TICK_S
    silent = np.abs(speed) < max(ZERO_SPEED, SURE * least)
    if margin < 1.0 or not silent.any():
        return knots
    hidden = np.zeros(len(knots), dtype=bool)
    for start, stop in true_runs(silent).tolist():
        if start > 0:
            hidden |= (knots >= start) & (knots < min(start + margin, stop))
        if stop < len(speed):
            hidden |= (knots > max(stop - margin, start)) & (knots <= stop)
    return knots[~hidden]


def known_rate(knots: Array, n: int) -> Array:
    """Return the number of knots (K,) [ticks of 0.1 s] per tick, around each of n ticks (n,)."""
    ends = distinct(np.concatenate([[0.0, float(n)], knots[(knots > 0.0) & (knots < n)]]))
    gaps = np.maximum(np.diff(ends), 1.0)
    return np.asarray(1.0 / gaps[np.searchsorted(ends, np.arange(n) + 0.5) - 1])


def means_between(x: Array, knots: Array, use: Flags) -> Array:
    """Replace columns x (N, w) of ticks by their means between knots (K,) [ticks of 0.1 s].

    use: (N,) flags of the usable ticks. No mean contains both usable and unusable ticks. A tick
    between knots that are at most `DENSE` ticks apart stays unchanged.
    """
    n = len(x)
    breaks = np.flatnonzero(use[1:] != use[:-1]) + 1.0
    inside = knots[(knots > 0.0) & (knots < n)]
    ends = distinct(np.concatenate([[0.0, float(n)], breaks, inside]))
    long = np.diff(ends) > DENSE
    if not long.any():
        return x
    total = np.concatenate([np.zeros((1, x.shape[1])), np.cumsum(x, axis=0)])
    whole = np.minimum(ends.astype(int), n - 1)
    at_ends = total[whole] + (ends - whole)[:, None] * x[whole]
    edges = np.arange(n + 1.0)
    piece = np.clip(np.searchsorted(ends, edges, side="right") - 1, 0, len(long) - 1)
    part = (edges - ends[piece]) / np.diff(ends)[piece]
    gone = at_ends[piece] + part[:, None] * (at_ends[piece + 1] - at_ends[piece])
    touched = np.zeros(n, dtype=bool)
    for first, last in zip(ends[:-1][long].tolist(), ends[1:][long].tolist(), strict=True):
        touched[int(first) : int(np.ceil(last))] = True
    return np.where(touched[:, None], gone[1:] - gone[:-1], x)
