"""A signal's frames counted: its cycle, and how many frames are missing where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imucald.core.samples import Series
from imucald.diagnosis.faults.fault import Array, Index

NEAR = 0.4
"""A frame is in time if it comes within this share of its period."""
REGULAR_SHARE = 0.8
"""Share of frames in time from which on a signal has a cycle; polled answers do not."""
ROUND = 128
"""Frames over which a unit's clock is as good as constant."""
EARLY = 0.25
"""A frame may come so much of a period before it is due."""
FAR, WANDERING = 16, 2.2
"""Over so many frames a clock's beat is as regular as from one to the next; steps that add up at
random spread four times as much. 2.2 lies between, in the ratio of spreads."""
BLOCKS = 24
"""Parts of the drive whose scatter says how well the cycle is known."""


@dataclass(frozen=True)
class Cycle:
    """Frames of one signal that has a cycle."""

    period_s: float
    std: float
    """Of the period, as a share of it."""
    number: Index
    """(N,) of each frame, missing ones counted."""
    lost: Index
    """(N-1,) frames missing between each frame and the next."""

    @property
    def frames(self) -> int:
        """How many frames there should be."""
        return int(self.number[-1]) + 1


def cycle_of(series: Series) -> Cycle | None:
    """Count a signal's frames; None if it has no cycle.

    A frame that is late (a busy bus, a slow task) makes a long step and a short one: it is not
    lost, because the count catches up.
    """
    steps_s = np.diff(series.t)
    period = float(np.median(steps_s))
    if period <= 0.0:
        return None
    in_time = np.abs(steps_s - period) < NEAR * period
    if np.mean(in_time) < REGULAR_SHARE:
        return None
    period = float(np.mean(steps_s[in_time]))
    if _wanders(series.t, period):
        return None
    since = np.asarray(series.t - series.t[0], dtype=np.float64)
    place = (since - _beat(since, period)) / period
    surplus = np.floor(place + EARLY).astype(np.int64) - np.arange(len(place))
    # A late frame seems to follow a lost one until the next comes: only what stays is lost.
    missing = np.minimum.accumulate(surplus[::-1])[::-1]
    missing -= missing[0]
    lost = np.diff(missing)
    number = np.arange(len(place)) + missing
    due = np.asarray(period * number, dtype=np.float64)
    share, std = _slope(due, since)
    return Cycle(period * share, std, number, lost)


def _wanders(t: Array, period: float) -> bool:
    """Whether each frame is timed from the one before (a polled answer) and not by a clock."""
    one = np.diff(t) - period
    many = t[FAR:] - t[:-FAR]
    # Whole periods are lost frames.
    many = many - period * np.rint(many / period)
    return _spread(many) > WANDERING * max(_spread(one), 1e-3 * period)


def _spread(x: Array) -> float:
    low, high = np.quantile(x[:: max(1, len(x) // 20_000)], (0.25, 0.75))
    return float(high - low)


def _beat(t: Array, period: float) -> Array:
    """When frames were due, less whole periods: (N,) [s], from those that came first in a while."""
    rough = np.concatenate(([0], np.cumsum(np.rint(np.diff(t) / period))))
    late = t - period * rough
    whole = len(t) // ROUND * ROUND
    blocks = np.partition(late[:whole].reshape(-1, ROUND), ROUND // 20, axis=1)
    # A frame too many in the rough count moves all that follow by a period.
    due = np.unwrap(blocks[:, ROUND // 20], period=period)
    middle = t[:whole].reshape(-1, ROUND)[:, ROUND // 2]
    return np.interp(t, middle, due)


def _slope(x: Array, y: Array) -> tuple[float, float]:
    """Slope of y over x and its standard deviation, from the means of blocks."""
    bounds = np.linspace(0, len(x), BLOCKS + 1).astype(np.int64)[:-1]
    count = np.diff(np.append(bounds, len(x)))
    mean_x, mean_y = np.add.reduceat(x, bounds) / count, np.add.reduceat(y - x, bounds) / count
    mean_x = mean_x - mean_x.mean()
    square = float(np.sum(mean_x**2))
    slope = float(np.sum(mean_x * mean_y)) / square
    residual = mean_y - mean_y.mean() - slope * mean_x
    # Neighbouring blocks may err alike: twice the scatter of independent ones.
    std = 2.0 * float(np.sqrt(np.sum(residual**2) / (BLOCKS - 2) / square))
    return 1.0 + slope, std
