"""An open interface, and sending without blocking: a short buffer for times when its queue is full.

A classic CAN interface queues ten frames by default. A burst of our frames on a busy bus exceeds
this number for some milliseconds. No frame of such a burst should be lost. If the queue stays full,
frames are dropped, because a corrected sample is useless when it is late.
"""

from __future__ import annotations

import errno
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from imucald.can.columns import IdMatch
from imucald.can.link.socketcan import Frame, SocketCan

HELD_FRAMES = 32
"""Largest number of frames held while the queue is full. This number is enough for a burst."""

MAX_HOLD = 0.05
"""A frame that could not be sent for this time is dropped as too old [s]."""

_FULL = (errno.ENOBUFS, errno.EAGAIN)


class Port(Protocol):
    """An open interface, with the functions that `Link` needs. Failures raise OSError."""

    lost: int
    receive_buffer: int
    rejected: int
    why_rejected: str

    def fileno(self) -> int | None:
        """Return a descriptor to wait on, if there is one."""

    def close(self) -> None:
        """Close the interface."""

    def send(self, can_id: int, data: bytes) -> None:
        """Send one frame. ENOBUFS or EAGAIN mean that the queue is full."""

    def receive(self, timeout: float) -> list[Frame]:
        """Wait for a frame, then return all waiting frames."""

    def give_up(self) -> None:
        """Count the waiting frames in `lost`, because they will not be read."""

    def is_same_interface(self) -> bool:
        """True if the opened interface still exists."""

    def is_up(self) -> bool:
        """True if the interface is up."""


def open_port(
    interface: str,
    channel: str,
    filters: Sequence[IdMatch],
    fd: bool,
    bitrate: int | None,
    options: Mapping[str, Any] | None,
    receive_buffer: int,
) -> Port:
    """Open an interface; parameters as in `Link`. Raises OSError, or LinkError if later attempts
    would fail too."""
    if interface == "socketcan":
        return SocketCan(channel, filters, fd=fd, receive_buffer=receive_buffer)
    from imucald.can.link.adapter import Adapter  # noqa: PLC0415  (SocketCAN needs no python-can)

    return Adapter(interface, channel, filters, fd=fd, bitrate=bitrate, options=options)


class Outbox:
    """Held frames in their order. Stored frames are sent as soon as the port accepts them.

    on_sent, on_dropped: called for each frame that was sent or dropped. Every OSError that does not
    mean a full queue is raised to the caller. The frame that caused the error is removed.
    """

    def __init__(
        self,
        clock: Callable[[], float],
        on_sent: Callable[[], None],
        on_dropped: Callable[[], None],
    ) -> None:
        self._clock = clock
        self._on_sent = on_sent
        self._on_dropped = on_dropped
        self._held: deque[tuple[float, int, bytes]] = deque()

    def __len__(self) -> int:
        return len(self._held)

    def send(self, port: Port, can_id: int, data: bytes) -> None:
        """Send a frame after the held frames. If it cannot be sent now, hold the frame too."""
        if self._held:
            self.flush(port)
        if self._held or not self._taken(port, can_id, data):
            if len(self._held) >= HELD_FRAMES:
                self._held.popleft()
                self._on_dropped()
            self._held.append((self._clock(), can_id, data))

    def flush(self, port: Port) -> None:
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

    def _taken(self, port: Port, can_id: int, data: bytes) -> bool:
        try:
            port.send(can_id, data)
        except OSError as error:
            if error.errno in _FULL:
                return False
            raise
        self._on_sent()
        return True
