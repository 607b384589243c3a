"""Any interface of python-can, with the same methods as the SocketCAN socket.

Examples are adapters for USB, serial lines, remote buses, and the virtual bus of the demo. An
adapter may lack functions that SocketCAN has in the kernel (filters, counted losses, interface
states). Therefore the link filters ids again, and only an error shows that the adapter is gone.

python-can does not define how drivers handle damaged data. One driver raises CanError, another
raises ValueError, and a third returns a frame whose id is not a number. Such errors and invalid
frames do not close the link. A driver counts as gone only if it fails all the time.

This module also finds our own frames on a bus that returns frames to their sender. Multicast sends
a frame to every socket of the group, including the sender's own socket, without a mark. Without
this filter, our own frames would look like frames of another node and raise an alarm.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import socket
import sys
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from imucald.can.columns import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CAN_ERR_FLAG,
    CAN_RTR_FLAG,
    CAN_SFF_MASK,
    CLASSIC_BYTES,
    FD_BYTES,
    IdMatch,
)
from imucald.can.link.socketcan import MAX_BATCH, Frame
from imucald.can.python_can import can
from imucald.core.errors import LinkError
from imucald.core.libraries import how_to_install

ECHO_S = 0.5
"""Largest delay of an echo [s]. The network stack returns it at once, but a busy loop reads late.
A frame of another node is mistaken for ours only if id, counter, checksum and values are equal."""


class Echoes:
    """Remembers each sent frame until its echo has arrived. clock: monotonic [s]."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._sent: deque[tuple[float, int, bytes]] = deque(maxlen=4096)

    def sent(self, can_id: int, data: bytes) -> None:
        """Register a frame that was sent."""
        self._sent.append((self._clock(), can_id, data))

    def is_own(self, can_id: int, data: bytes) -> bool:
        """True if a received frame is an echo of a sent frame. Each sent frame has one echo."""
        oldest = self._clock() - ECHO_S
        while self._sent and self._sent[0][0] < oldest:
            self._sent.popleft()
        for i, (_, other_id, other) in enumerate(self._sent):
            if other_id == can_id and other == data:
                del self._sent[i]
                return True
        return False


FAILING_S = 0.2
"""A driver counts as gone if it fails all the time for this long [s]. Damaged frames cause shorter
failures: the next attempt returns a good frame (an accelerometer sends at least ten per second) or
reports that no frame waits. The value equals the check period of a silent SocketCAN interface."""

MAX_FAILURES = 32
"""Largest number of consecutive failed attempts in one call."""

MULTICAST = "udp_multicast"


class Adapter:
    """One open python-can bus. The failures of an adapter are raised as OSError, like the failures
    of a socket.

    Raises LinkError if python-can does not know the interface or its options. Raises OSError if the
    device cannot be opened now.
    """

    lost = 0  # an adapter does not report dropped frames
    receive_buffer = 0
    rejected = 0
    """Number of frames, or records of the driver, that could not be understood."""
    why_rejected = ""
    """The reason for the last rejected frame."""

    def __init__(
        self,
        interface: str,
        channel: str,
        matches: Sequence[IdMatch],
        *,
        fd: bool = False,
        bitrate: int | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self._failures = 0  # failures of the driver since it last worked
        self._failing_since = 0.0
        self._reason = ""
        self._echoes = Echoes() if interface == MULTICAST else None
        arguments: dict[str, Any] = dict(options or {})
        # it has no filter; the link's is faster than python-can's
        if interface != "virtual":
            arguments["can_filters"] = [_filter(match) for match in matches]
        if bitrate is not None:
            arguments["bitrate"] = bitrate
        # it has no filter; the link's is faster than python-can's
        if fd and interface != "virtual":
            arguments["fd"] = True
        try:
            self._bus = can.Bus(interface=interface, channel=channel, **arguments)
        except (can.CanInterfaceNotImplementedError, ImportError, TypeError) as error:
            remedy = f"; it needs {how_to_install('live')}" * ("msgpack" in str(error))
            if interface not in can.VALID_INTERFACES:
                import difflib  # noqa: PLC0415 - for errors only

                near = difflib.get_close_matches(interface, can.VALID_INTERFACES, 1)
                remedy = f" (did you mean {near[0]!r}?)" if near else ""
                remedy += f"; python-can has {', '.join(sorted(can.VALID_INTERFACES))}"
            raise LinkError(f"interface {interface!r}: {error}{remedy}") from None
        except OSError:
            raise
        except Exception as error:  # CanError, ValueError, or any other of a driver
            text = f"interface {interface!r}, channel {channel!r}: {_reason(error)}"
            raise OSError(text) from error
        if interface == MULTICAST and sys.platform == "linux":
            _hear_own_group_only(self._bus.fileno())

    def fileno(self) -> int | None:
        """Return a descriptor that is readable when frames wait; None if there is none."""
        try:
            number = self._bus.fileno()
        except Exception:  # NotImplementedError, or the adapter is gone
            return None
        return number if number >= 0 else None

    def close(self) -> None:
        """Close the bus. Errors of an unplugged adapter are ignored."""
        try:
            self._bus.shutdown()
        except Exception:
            return

    def give_up(self) -> None:
        """Do nothing, because an adapter does not report its waiting frames."""

    def receive(self, timeout: float) -> list[Frame]:
        """Wait up to `timeout` [s] for a frame, then return all waiting frames (bounded).

        Raises OSError if the driver has failed all the time for `FAILING_S`.
        """
        frames: list[Frame] = []
        receive, wait, failed = self._bus.recv, timeout, 0
        for _ in range(MAX_BATCH):
            try:
                message = receive(wait)
            except Exception as error:  # CanError, or any other for damaged data
                if self._has_gone(error):
                    if frames:
                        break
                    raise OSError(self._reason) from error
                failed += 1
                if failed == MAX_FAILURES:
                    # a driver that is gone fails at once, and would use a whole core
                    time.sleep(min(timeout, 0.002))
                    break
            else:
                failed = 0
                if self._failures:
                    self._works()
                if message is None:
                    break
                if (frame := self._taken(message)) is not None:
                    frames.append(frame)
            wait = 0.0
        return frames

    def _has_gone(self, error: Exception) -> bool:
        """Register a failure of the driver. Return whether it has failed for too long."""
        now = time.monotonic()
        if not self._failures:
            self._failing_since = now
        self._failures += 1
        self._reason = _reason(error)
        return now - self._failing_since > FAILING_S

    def _works(self) -> None:
        """Register that the driver works. Failures before this call were unreadable records."""
        self.rejected += self._failures
        self.why_rejected = self._reason
        self._failures = 0

    def _taken(self, message: can.Message) -> Frame | None:
        """Return the frame; None if it is our own or cannot be understood."""
        try:
            if not message.is_rx:  # some drivers return our own frames
                return None
            frame = _frame(message)
        except Exception as error:
            self.rejected += 1
            self.why_rejected = _reason(error)
            return None
        echoes = self._echoes
        return None if echoes is not None and echoes.is_own(frame[1], frame[2]) else frame

    def send(self, can_id: int, data: bytes) -> None:
        """Send one frame, as CAN FD when it is longer than 8 bytes.

        Raises OSError EIO if the adapter does not accept the frame, for any reason. `receive`
        reports whether the adapter is gone.
        """
        fd = len(data) > CLASSIC_BYTES
        message = can.Message(
            arbitration_id=can_id & ~CAN_EFF_FLAG,
            is_extended_id=bool(can_id & CAN_EFF_FLAG),
            data=data,
            is_fd=fd,
            bitrate_switch=fd,
        )
        try:
            # the transmit queue may be full
            self._bus.send(message, timeout=0.002)
        except Exception as error:
            raise OSError(errno.EIO, _reason(error)) from error
        if self._echoes is not None:
            self._echoes.sent(can_id, data)

    def is_same_interface(self) -> bool:
        """True if the adapter is still there. Always true, since only an error shows a loss."""
        return True

    def is_up(self) -> bool:
        """True if the interface is up. An open adapter is always up."""
        return True


def _hear_own_group_only(descriptor: int) -> None:
    """Receive only datagrams of our own group. By default, Linux delivers the datagrams of all
    joined groups to every socket of a port. Datagrams that came before are dropped."""
    with socket.socket(fileno=os.dup(descriptor)) as same:
        if same.family == socket.AF_INET6:
            same.setsockopt(socket.IPPROTO_IPV6, 29, 0)  # IPV6_MULTICAST_ALL (linux/in6.h)
        else:
            same.setsockopt(socket.IPPROTO_IP, 49, 0)  # IP_MULTICAST_ALL (linux/in.h)
        with contextlib.suppress(BlockingIOError):
            # more than the receive buffer holds: 208 KiB, at least 256 B per datagram
            for _ in range(10_000):
                same.recv(1, socket.MSG_DONTWAIT)


def _filter(match: IdMatch) -> Any:
    extended = bool(match.can_id & CAN_EFF_FLAG)
    can_id, mask = match.can_id & ~CAN_EFF_FLAG, match.mask & ~CAN_EFF_FLAG
    return {"can_id": can_id, "can_mask": mask, "extended": extended}


def _frame(message: can.Message) -> Frame:
    """Return time stamp, id and data, with their types and ranges checked.

    Raises TypeError or ValueError for a wrong type or range. python-can checks a message only if
    its driver requests it.
    """
    can_id, data = message.arbitration_id, message.data
    if not isinstance(can_id, int) or isinstance(can_id, bool):
        raise TypeError(f"its id is {can_id!r:.40}")
    is_long = message.is_extended_id or message.is_error_frame
    if not 0 <= can_id <= (CAN_EFF_MASK if is_long else CAN_SFF_MASK):
        raise ValueError(f"its id is {can_id!r:.40}")
    if not isinstance(data, bytes | bytearray | memoryview):
        raise TypeError("its data are not bytes")
    payload = bytes(data)
    if len(payload) > FD_BYTES:
        raise ValueError(f"it has {len(payload)} bytes")
    return _stamp(message), _flagged(can_id, message), payload


def _flagged(can_id: int, message: can.Message) -> int:
    if message.is_error_frame:
        return can_id | CAN_ERR_FLAG
    if message.is_remote_frame:
        can_id |= CAN_RTR_FLAG
    return can_id | CAN_EFF_FLAG if message.is_extended_id else can_id


def _stamp(message: can.Message) -> float:
    """Return the time stamp [s] rounded to microseconds, as in a written log."""
    stamp = message.timestamp or time.time()
    if not isinstance(stamp, int | float):
        raise TypeError(f"its time stamp is {stamp!r:.40}")
    # exact to the microsecond: the year 2255
    if not (math.isfinite(stamp) and 0.0 <= stamp <= 2**53 / 1e6):
        raise ValueError(f"its time stamp is {stamp!r:.40}")
    return round(stamp * 1e6) / 1e6


def _reason(error: Exception) -> str:
    text = str(error)
    if text and isinstance(error, can.CanError | OSError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
