"""Estimate the share of lost frames of a cyclic message from the times of the received frames.

The estimate also works with coarse time stamps. `diagnosis.direct.faults` uses the same cycle to
find which frames are missing and the error of the sender's clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imucald.can.dbc.message import Message
from imucald.core.arrays import Array

MOST_CYCLES, MOST_S = 20, 2.0
"""If an interval is longer than both limits (cycles, seconds), the sender was off, and no frames
count as lost. A recorder that is too slow leaves gaps of some tenths of a second."""
TOGETHER, FIRST = 128, 32
"""Number of frames with a common phase, and the number of these that choose the cycles for a closer
look. A sender's clock does not drift by a part of a cycle in so few frames."""
FEWEST = 8
"""Smallest number of intervals that show a cycle."""
CYCLES = np.exp(np.arange(-0.7, 0.012, 0.1 / FIRST))[:, None, None]
"""Tried cycles (C, 1, 1), divided by the mean interval. With lost frames, the cycle is shorter than
the mean interval. If more than half of the frames are lost, the cycle is not known. The step is a
fraction of the resolution of `FIRST` frames."""
NEAR, NEAR_SHARE = 0.25, 0.75
"""A message is cyclic if the share NEAR_SHARE of its frames comes at most NEAR cycles early or
late. For frames at random times, this share is 0.5."""


class Cycle(NamedTuple):
    """The cycle of a message.

    seconds: its length [s]. loses: True if frames are lost, so the numbers of the frames are not
    the numbers of the rows. steps: (M,) number of cycles from frame to frame, at least 1, within
    groups of `TOGETHER` frames.
    """

    seconds: float
    loses: bool
    steps: Array


def lost_share(intervals: Array, message: Message | None = None) -> float | None:
    """Return the share of lost frames; intervals: (N,) between the received frames [s].

    message: its description, if a database has one. Returns None for a message that is not cyclic,
    and for a message with a multiplexer, because each group has its own cycle.
    """
    if message is not None and message.is_multiplexed:
        return None
    usual = float(np.median(intervals)) if len(intervals) else 0.0
    cycle = cycle_of(intervals[intervals < max(MOST_CYCLES * usual, MOST_S)])
    return None if cycle is None else 1.0 - len(cycle.steps) / float(cycle.steps.sum())


def cycle_of(intervals: Array) -> Cycle | None:
    """Return the cycle of frames with intervals (N,) [s]; None for frames without a cycle.

    Each cycle predicts the time of a frame from its number. The best cycle has the shortest
    description of the times: the logarithms of the errors, plus the information in the numbers if
    frames are lost at random. The row numbers describe the times without lost frames. The step
    of coarse time stamps also predicts them, but then many frames seem to be lost.
    """
    if len(intervals) < FEWEST or intervals.max() <= 0.0:
        return None
    count = min(len(intervals), TOGETHER)
    rows = len(intervals) // count
    t = np.cumsum(intervals[: rows * count].reshape(rows, count), axis=1)
    # groups of frames for which all cycles are tried, spread over the recording
    few = t[:: -(-rows // 8)]
    # A time stamp of a coarse clock is late by half a step on average.
    # a frame on a bus is longer than 10 us
    late = max(0.5 * _resolution(intervals), 1e-5)
    tried = float(intervals.mean()) * CYCLES
    first = few[:, :FIRST]
    lengths = _length(first, _numbers(first, tried), tried, late)
    closer = np.exp(np.arange(-0.1 / FIRST, 0.1 / FIRST, 0.1 / TOGETHER))
    tried = (tried[np.argsort(lengths)[:5]] * closer).reshape(-1, 1, 1)
    best = float(tried[np.argmin(_length(few, _numbers(few, tried), tried, late))].item())
    for _ in range(2):
        best = _slope(t, _numbers(t, best))
    found = [(_numbers(t, best), best)]
    by_rows = np.broadcast_to(np.arange(float(count)), t.shape)
    found.append((by_rows, _slope(t, by_rows)))
    numbers, cycle = min(found, key=lambda x: float(_length(t, x[0], x[1], late)))
    if cycle <= 0.0 or np.mean(np.abs(_errors(t, numbers, cycle)) < NEAR * cycle) < NEAR_SHARE:
        return None
    steps = np.diff(numbers, axis=1).ravel()
    return Cycle(cycle, bool(steps.max() > 1.0), steps)


def _resolution(intervals: Array) -> float:
    seen = np.unique(np.round(np.append(intervals, 0.0), 6))
    return float(np.diff(seen).min())


def _numbers(t: Array, cycle: float | Array) -> Array:
    """Return the numbers of frames at times t (R, N) [s], by the common phase of each row. cycle:
    one cycle [s], or (C, 1, 1) for numbers (C, R, N).

    Each frame has a larger number than the frame before. If a time stamp contradicts this, it was
    either late, or the time stamps before it were early; the smaller error is chosen in each row.
    """
    rows = np.arange(t.shape[-1])
    turns = t / cycle
    phase = np.angle(np.exp(2j * np.pi * turns).sum(axis=-1, keepdims=True)) / (2.0 * np.pi)
    lost = np.round(turns - phase) - rows
    early = np.maximum.accumulate(lost, axis=-1)
    late = np.minimum.accumulate(lost[..., ::-1], axis=-1)[..., ::-1]
    errors = (np.abs(_centred(turns - rows - x)).sum(axis=-1) for x in (early, late))
    is_late = np.greater(*errors)[..., None]
    return np.asarray(rows + np.where(is_late, late, early))


def _centred(x: Array) -> Array:
    return np.asarray(x - x.mean(axis=-1, keepdims=True))


def _errors(t: Array, numbers: Array, cycle: float | Array) -> Array:
    return _centred(t - cycle * numbers)


def _slope(t: Array, numbers: Array) -> float:
    centred = _centred(numbers)
    return float((_centred(t) * centred).sum() / (centred**2).sum())


def _length(t: Array, numbers: Array, cycle: float | Array, late: float) -> Array:
    """Return the length of the description [nats per frame], of each cycle. late: accuracy of a
    time stamp [s]."""
    sent = (numbers[..., -1] - numbers[..., 0]).sum(axis=-1)
    received = t[:, 1:].size / sent
    lost = np.maximum(1.0 - received, 1e-12)
    of_numbers = -np.log(received) - lost / received * np.log(lost)
    errors = np.log(np.abs(_errors(t, numbers, cycle)) + late)
    return np.asarray(errors.mean(axis=(-2, -1)) + of_numbers)


def dropping_recorder(shares: Sequence[float | None]) -> str | None:
    """Return a text if the lost shares of several messages show a faulty recorder, else None."""
    known = [share for share in shares if share is not None]
    # if every message loses 2 %, the cause is not a single sender
    if len(known) < 2 or min(known) < 0.02:
        return None
    low, high = (f"{100.0 * share:.0f}" for share in (min(known), max(known)))
    part = low if low == high else f"{low} to {high}"
    return f"{part} % of the frames of each message are lost: the recorder seems to drop frames"
