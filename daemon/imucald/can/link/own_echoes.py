"""Which received frames are our own, on a bus that hands them back to their sender.

Multicast gives a frame to every socket of the group, the sender's too, and does not say whose it
was. Taken for another node's it would be an alarm by oneself.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

ECHO_S = 0.5
"""An echo comes within this time [s]: the network stack returns it at once, a busy loop reads late.
Another node's frame is taken for ours only if it has our id, counter, checksum and values."""
MAX_WAITING = 4096
"""Frames waited for; beyond that the oldest are given up."""


class Echoes:
    """Remembers what was sent until it has come back once. clock: monotonic [s]."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._sent: deque[tuple[float, int, bytes]] = deque(maxlen=MAX_WAITING)

    def sent(self, can_id: int, data: bytes) -> None:
        """Take note of a frame that was sent."""
        self._sent.append((self._clock(), can_id, data))

    def is_own(self, can_id: int, data: bytes) -> bool:
        """Whether a received frame is the echo of one that was sent; each sent one counts once."""
        oldest = self._clock() - ECHO_S
        while self._sent and self._sent[0][0] < oldest:
            self._sent.popleft()
        for i, (_, other_id, other) in enumerate(self._sent):
            if other_id == can_id and other == data:
                del self._sent[i]
                return True
        return False
