"""The figures of one hop from single samples: the live daemon's half of `hops`, to the last bit.

A hop holds some tens of samples: counted one by one they take a quarter of what columns take.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucald.motion.hops import Carry, HopRows

Sample = Sequence[float]


def single_hop(values: Sequence[Sample], carry: Carry) -> HopRows:
    """Return the figures of a hop, and bring `carry` up to its end.

    values: its samples, at least one, each of as many axes as `carry` has, or more.
    """
    n, before = len(carry.last), carry.last
    columns = [[one[i] for one in values] for i in range(n)]
    lasts = zip(before.tolist(), carry.run.tolist(), carry.step.tolist(), strict=True)
    counted = [_counted(column, *last) for column, last in zip(columns, lasts, strict=True)]
    totals, levels, steps, ended, longest, runs = zip(*counted, strict=True)
    high, low = [max(column) for column in columns], [min(column) for column in columns]
    on_top = [
        [column.count(x) for column, x in zip(columns, ends, strict=True)] for ends in (high, low)
    ]
    samples = np.array(columns)
    carry.last = samples[:, -1].copy()
    carry.run, carry.step = np.array(runs), np.array(steps)
    count = len(values)
    return HopRows(
        count=np.array([count]),
        mean=np.array([[total / count for total in totals]]),
        level=np.array([[level / count for level in levels]]),
        step=np.array([steps]),
        ended=np.array([ended]),
        longest=np.array([longest]),
        run=np.array([runs]),
        top=np.array([[high, [-x for x in low]]]),
        on_top=np.array([on_top]),
        samples=samples,
        edges=np.array([0, count]),
        before=before,
    )


def _counted(
    column: list[float], last: float, run: int, step: float
) -> tuple[float, float, float, int, int, int]:
    """Sum, sum of changes, smallest change so far, runs that ended, longest of them, open run.

    last, run, step: of the axis, as in `Carry`.
    """
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
        longest = max(longest, run)
        run, last = 1, x
    return total, level, step, ended, longest, run
