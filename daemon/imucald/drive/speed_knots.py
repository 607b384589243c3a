"""Between two times at which a speed is known, only its mean slope is.

A speed that comes seldom, in coarse steps, or not at all below some km/h is known at some times,
its knots: at its samples, as it passes the middle between two steps, at rest. What it did between
them no interpolation tells. So all signals of the drive are replaced by their means between the
knots: of dv/dt that mean is known exactly, and the equations between the signals, which are
linear, hold between the means as they do between the signals.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, true_runs
from imucald.motion.standstill import ZERO_SPEED
from imucald.motion.ticks import TICK_S

Flags = NDArray[np.bool_]

GENTLE = 0.5
"""A vehicle that stops or starts passes the speeds that its sender does not show with so much
[m/s^2] or more: half of what is comfortable (ISO 15622 allows a speed control 2 m/s^2)."""
SURE = 0.99
"""A speed below that part of the least that is shown is the mean over a tick with standstill."""
DENSE = 1.5
"""Knots that are no more than so many ticks apart are in every tick."""


def known_times(knots: Array, speed: Array, least: float) -> Array:
    """Of knots (K,) [ticks] those at which a speed (N,) is known that shows none below `least`.

    Such a sender says zero while the vehicle still rolls, and again before it is seen to start.
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


def means_between(x: Array, knots: Array, use: Flags) -> Array:
    """Replace columns x (N, w) of ticks by their means between knots (K,) [ticks].

    Ticks that are not to be used (N,) end a mean on both sides. Where a tick lies between knots
    that are less than two ticks apart, it stays as it is.
    """
    n = len(x)
    breaks = np.flatnonzero(use[1:] != use[:-1]) + 1.0
    ends = np.unique(np.concatenate([[0.0, float(n)], breaks, knots[(knots > 0.0) & (knots < n)]]))
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
