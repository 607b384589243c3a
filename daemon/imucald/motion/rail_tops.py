"""Values that nothing has gone beyond since they came: of one side of an axis, from high to low.

Samples on a value, and one and two steps below it, show whether it is the end of a range. Both
ways to keep them do the same: a list, one hop at a time, and an array, in which the compiled part
takes all hops in a row that need no more (`core/kernels/rails.c`).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.compiled import Kernels
from imucald.motion.hops import SIDES
from imucald.motion.rail_evidence import AxisHops, Pile

Index = NDArray[np.int64]
Flags = NDArray[np.bool_]
Hops = Sequence[int] | Index
Moves = Sequence[bool] | Flags

LONG_STAY = 4
"""Fewer samples on a value that is reached for the first time say nothing."""
TAIL_HOPS = 120
"""The tail of an axis is that of the largest values of so many hops of driving (a minute)."""
REMEMBERED = 64
"""Values that nothing has gone beyond since; they fall, so there are few of them."""


class Top(Struct):
    """A value that nothing has gone beyond since hop `born`.

    on: samples on it, one_below, two_below: as many steps below, as far as they are tops of their
    hops.
    """

    value: float
    born: int
    on: int
    one_below: int
    two_below: int


class TopList:
    """The tops of a side. piles: of those values whose samples are counted."""

    def __init__(self) -> None:
        self._tops: list[Top] = []
        self.recent: deque[float] = deque(maxlen=TAIL_HOPS)
        """Tops of the last hops of driving."""
        self.piles: dict[float, Pile] = {}

    @property
    def newest(self) -> float:
        """Top of the last hop of driving."""
        return self.recent[-1]

    @property
    def last(self) -> Top | None:
        """The lowest; None before any."""
        return self._tops[-1] if self._tops else None

    def drop_below(self, value: float) -> None:
        """Let go what lies below a value that was reached."""
        tops = self._tops
        while tops and tops[-1].value < value:
            self.piles.pop(tops[-1].value, None)
            del tops[-1]

    def below(self, value: float) -> tuple[int, int]:
        """Samples one and two steps below a top."""
        top = next(one for one in self._tops if one.value == value)
        return top.one_below, top.two_below

    def add_pile(self, top: Top, pile: Pile) -> None:
        """Begin to count the samples of the lowest."""
        self.piles[top.value] = pile

    def reached(self, value: float, on: int, step: float, hop: int) -> Top | None:
        """Take a value as the latest top; those that it goes beyond are no longer watched.

        on: samples of the hop on it. Returns the top where its samples have to be weighed: they
        stay long, or it was reached before.
        """
        tops, one_below, two_below = self._tops, 0, 0
        two_steps = 2.5 * step
        while tops:
            last = tops[-1]
            lower = value - last.value
            if lower <= 0.0:
                break
            del tops[-1]
            if self.piles:
                self.piles.pop(last.value, None)
            if lower < two_steps:
                if lower < 1.5 * step:
                    one_below += last.on
                    two_below += last.one_below
                else:
                    two_below += last.on
        else:
            lower = -math.inf
        if lower == 0.0:
            last.on += on  # those below it were added when they came
            return last
        if -lower < two_steps:
            if -lower < 1.5 * step:
                last.one_below += on
            else:
                last.two_below += on
        if len(tops) == REMEMBERED:
            k = next((k for k, one in enumerate(tops) if one.value not in self.piles), 0)
            self.piles.pop(tops[k].value, None)
            del tops[k]
        new = Top(value, hop, on, one_below, two_below)
        tops.append(new)
        return new if on >= LONG_STAY else None


class TopRows:
    """The same in rows of an array (`REMEMBERED` + 1, 6), of which depth (1,) are used.

    recent: (`TAIL_HOPS`,) tops of the last of so many hops (1,) of driving, in turn.
    """

    def __init__(self, rows: Array, depth: Index, recent: Array, hops: Index) -> None:
        self._rows, self._depth = rows, depth
        self._recent, self._hops = recent, hops
        self.piles: dict[float, Pile] = {}

    @property
    def recent(self) -> Sequence[float]:
        """Tops of the last hops of driving."""
        hops = int(self._hops[0])
        ring: list[float] = self._recent.tolist()
        at = hops % TAIL_HOPS
        return ring[:hops] if hops < TAIL_HOPS else ring[at:] + ring[:at]

    @property
    def newest(self) -> float:
        """Top of the last hop of driving."""
        return self._recent.item((int(self._hops[0]) - 1) % TAIL_HOPS)

    def _top(self, k: int) -> Top:
        value, born, on, one_below, two_below, _ = self._rows[k].tolist()
        return Top(value, int(born), int(on), int(one_below), int(two_below))

    @property
    def last(self) -> Top | None:
        """The lowest; None before any."""
        depth = int(self._depth[0])
        return self._top(depth - 1) if depth else None

    def drop_below(self, value: float) -> None:
        """Let go what lies below a value that was reached."""
        depth = int(self._depth[0])
        while depth and self._rows[depth - 1, 0] < value:
            depth -= 1
        self._depth[0] = depth
        self.forget_below(value)

    def forget_below(self, value: float) -> None:
        """Count no longer what a value has gone beyond."""
        for one in [one for one in self.piles if one < value]:
            del self.piles[one]

    def below(self, value: float) -> tuple[int, int]:
        """Samples one and two steps below a top."""
        top = self._top(int(np.argmax(self._rows[: self._depth[0], 0] == value)))
        return top.one_below, top.two_below

    def add_pile(self, top: Top, pile: Pile) -> None:
        """Begin to count the samples of the lowest."""
        self.piles[top.value] = pile
        self._rows[self._depth[0] - 1, 5] = 1.0


class BothLists:
    """The tops of both sides of an axis.

    usual: mean change from sample to sample while driving. hops: of driving.
    """

    def __init__(self) -> None:
        self.sides = [TopList() for _ in range(SIDES)]
        self.usual, self.hops = 0.0, 0

    @staticmethod
    def prepared(hops: Sequence[int], moving: Flags) -> tuple[Sequence[int], Sequence[bool]]:
        """Hops, and whether the vehicle moves in each of all, as `take` has them quickest."""
        return hops, moving.tolist()

    def take(
        self, at: AxisHops, hops: Hops, begin: int, moving: Moves
    ) -> tuple[int, list[Top | None]]:
        """Take hops from place `begin` on, up to one whose tops have to be weighed.

        moving: of all hops. Returns its place and, by side, which; or the place of the first hop
        that was not taken.
        """
        high, low = self.sides
        level, steps, (highest, lowest), (on_high, on_low) = at.level, at.step, at.tops, at.on_tops
        for k in range(begin, len(hops)):
            h = hops[k]
            value, other = highest[h], lowest[h]
            if not moving[h]:
                high.drop_below(value)
                low.drop_below(other)
                continue
            hop = self.hops
            self.hops += 1
            self.usual += (level[h] - self.usual) / (hop + 1 if hop < TAIL_HOPS else TAIL_HOPS)
            high.recent.append(value)
            low.recent.append(other)
            top = high.reached(value, on_high[h], steps[h], hop)
            bottom = low.reached(other, on_low[h], steps[h], hop)
            if top is not None or bottom is not None:
                return k, [top, bottom]
        return len(hops), [None, None]


class BothRows:
    """The same for the compiled part."""

    def __init__(self, kernels: Kernels) -> None:
        self._kernels = kernels
        self._rows = np.zeros((SIDES, REMEMBERED + 1, 6))
        self._depth = np.zeros(SIDES, np.int64)
        self._usual, self._hops = np.zeros(1), np.zeros(1, np.int64)
        self._recent = np.zeros((SIDES, TAIL_HOPS))
        self._found = np.empty(3 * SIDES)
        self.sides = [
            TopRows(self._rows[k], self._depth[k : k + 1], self._recent[k], self._hops)
            for k in range(SIDES)
        ]

    @property
    def usual(self) -> float:
        """See `BothLists`."""
        return self._usual.item(0)

    @property
    def hops(self) -> int:
        """See `BothLists`."""
        return self._hops.item(0)

    @staticmethod
    def prepared(hops: Sequence[int], moving: Flags) -> tuple[Index, Flags]:
        """See `BothLists`."""
        return np.array(hops, np.int64), moving

    def take(
        self, at: AxisHops, hops: Hops, begin: int, moving: Moves
    ) -> tuple[int, list[Top | None]]:
        """See `BothLists`."""
        stopped = self._kernels.rail_hops(
            np.asarray(hops, np.int64), begin, np.asarray(moving, np.bool_), *at.in_rows,
            self._rows, self._depth, self._usual, self._hops, self._recent, self._found,
        )  # fmt: skip
        high, low, *largest = self._found.tolist()
        reached: list[Top | None] = []
        for side, is_reached, value, dropped in zip(
            self.sides, (high, low), largest[:2], largest[2:], strict=True
        ):
            if side.piles:
                side.forget_below(value)
                side.piles.pop(dropped, None)
            reached.append(side.last if is_reached else None)
        return stopped, reached
