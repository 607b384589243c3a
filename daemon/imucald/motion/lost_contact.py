"""Does an axis jump to a value, stay on exactly that one, and jump back? A loose contact does.

It is shorter than what counts as stuck. A run of equal values that noise never makes may also come
from a sender that repeats a value because the next one is late; that value is one of the road's,
so that nothing jumps to it and away from it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.motion.hops import HopRows
from imucald.motion.rail_evidence import AxisHops
from imucald.motion.sensor_judges import Runs

Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]

JUMP = 5.0
"""A jump is so many times the axis's mean change, where it changes at all (an axis that is coarser
than its noise seldom does, by its step): four deviations of normal changes. At both ends of the
same repeated value that is a chance of 4e-9, of some 1e5 late values in 100 h."""
MIN_RUN = 3
"""Shorter runs are not looked at: noise makes them."""


class LostContact:
    """Watches one axis, hop by hop."""

    def __init__(self) -> None:
        self._open = 0  # samples of the run at the end of the last hop
        self._entry = 0.0  # the change with which it began
        self._change = 0.0
        self._changes = 0

    def restart(self) -> None:
        """Time jumped."""
        self._open, self._entry = 0, 0.0

    def step(
        self, at: AxisHops, h: int, axis: int, counts: tuple[int, int, int, int], usual: Runs
    ) -> tuple[bool, bool]:
        """Take hop h of an axis.

        counts: its count, ended, longest and run, as `HopRows` has them. usual: the runs of equal
        values of this axis so far. Returns whether a value between two jumps that lasted longer
        than those ended in it, and whether its longest run is none to learn from.
        """
        count, ended, longest, run = counts
        found = jumped = False
        if longest >= MIN_RUN and longest > usual.longest:
            lasted = self._between_jumps(at.rows, h, axis)
            jumped = longest == lasted
            found = lasted > usual.limit()
        if not jumped:
            self._change += at.level[h] * count
            self._changes += ended
        if run <= count:  # it began in this hop
            self._entry = at.entry[h]
        self._open = run
        return found, jumped

    def step_through(self, at: AxisHops, some: Flags, counts: Sequence[Counts]) -> None:
        """Take the hops (H,) that have samples, where none has a run longer than usual.

        counts: of each hop (H,) as `step` takes them.
        """
        count, ended, _, run = (x[some] for x in counts)
        change = np.array(at.level)[some] * count
        self._change = float(np.add.accumulate(np.append(self._change, change))[-1])
        self._changes += int(ended.sum())
        began = np.flatnonzero(run <= count)
        if len(began):
            self._entry = at.entry[int(np.flatnonzero(some)[began[-1]])]
        self._open = int(run[-1])

    def _between_jumps(self, rows: HopRows, h: int, axis: int) -> int:
        """The longest run between two jumps that ended in the hop [samples]."""
        first, last = int(rows.edges[h]), int(rows.edges[h + 1])
        values = rows.samples[axis, first:last]
        change = np.abs(np.diff(values, prepend=rows.previous(first)[axis]))
        new = np.flatnonzero(change)
        lasted = np.diff(new, prepend=-self._open)
        size: NDArray[np.float64] = change[new]
        entry = np.append(self._entry, size[:-1])
        jump = JUMP * self._change / max(self._changes, 1)
        return int(lasted[(entry > jump) & (size > jump)].max(initial=0))
