"""How often an input may come, and whether one sender sends it.

Counted in whole seconds of stream time, so that a burst after a stall harms nobody and single
frames and columns give the same. What is usual is learnt from the first seconds; a cycle that is
stated counts where it is faster. Nothing is refused before that is known.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from imucald.can.e2e.protection import DOUBLED, TOO_EARLY

TOO_FAST, DUPLICATE = "too_fast", "duplicate_sender"
LEARNT_S = 10
"""Seconds with frames from which the usual rate is taken."""
TIMES_USUAL = 2.5
"""At most one frame in 0.4 cycles, on average over a second."""
LEAST_STATED, LEAST_LEARNT = 20, 250
"""So many a second are always let through: senders of a stated cycle send changes in between, and
one of no stated cycle may wake up; 250 a second are no load."""
TWO_SENDERS = 1.6
"""Three seconds with so many times the usual rate are two senders: no clock is that wrong."""
SECONDS = 3
NO_LIMIT = 1e9
FAULTY_COUNTERS = 0.05
"""And two counters interleave: a fault in seventeen frames where the other sends sixteen."""
HELD_S = 2
"""A sender is trusted again so many seconds after the other fell silent."""
_NOT_SENT = frozenset(("checksum", "short_frame", DOUBLED))
"""Frames that nobody knows to be of a sender, and copies that none has sent."""

Rows = NDArray[np.int64]


def _is_of_another(reason: str) -> bool:
    """Whether a second sender's frames are rejected so."""
    return reason.startswith("counter") or reason == TOO_EARLY


class JudgesRate(Protocol):
    """What a route asks of how often its frames come, see `RateGuard`."""

    def judge(self, t: float, reason: str) -> str:
        """Of one frame."""
        ...

    def judge_columns(
        self, t: NDArray[np.float64], good: NDArray[np.bool_], reasons: Mapping[str, Rows]
    ) -> dict[str, Rows]:
        """Of many."""
        ...


class RateGuard:
    """Watches the frames of one route.

    stated: its cycle [s], or None. counted: it has a counter.
    """

    def __init__(self, stated: float | None = None, counted: bool = False) -> None:
        self._stated = 0.0 if stated is None else 1.0 / stated
        self._counted = counted
        self._learnt: list[int] = []
        self._usual = math.inf
        self._second, self._ends = -1, 0.0
        self._allowed = 0
        self._seen = self._faults = self._taken = 0
        self._before: deque[tuple[int, int]] = deque([(0, 0)] * SECONDS, SECONDS)
        self._distrusted_until = -1

    def judge(self, t: float, reason: str) -> str:
        """Why a frame at stream time t [s] is rejected; reason: what its route says, "" if good."""
        if t >= self._ends:
            self._enter(int(t))
        if reason:
            if reason not in _NOT_SENT:
                self._seen += 1
                self._faults += _is_of_another(reason)
            return reason
        self._seen += 1
        if self._second <= self._distrusted_until:
            return DUPLICATE
        self._taken += 1
        return TOO_FAST if self._taken > self._allowed else ""

    def judge_columns(
        self, t: NDArray[np.float64], good: NDArray[np.bool_], reasons: Mapping[str, Rows]
    ) -> dict[str, Rows]:
        """The same of many frames: rows among the good ones (N,) that are rejected, by reason."""
        if not len(t):
            return {}
        first = math.floor(t[0])
        n = math.floor(t[-1]) - first + 1
        edges = t.searchsorted(np.arange(first, first + n + 1))  # of seconds: times never decrease
        before = edges if good.all() else np.append(0, np.cumsum(good))[edges]
        good_count = seen_count = np.diff(before)
        fault_count = np.zeros(n, np.int64)
        for reason, rows in reasons.items():
            count = np.diff(rows.searchsorted(edges))
            if reason not in _NOT_SENT:
                seen_count = seen_count + count
            if _is_of_another(reason):
                fault_count += count
        seen, faulty, sound_in = seen_count.tolist(), fault_count.tolist(), good_count.tolist()
        if n > SECONDS + 1 and self._is_usual(first, seen):  # only the last ones count from now on
            self._before.extend(zip(seen[:-1], faulty[:-1], strict=True))
            self._second, self._ends = first + n - 1, first + float(n)
            self._seen, self._faults, self._taken = seen[-1], faulty[-1], sound_in[-1]
            self._allowed = math.floor(self._limit())
            return {}
        refused: dict[str, list[Rows]] = {}
        begins = edges.tolist()
        for i in range(n):
            frames, faults, sound = seen[i], faulty[i], sound_in[i]
            of = slice(begins[i], begins[i + 1])
            if of.start == of.stop:
                continue  # no frame, damaged ones too
            self._enter(first + i)
            self._seen += frames
            self._faults += faults
            if self._second <= self._distrusted_until:
                refused.setdefault(DUPLICATE, []).append(of.start + np.flatnonzero(good[of]))
                continue
            room = max(0, self._allowed - self._taken)
            self._taken += sound
            if sound > room:
                rows = of.start + np.flatnonzero(good[of])[room:]
                refused.setdefault(TOO_FAST, []).append(rows)
        return {reason: np.concatenate(rows) for reason, rows in refused.items()}

    def _is_usual(self, first: int, seen: Sequence[int]) -> bool:
        """Whether nothing can be refused in these seconds: all have few frames, as those before."""
        open_second = self._seen + (seen[0] if first == self._second else 0)
        most = max(*seen, open_second, *(before for before, _ in self._before))
        return most <= TWO_SENDERS * self._usual < math.inf and first > self._distrusted_until

    def _limit(self) -> float:
        if math.isinf(self._usual):
            return NO_LIMIT
        least = LEAST_STATED if self._stated else LEAST_LEARNT
        held_back = SECONDS * self._usual - sum(seen for seen, _ in self._before)
        return max(TIMES_USUAL * self._usual, least) + max(0.0, math.floor(held_back))

    def _enter(self, second: int) -> None:
        """Close the seconds before this one."""
        if second <= self._second:
            return
        if self._second >= 0:
            self._close()
        self._ends = second + 1.0
        for _ in range(min(second - self._second - 1, SECONDS)):
            self._before.append((0, 0))
        self._second = second
        self._seen = self._faults = self._taken = 0
        if self._is_duplicate():
            self._distrusted_until = second + HELD_S - 1
        self._allowed = math.floor(self._limit())

    def _close(self) -> None:
        self._before.append((self._seen, self._faults))
        if self._seen and len(self._learnt) < LEARNT_S:
            self._learnt.append(self._seen)
            if len(self._learnt) == LEARNT_S:
                self._usual = max(self._stated, *self._learnt)

    def _is_duplicate(self) -> bool:
        frames = sum(seen for seen, _ in self._before)
        if not frames > TWO_SENDERS * SECONDS * self._usual:
            return False
        if not self._counted:
            return self._stated > 0.0
        return sum(faults for _, faults in self._before) >= FAULTY_COUNTERS * frames


class Spaced:
    """Lets one event in a cycle through, on average; cycle [s]. For frames *not available*."""

    EARLY = 0.6
    """So many cycles early is jitter."""

    def __init__(self, cycle: float) -> None:
        self.cycle = cycle
        self._next = -math.inf

    def passes(self, t: float) -> bool:
        """Whether an event at t [s] is let through; times never decrease."""
        if t < self._next - self.EARLY * self.cycle:
            return False
        self._next = max(self._next, t) + 0.95 * self.cycle
        return True

    def among(self, t: NDArray[np.float64]) -> NDArray[np.bool_]:
        """The same of many (N,)."""
        return np.array([self.passes(x) for x in t.tolist()], dtype=bool)


def guarded_cycle(cycles: Collection[float | None]) -> float:
    """Cycle [s] of frames that say *not available*: the fastest that is stated, else 10 ms."""
    stated = [cycle for cycle in cycles if cycle]
    return min(stated) if stated else 0.01
