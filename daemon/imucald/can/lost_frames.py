"""Estimate the share of lost frames of a cyclic message from the times of the received frames.

The estimate also works with coarse time stamps. `diagnosis.direct.faults` finds which frames are
missing and the error of the sender's clock, but only if the time stamps follow a cycle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.message import Message

REGULAR, REGULAR_SHARE = 0.25, 0.6
"""A message is cyclic if the share REGULAR_SHARE of its intervals differs from its cycle by at most
REGULAR cycles. With a difference of 0.5 cycles, one and two cycles could not be distinguished, so
REGULAR is half of 0.5."""
MOST_CYCLES, MOST_S = 20, 2.0
"""If an interval is longer than both limits (cycles, seconds), the sender was off, and no frames
count as lost. A recorder that is too slow leaves gaps of some tenths of a second."""
TOGETHER = 32
"""Number of frames that are fitted with one grid of times. A cycle that is 1 % wrong gives an error
of a third of a cycle over 32 frames. A sender's clock does not drift that much in so few frames."""
MOST_ROWS = 128
"""Largest number of groups of frames. With this number of groups, the cycle is known to 0.1 %."""
PITCHES = np.exp(np.linspace(-0.16, 0.16, 129))
"""Tried cycles, divided by the median interval. Coarse time stamps change the median by up to a
sixth. The step is the resolution of `TOGETHER` frames."""
DROPPING_SHARE = 0.02
"""If every message loses at least this share, the cause is not a single sender."""


def lost_share(intervals: NDArray[np.float64], message: Message | None = None) -> float | None:
    """Return the share of lost frames; intervals: (N,) between the received frames [s].

    message: its description, if a database has one. Returns None for a message that is not cyclic,
    and for a message with a multiplexer, because each group has its own cycle.
    """
    if message is not None and message.is_multiplexed:
        return None
    cycle = float(np.median(intervals)) if len(intervals) else 0.0
    if not cycle:
        return None
    intervals = intervals[intervals < max(MOST_CYCLES * cycle, MOST_S)]
    cycle = cycle_of(intervals, cycle)
    near = np.abs(intervals / cycle - 1.0) < REGULAR
    if np.mean(near) < REGULAR_SHARE or not is_cycle_of(intervals, near):
        return None
    # The elapsed time in cycles: if one interval is too long, the next is too short.
    return max(0.0, 1.0 - len(intervals) * cycle / float(intervals.sum()))


def is_cycle_of(intervals: NDArray[np.float64], near: NDArray[np.bool_]) -> bool:
    """Return whether the intervals that are one cycle long, marked by `near`, take most of the time
    of all intervals (N,) [s].

    An adapter that hands over frames in batches stamps the frames of a batch closely one after the
    other. Most intervals are then equal, but they take nearly no time, and no sender has this
    cycle.
    """
    return bool(2.0 * intervals[near].sum() > intervals.sum())


def cycle_of(intervals: NDArray[np.float64], usual: float) -> float:
    """Return the cycle near `usual` [s] whose grid fits frames with intervals (N,) [s] best.

    Coarse or late time stamps scatter about the grid, and a lost frame leaves a place of the grid
    empty. Scatter and lost frames do not shift the best grid (periodogram), but they would shift
    the median.
    """
    rows = min(len(intervals) // TOGETHER, MOST_ROWS)
    if not rows:
        return usual
    t = np.cumsum(intervals[: rows * TOGETHER].reshape(rows, TOGETHER), axis=1)
    cycles = usual * PITCHES
    on_grid = np.exp(t[None] * (-2j * np.pi / cycles)[:, None, None]).sum(axis=2)
    power = (np.abs(on_grid) ** 2).sum(axis=1)
    k = int(power[1:-1].argmax()) + 1
    before, best, after = power[k - 1 : k + 2].tolist()
    bend = before - 2.0 * best + after
    if best < max(before, after) or not bend:  # outside the tried cycles
        return usual
    return float(cycles[k] * (PITCHES[1] / PITCHES[0]) ** (0.5 * (before - after) / bend))


def dropping_recorder(shares: Sequence[float | None]) -> str | None:
    """Return a text if the lost shares of several messages show a faulty recorder, else None."""
    known = [share for share in shares if share is not None]
    if len(known) < 2 or min(known) < DROPPING_SHARE:
        return None
    low, high = (f"{100.0 * share:.0f}" for share in (min(known), max(known)))
    part = low if low == high else f"{low} to {high}"
    return f"{part} % of the frames of each message are lost: the recorder seems to drop frames"
