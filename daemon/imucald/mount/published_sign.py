"""Sign of the target angle without speed: brake switch, turns, first motion after standstill.

Each piece of evidence is a vote: a horizontal vector in sensor axes that points forward, roughly.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

Vector = tuple[float, float, float]

VOTES_KEPT = 60
VOTE_WEIGHTS = {"brake": 1.0, "turn": 1.0, "first_motion": 1.0}
VOTES_NEEDED = 3.0
"""Votes by which one direction must lead: a single pull-off may have been in reverse."""
AGREEMENT = 0.7
"""Part of all votes that must agree."""
ALIGNED = 0.7
"""A vote must lie within 45 deg of the axis; others tell nothing."""


class SignVotes:
    """Collects votes and says which way along an axis is forward."""

    def __init__(self) -> None:
        self._votes: deque[tuple[Vector, str]] = deque(maxlen=VOTES_KEPT)
        self.counts: dict[str, int] = {}

    def add(self, source: str, forward: Sequence[float]) -> None:
        """Take a vote: a vector (3,) in sensor axes that should point forward."""
        x, y, z = forward
        norm = math.sqrt(x * x + y * y + z * z)
        if norm > 0.0:
            self._votes.append(((x / norm, y / norm, z / norm), source))
            self.counts[source] = self.counts.get(source, 0) + 1

    def sign(self, axis: Vector) -> float:
        """Return +1 when the axis (3,) points forward, -1 when it points back, 0 when unsure."""
        ahead = back = 0.0
        for (x, y, z), source in self._votes:
            along = x * axis[0] + y * axis[1] + z * axis[2]
            if along > ALIGNED:
                ahead += VOTE_WEIGHTS[source]
            elif along < -ALIGNED:
                back += VOTE_WEIGHTS[source]
        most = max(ahead, back)
        if abs(ahead - back) < VOTES_NEEDED or most < AGREEMENT * (ahead + back):
            return 0.0
        return 1.0 if ahead > back else -1.0
