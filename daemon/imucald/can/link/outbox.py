"""Send without blocking: a short buffer for times when the interface's queue is full.

A classic CAN interface queues ten frames by default. A burst of our frames on a busy bus exceeds
this number for some milliseconds. No frame of such a burst should be lost. If the queue stays full,
frames are dropped, because a corrected sample is useless when it is late.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable
from typing import Protocol

HELD_FRAMES = 32
"""Largest number of frames held while the queue is full. This number is enough for a burst."""

MAX_HOLD = 0.05
"""A frame that could not be sent for this time is dropped as too old [s]."""

_FULL = (errno.ENOBUFS, errno.EAGAIN)


class SendingPort(Protocol):
    """A port for sending frames. Raises OSError; ENOBUFS or EAGAIN mean that its queue is full."""

    def send(self, can_id: int, data: bytes, bitrate_switch: bool) -> None:
        """Send one frame."""


class Outbox:
    """Held frames in their order. Stored frames are sent as soon as the port accepts them.

    on_sent, on_dropped: called for each frame that was sent or dropped. Every OSError that does not
    mean a full queue is raised to the caller. The frame that caused the error is removed.
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
        """Send a frame after the held frames. If it cannot be sent now, hold the frame too."""
        if self._held:
            self.flush(port)
        if self._held or not self._taken(port, can_id, data):
            if len(self._held) >= HELD_FRAMES:
                self._held.popleft()
                self._on_dropped()
            self._held.append((self._clock(), can_id, data))

    def flush(self, port: SendingPort) -> None:
        """Send the held frames in order, and drop frames that are too old."""
        now = self._clock()
        while self._held:
            since, can_id, data = self._held.popleft()
            if now - since > MAX_HOLD:
                self._on_dropped()
            elif not self._taken(port, can_id, data):
                self._held.appendleft((since, can_id, data))
                return

    def clear(self) -> int:
        """Remove the held frames, and return their number."""
        count = len(self._held)
        self._held.clear()
        return count

    def _taken(self, port: SendingPort, can_id: int, data: bytes) -> bool:
        """Try to send a frame. Return False if the port's queue is full."""
        try:
            port.send(can_id, data, self._bitrate_switch)
        except OSError as error:
            if error.errno in _FULL:
                return False
            raise
        self._on_sent()
        return True
