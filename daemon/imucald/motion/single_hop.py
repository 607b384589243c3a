"""The figures of one hop from single samples: the live daemon's half of `hops`, to the last bit.

A hop holds some tens of samples: counted one by one they take a quarter of what columns take.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucald.motion.hops import WINDOW_HOPS, Carry, HopRows

Sample = Sequence[float]
_END = -math.inf


class _AxisHop:
    """One axis of a hop; fields as those of `HopRows`."""

    __slots__ = ("ended", "last", "level", "longest", "mean", "run", "step")

    def __init__(
        self, column: list[float], last: float, run: int, step: float, high: float, low: float
    ) -> None:
        """last, run, step: as in `Carry`. high, low: extremes, as in `HopRows`."""
        total = level = 0.0
        ended = longest = 0
        for x in column:
            total += x
            if x == last:
                run += 1
                continue
            change = abs(x - last)
            if change > 0.0:  # NaN before the first of all
                level += change
                step = min(step, change)
            ended += 1
            if run > longest and not (last >= high or -last >= low):
                longest = run
            run, last = 1, x
        self.mean, self.level = total / len(column), level / len(column)
        self.last, self.run, self.step = last, run, step
        self.ended, self.longest = ended, longest


def single_hop(values: Sequence[Sample], moving: bool, carry: Carry) -> HopRows:
    """Return the figures of a hop, and bring `carry` up to its end.

    values: its samples, at least one, each of as many axes as `carry` has, or more.
    """
    n, before = len(carry.last), carry.last.tolist()
    columns = [[one[i] for one in values] for i in range(n)]
    top = [[max(c) for c in columns], [-min(c) for c in columns]]
    extreme: list[list[float]] = carry.extreme.tolist()
    if moving:
        extreme = [list(map(max, *sides)) for sides in zip(extreme, top, strict=True)]
    runs, steps = carry.run.tolist(), carry.step.tolist()
    axes = [
        _AxisHop(columns[i], before[i], runs[i], steps[i], extreme[0][i], extreme[1][i])
        for i in range(n)
    ]
    at_it = np.zeros((1, 2, n), np.int64)
    ties, below = at_it.copy(), np.zeros((1, 2, 2, n), np.int64)
    for side in range(2 if moving else 0):
        for i, axis in enumerate(axes):
            limit, grain = extreme[side][i], axis.step
            if top[side][i] < limit - (2.5 * grain if grain < math.inf else 0.0):
                continue
            sign = -1.0 if side else 1.0
            for k, x in enumerate(columns[i]):
                under = limit - sign * x
                if under == 0.0:
                    at_it[0, side, i] += 1
                    former = values[k - 1] if k else before
                    ties[0, side, i] += x == former[i] and any(
                        values[k][j] != former[j] for j in range(n)
                    )
                elif under < 2.5 * grain:
                    below[0, int(under >= 1.5 * grain), side, i] += 1
    window = carry.moved // WINDOW_HOPS
    carry.last = np.array([axis.last for axis in axes])
    carry.run = np.array([axis.run for axis in axes])
    carry.step = np.array([axis.step for axis in axes])
    carry.moved += moving
    fresh = carry.moved // WINDOW_HOPS > window
    carry.extreme = np.full((2, n), _END) if fresh else np.array(extreme)
    return HopRows(
        count=np.array([len(values)]),
        mean=np.array([[axis.mean for axis in axes]]),
        level=np.array([[axis.level for axis in axes]]),
        step=carry.step[None],
        ended=np.array([[axis.ended for axis in axes]]),
        longest=np.array([[axis.longest for axis in axes]]),
        run=carry.run[None],
        top=np.array([top]),
        extreme=np.array([extreme]),
        at_it=at_it,
        ties=ties,
        below=below,
        window=np.array([window]),
    )
