"""Sign of the target angle without speed, from the brake switch, turns, and the first motion after
standstill.

Each of these events gives a vote: a horizontal vector in sensor axes that points roughly forward.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

from imucald.core.rotations import Vector
from imucald.motion.speed import SpeedInterval

VOTES_KEPT = 60
VOTES_NEEDED = 3
"""Lead in votes that one direction needs: a single start may have been in reverse."""
AGREEMENT = 0.7
"""Share of all votes that must agree."""
ALIGNED = 0.7
"""Smallest cosine of the angle between a vote and the axis (45 deg). Other votes are ignored."""
GATHER_S = 2.0
"""Time over which the force of a first motion or a braking is averaged [s]."""
FIRST_MOTION_WITHIN_S = 4.0
"""Time after the end of standstill within which a first motion must begin [s]."""
FIRST_MOTION_FORCE = 0.7
"""Smallest mean horizontal force of a first motion that counts [m/s^2]."""
BRAKE_FORCE = 0.6
"""Smallest mean horizontal force of a braking that counts [m/s^2]."""
TURN_RATE = math.radians(6.0)
"""Smallest yaw rate of a turn that distinguishes left from right [rad/s]."""
TURN_FORCE = 0.8
"""Smallest mean horizontal force of a turn that distinguishes left from right [m/s^2]."""
TURN_S = 1.5
"""Shortest duration of a turn that distinguishes left from right [s]."""


class SignVotes:
    """Collects votes and decides which direction along an axis is forward."""

    def __init__(self) -> None:
        self._votes: deque[Vector] = deque(maxlen=VOTES_KEPT)
        self.counts: dict[str, int] = {}

    def add_vote(self, source: str, forward: Sequence[float]) -> None:
        """Count a vote: a vector (3,) in sensor axes that should point forward. source: kind of
        event."""
        x, y, z = forward
        norm = math.sqrt(x * x + y * y + z * z)
        if norm > 0.0:
            self._votes.append((x / norm, y / norm, z / norm))
            self.counts[source] = self.counts.get(source, 0) + 1

    def count(self, axis: Vector) -> tuple[int, int]:
        """Return the number of votes along the axis (3,) and the number of votes against it."""
        along = [x * axis[0] + y * axis[1] + z * axis[2] for x, y, z in self._votes]
        return sum(1 for c in along if c > ALIGNED), sum(1 for c in along if c < -ALIGNED)

    def sign(self, axis: Vector) -> float:
        """Return +1 if the axis (3,) points forward, -1 if it points backward, 0 if the direction
        is uncertain."""
        ahead, back = self.count(axis)
        if abs(ahead - back) < VOTES_NEEDED or max(ahead, back) < AGREEMENT * (ahead + back):
            return 0.0
        return 1.0 if ahead > back else -1.0


class _Gathered:
    """Force summed over time, in sensor axes."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        self.x = self.y = self.z = self.seconds = 0.0

    def add_force(self, f: Vector, dt: float, direction: float) -> None:
        self.x += direction * dt * f[0]
        self.y += direction * dt * f[1]
        self.z += direction * dt * f[2]
        self.seconds += dt

    def horizontal(self, up: Vector) -> Vector:
        along = self.x * up[0] + self.y * up[1] + self.z * up[2]
        return (self.x - along * up[0], self.y - along * up[1], self.z - along * up[2])


class SignEvidence:
    """Decides between forward and backward by votes from brakings, turns and first motions.

    The sensor's offset must be removed from the force beforehand.

    sources: which of "brake", "turn", "first_motion" may vote.
    """

    def __init__(self, sources: Sequence[str]) -> None:
        self._sources = frozenset(sources)
        self.votes = SignVotes()
        self._first, self._brake, self._turn = _Gathered(), _Gathered(), _Gathered()
        self.restart()

    def restart(self) -> None:
        """Drop unfinished sums. The votes are kept."""
        self._departed = -math.inf
        for gathered in (self._first, self._brake, self._turn):
            gathered.clear()

    def depart(self, t: float) -> None:
        """Note that standstill has ended at t [s]."""
        self._departed = t
        self._first.clear()

    def take_turn(
        self, interval: SpeedInterval, f: Vector, up: Vector | None, reverse: bool
    ) -> None:
        """Process any interval. In a turn, the force points to the side to which the gyroscope
        turns."""
        turn = self._turn
        if abs(interval.yaw_rate) > TURN_RATE:
            turn.add_force(f, interval.t1 - interval.t0, math.copysign(1.0, interval.yaw_rate))
            return
        if turn.seconds >= TURN_S and not reverse and up is not None:
            x, y, z = turn.horizontal(up)  # to the left
            forward = (y * up[2] - z * up[1], z * up[0] - x * up[2], x * up[1] - y * up[0])
            self._vote("turn", forward, TURN_FORCE * turn.seconds)
        turn.clear()

    def take_straight(
        self, interval: SpeedInterval, f: Vector, up: Vector | None, reverse: bool, braking: bool
    ) -> None:
        """Process a straight interval."""
        if up is None:
            return
        dt = interval.t1 - interval.t0
        direction = -1.0 if reverse else 1.0
        first, brake = self._first, self._brake
        if interval.t0 - self._departed < FIRST_MOTION_WITHIN_S:
            first.add_force(f, dt, direction)
            if first.seconds >= GATHER_S:
                self._vote("first_motion", first.horizontal(up), FIRST_MOTION_FORCE * GATHER_S)
                self._departed = -math.inf
        if not braking:
            brake.clear()
            return
        brake.add_force(f, dt, -direction)
        if brake.seconds >= GATHER_S:
            self._vote("brake", brake.horizontal(up), BRAKE_FORCE * GATHER_S)
            brake.clear()

    def _vote(self, source: str, forward: Vector, least: float) -> None:
        x, y, z = forward
        if source in self._sources and math.sqrt(x * x + y * y + z * z) > least:
            self.votes.add_vote(source, forward)
