"""How many frames of a cyclic message did not come, by the times of those that came.

A share is asked for, also of coarse stamps. `diagnosis.direct.stamps` asks which frames are missing
and how far the sender's clock is off, and answers where stamps keep to a cycle.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.message import Message

REGULAR, REGULAR_SHARE = 0.25, 0.6
"""A message whose intervals are mostly its cycle, within such a part of it, is sent in cycles. Half
a cycle off, one interval is as good as two; this is half of that."""
MOST_CYCLES, MOST_S = 20, 2.0
"""An interval that is longer than both [s] is a sender that was off, not lost frames: a recorder
that does not keep up leaves holes of some tenths of a second, whatever the cycle."""
TOGETHER = 32
"""Frames whose times are laid on one grid: a cycle that is 1 % off shows in them as a third of it,
and a sender's clock does not drift by that in so few."""
MOST_ROWS = 128
"""More say no more of a cycle: it is known to a thousandth by then."""
PITCHES = np.exp(np.linspace(-0.16, 0.16, 129))
"""Cycles that are tried, over the usual interval: coarse stamps move that by a sixth. They are as
far apart as those frames tell."""
DROPPING_SHARE = 0.02
"""Where so much of every message is lost, it is not one sender's fault."""


def lost_share(intervals: NDArray[np.float64], message: Message | None = None) -> float | None:
    """Share of the frames that did not come; intervals: (N,) between those that came [s].

    message: its description, where a database has one. None for a message that is not sent in
    cycles, and for one with a multiplexer: each of its groups has a cycle of its own.
    """
    if message is not None and message.is_multiplexed:
        return None
    cycle = float(np.median(intervals)) if len(intervals) else 0.0
    if not cycle:
        return None
    intervals = intervals[intervals < max(MOST_CYCLES * cycle, MOST_S)]
    cycle = _cycle_of(intervals, cycle)
    if np.mean(np.abs(intervals / cycle - 1.0) < REGULAR) < REGULAR_SHARE:
        return None
    # The time that passed in cycles: what one interval is too long the next is too short.
    return max(0.0, 1.0 - len(intervals) * cycle / float(intervals.sum()))


def _cycle_of(intervals: NDArray[np.float64], usual: float) -> float:
    """The cycle on whose grid frames lie best that came (N,) intervals apart [s], near the usual.

    Stamps that are coarse, or late now and then, scatter about the grid; a lost frame leaves a
    place of it free. Both leave the grid as it is, where the median moves (periodogram).
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
    if best < max(before, after) or not bend:  # beyond those that are tried
        return usual
    return float(cycles[k] * (PITCHES[1] / PITCHES[0]) ** (0.5 * (before - after) / bend))


def dropping_recorder(shares: Sequence[float | None]) -> str | None:
    """What the lost shares of several messages say of who recorded them; None: nothing."""
    known = [share for share in shares if share is not None]
    if len(known) < 2 or min(known) < DROPPING_SHARE:
        return None
    low, high = (f"{100.0 * share:.0f}" for share in (min(known), max(known)))
    part = low if low == high else f"{low} to {high}"
    return f"{part} % of the frames of each message are lost: the recorder seems to drop frames"
