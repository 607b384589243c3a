"""Sending without waiting: a short memory for the moments when the interface's queue is full.

A classic CAN interface queues ten frames by default. A burst of ours on a busy bus overruns that
for some milliseconds, which is no reason to lose frames; a queue that stays full is one, because a
corrected sample is worth nothing later.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable
from typing import Protocol

HELD_FRAMES = 32
"""Frames kept while the queue is full: a burst, not a backlog."""

MAX_HOLD = 0.05
"""A frame that could not be sent for so long is stale and dropped [s]."""

_FULL = (errno.ENOBUFS, errno.EAGAIN)


class SendingPort(Protocol):
    """Where frames are sent; raises OSError, ENOBUFS or EAGAIN when its queue is full."""

    def send(self, can_id: int, data: bytes, bitrate_switch: bool) -> None:
        """Send one frame."""


class Outbox:
    """Frames in the order they came, sent as soon as the port takes them.

    on_sent, on_dropped: called for each frame that was taken, or given up.
    Every OSError that does not say "full" is let through; the frame it concerns is no longer here.
    """

    def __init__(
        self,
        bitrate_switch: bool,
        clock: Callable[[], float],
        on_sent: Callable[[], None],
        on_dropped: Callable[[], None],
    ) -> None:
        self._bitrate_switch = bitrate_switch
        self._clock = clock
        self._on_sent = on_sent
        self._on_dropped = on_dropped
        self._held: deque[tuple[float, int, bytes]] = deque()

    def __len__(self) -> int:
        return len(self._held)

    def send(self, port: SendingPort, can_id: int, data: bytes) -> None:
        """Send a frame after those that are held, or hold it too."""
        if self._held:
            self.flush(port)
        if self._held or not self._taken(port, can_id, data):
            if len(self._held) >= HELD_FRAMES:
                self._held.popleft()
                self._on_dropped()
            self._held.append((self._clock(), can_id, data))

    def flush(self, port: SendingPort) -> None:
        """Send what is held, in order, and drop what is stale."""
        now = self._clock()
        while self._held:
            since, can_id, data = self._held.popleft()
            if now - since > MAX_HOLD:
                self._on_dropped()
            elif not self._taken(port, can_id, data):
                self._held.appendleft((since, can_id, data))
                return

    def clear(self) -> int:
        """Forget what is held; how many frames that were."""
        count = len(self._held)
        self._held.clear()
        return count

    def _taken(self, port: SendingPort, can_id: int, data: bytes) -> bool:
        """Whether the port took the frame; False when its queue is full."""
        try:
            port.send(can_id, data, self._bitrate_switch)
        except OSError as error:
            if error.errno in _FULL:
                return False
            raise
        self._on_sent()
        return True
