"""Limit the rate of an input, and detect a second sender.

Frames are counted in whole seconds of stream time. Therefore a burst after a stall is accepted, and
single frames and columns give the same result. The usual rate is learnt from the first seconds. If
a stated cycle gives a higher rate, this rate is used instead. No frame is refused before the usual
rate is known.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.can.e2e.protection import DOUBLED, TOO_EARLY
from imucald.can.e2e.schedule import HELD_S

TOO_FAST, DUPLICATE = "too_fast", "duplicate_sender"
LEARNT_S = 10
"""Number of seconds with frames from which the usual rate is learnt."""
TIMES_USUAL = 2.5
"""Largest rate relative to the usual rate: one frame per 0.4 cycles, averaged over a second."""
LEAST_STATED, LEAST_LEARNT = 20, 250
"""Rates [1/s] that are always accepted: LEAST_STATED with a stated cycle, LEAST_LEARNT with a
learnt cycle. A sender with a stated cycle may send additional frames when values change. A sender
without a stated cycle may begin to send faster later. 250 frames per second cause little load."""
TWO_SENDERS = 1.6
"""If the rate is this multiple of the usual rate for three seconds, there are two senders. No clock
of a sender is wrong by this factor."""
SECONDS = 3
FAULTY_COUNTERS = 0.05
"""Smallest share of counter faults that also shows two senders, because their counters interleave.
If the other sender sends sixteen frames for each of ours, one frame in seventeen has a fault."""
_NOT_SENT = frozenset(("checksum", "short_frame", DOUBLED))
"""Reasons of rejection that do not show a second sender: damaged frames (their sender is unknown),
and copies."""

Rows = NDArray[np.int64]


def _is_of_another(reason: str) -> bool:
    """True if this reason of rejection can come from a second sender."""
    return reason.startswith("counter") or reason == TOO_EARLY


class RateGuard:
    """Checks the rate of the frames of one route.

    stated: stated cycle of the route [s], or None. counted: whether the route has a counter.
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
        """Return the reason why a frame at stream time t [s] is rejected, or "". reason: the reason
        of the route's own check, "" if the frame is good."""
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
        """Do the work of `judge` for columns. Return the rejected rows of the good frames (N,), by
        reason."""
        if not len(t):
            return {}
        first = math.floor(t[0])
        n = math.floor(t[-1]) - first + 1
        second = np.floor(t).astype(np.int64) - first
        is_seen, is_fault = np.ones(len(t), dtype=bool), np.zeros(len(t), dtype=bool)
        for reason, rows in reasons.items():
            is_seen[rows], is_fault[rows] = reason not in _NOT_SENT, _is_of_another(reason)
        seen = np.bincount(second[is_seen], minlength=n).tolist()
        if n > SECONDS + 1 and self._is_usual(first, seen):  # only the last seconds count later
            faulty = np.bincount(second[is_fault], minlength=n).tolist()
            self._before.extend(zip(seen[:-1], faulty[:-1], strict=True))
            self._second, self._ends = first + n - 1, first + float(n)
            self._seen, self._faults = seen[-1], faulty[-1]
            self._taken = int(np.count_nonzero(good & (second == n - 1)))
            self._allowed = math.floor(self._limit())
            return {}
        refused: dict[str, list[int]] = {}
        listed = [""] * len(t)
        for reason, rows in reasons.items():
            for row in rows.tolist():
                listed[row] = reason
        for row, (at, reason) in enumerate(zip(t.tolist(), listed, strict=True)):
            found = self.judge(at, reason)
            if found != reason:
                refused.setdefault(found, []).append(row)
        return {reason: np.array(rows, np.int64) for reason, rows in refused.items()}

    def _is_usual(self, first: int, seen: Sequence[int]) -> bool:
        """True if no frame can be refused in these seconds, because each second has few frames."""
        open_second = self._seen + (seen[0] if first == self._second else 0)
        most = max(*seen, open_second, *(before for before, _ in self._before))
        return most <= TWO_SENDERS * self._usual < math.inf and first > self._distrusted_until

    def _limit(self) -> float:
        if math.isinf(self._usual):
            return 1e9
        least = LEAST_STATED if self._stated else LEAST_LEARNT
        held_back = SECONDS * self._usual - sum(seen for seen, _ in self._before)
        return max(TIMES_USUAL * self._usual, least) + max(0.0, math.floor(held_back))

    def _enter(self, second: int) -> None:
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
            self._distrusted_until = second + int(HELD_S) - 1
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
    """Accepts one event per cycle [s] on average. `Spaced` is used for *not available* frames."""

    EARLY = 0.6
    """An event may be early by this share of a cycle, because of jitter."""

    def __init__(self, cycle: float) -> None:
        self.cycle = cycle
        self._next = -math.inf

    def passes(self, t: float) -> bool:
        """True if an event at t [s] is accepted. Times must not decrease."""
        if t < self._next - self.EARLY * self.cycle:
            return False
        self._next = max(self._next, t) + 0.95 * self.cycle
        return True

    def among(self, t: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Do the work of `passes` for many events (N,)."""
        return np.array([self.passes(x) for x in t.tolist()], dtype=bool)


def guarded_cycle(cycles: Collection[float | None]) -> float:
    """Return the cycle [s] of *not available* frames: the fastest stated cycle, else 10 ms."""
    stated = [cycle for cycle in cycles if cycle]
    return min(stated) if stated else 0.01
