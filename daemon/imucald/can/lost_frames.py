"""How many frames of a cyclic message did not come, by the times of those that came."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.message import Message

REGULAR, REGULAR_SHARE = 0.4, 0.6
"""A message whose intervals are mostly its cycle, within such a part of it, is sent in cycles."""
MOST_CYCLES, MOST_S = 20, 2.0
"""An interval that is longer than both [s] is a sender that was off, not lost frames: a recorder
that does not keep up leaves holes of some tenths of a second, whatever the cycle."""
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
    steps = intervals[intervals < max(MOST_CYCLES * cycle, MOST_S)] / cycle
    if np.mean(np.abs(steps - 1.0) < REGULAR) < REGULAR_SHARE:
        return None
    return max(0.0, 1.0 - len(steps) / float(np.rint(steps).sum()))


def dropping_recorder(shares: Sequence[float | None]) -> str | None:
    """What the lost shares of several messages say of who recorded them; None: nothing."""
    known = [share for share in shares if share is not None]
    if len(known) < 2 or min(known) < DROPPING_SHARE:
        return None
    low, high = (f"{100.0 * share:.0f}" for share in (min(known), max(known)))
    part = low if low == high else f"{low} to {high}"
    return f"{part} % of the frames of each message are lost: the recorder seems to drop frames"
