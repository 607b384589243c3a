"""Any interface that python-can knows, with the verbs of a SocketCAN socket.

Adapters for USB, serial lines, remote buses, and the virtual bus of the demo. What SocketCAN does
in the kernel (filters, counted losses, interface states) an adapter may not do at all; ids are
therefore filtered again by the link, and only an error shows that the adapter has gone.

What a driver makes of damaged data is not python-can's to say: one raises CanError, another
ValueError, a third hands out a frame whose id is no number. None of it ends a link, and a frame
that nobody can understand does not close it: only a driver that does nothing but fail has gone.

Which received frames are our own, on a bus that hands them back to their sender.

Multicast gives a frame to every socket of the group, the sender's too, and does not say whose it
was. Taken for another node's it would be an alarm by oneself.
"""

from __future__ import annotations

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


SEND_WAIT = 0.002
"""An adapter may block so long when its transmit queue is full [s]."""

FAILING_S = 0.2
"""A driver that does nothing but fail for so long has gone [s]. One damaged frame, or a burst, is
over sooner: the next attempt gives a good frame (an accelerometer sends ten a second at least) or
says that nothing waits. As long as a silent SocketCAN interface takes to be looked at."""

MAX_FAILURES = 32
"""Attempts in one call, one after the other, that may fail."""

FAILURE_PAUSE_S = 0.002
"""Pause after that many [s]: a driver that has gone fails at once, and shall not take a core."""

MAX_STAMP = 2**53 / 1e6
"""Up to there a float holds whole microseconds [s]: until the year 2255."""

MULTICAST = "udp_multicast"
IP_MULTICAST_ALL, IPV6_MULTICAST_ALL = 49, 29
"""Of linux/in.h and linux/in6.h; Python does not name them."""

ECHOING = (MULTICAST,)
"""Interfaces of python-can that hand back what we sent without a mark."""

_IN_MEMORY = ("virtual",)  # no filter of their own; the link's is quicker than python-can's


class Adapter:
    """One open python-can bus. Its failures come out as OSError, as those of a socket do.

    Raises LinkError when python-can does not know the interface or its options, OSError when the
    device cannot be opened now.
    """

    lost = 0  # an adapter does not say what it dropped
    receive_buffer = 0
    rejected = 0
    """Frames, or records of the driver, that could not be understood."""
    why_rejected = ""
    """Of the last of them."""

    def __init__(
        self,
        interface: str,
        channel: str,
        matches: Sequence[IdMatch],
        *,
        fd: bool = False,
        bitrate: int | None = None,
        options: Mapping[str, Any] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._clock = clock
        self._failures = 0  # of the driver, since it last worked
        self._failing_since = 0.0
        self._reason = ""
        self._echoes = Echoes() if interface in ECHOING else None
        arguments: dict[str, Any] = dict(options or {})
        if interface not in _IN_MEMORY:
            arguments["can_filters"] = [_filter(match) for match in matches]
        if bitrate is not None:
            arguments["bitrate"] = bitrate
        if fd and interface not in _IN_MEMORY:
            arguments["fd"] = True
        try:
            self._bus = can.Bus(interface=interface, channel=channel, **arguments)
        except (can.CanInterfaceNotImplementedError, ImportError, TypeError) as error:
            remedy = f"; it needs {how_to_install('live')}" * ("msgpack" in str(error))
            if interface not in can.VALID_INTERFACES:
                import difflib  # noqa: PLC0415 - for a mistake alone

                near = difflib.get_close_matches(interface, can.VALID_INTERFACES, 1)
                remedy = f" (did you mean {near[0]!r}?)" if near else ""
                remedy += f"; python-can has {', '.join(sorted(can.VALID_INTERFACES))}"
            raise LinkError(f"interface {interface!r}: {error}{remedy}") from None
        except OSError:
            raise
        except Exception as error:  # CanError, ValueError, or what else a driver knows
            text = f"interface {interface!r}, channel {channel!r}: {_reason(error)}"
            raise OSError(text) from error
        if interface == MULTICAST and sys.platform == "linux":
            _hear_own_group_only(self._bus.fileno())

    def fileno(self) -> int | None:
        """Return a descriptor that is readable when frames wait, None where there is none."""
        try:
            number = self._bus.fileno()
        except Exception:  # NotImplementedError, or of an adapter that has gone
            return None
        return number if number >= 0 else None

    def close(self) -> None:
        """Close the bus; an adapter that was pulled out may fail at that, and is gone anyway."""
        try:
            self._bus.shutdown()
        except Exception:
            return

    def give_up(self) -> None:
        """Nothing: an adapter does not say what it still has."""

    def receive(self, timeout: float) -> list[Frame]:
        """Wait up to `timeout` [s] for a frame, then take all that wait (bounded).

        Raises OSError when the driver has done nothing but fail for `FAILING_S`.
        """
        frames: list[Frame] = []
        receive, wait, failed = self._bus.recv, timeout, 0
        for _ in range(MAX_BATCH):
            try:
                message = receive(wait)
            except Exception as error:  # CanError, or what else a driver makes of damaged data
                if self._has_gone(error):
                    if frames:
                        break
                    raise OSError(self._reason) from error
                failed += 1
                if failed == MAX_FAILURES:
                    time.sleep(min(timeout, FAILURE_PAUSE_S))
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
        """Take in that the driver failed; whether it has done so for too long."""
        now = self._clock()
        if not self._failures:
            self._failing_since = now
        self._failures += 1
        self._reason = _reason(error)
        return now - self._failing_since > FAILING_S

    def _works(self) -> None:
        """The driver has not gone: what it failed at were records that it did not understand."""
        self.rejected += self._failures
        self.why_rejected = self._reason
        self._failures = 0

    def _taken(self, message: can.Message) -> Frame | None:
        """Return the frame; None where it is our own, or cannot be understood."""
        try:
            if not message.is_rx:  # some hand back what we sent
                return None
            frame = _frame(message)
        except Exception as error:
            self.rejected += 1
            self.why_rejected = _reason(error)
            return None
        echoes = self._echoes
        return None if echoes is not None and echoes.is_own(frame[1], frame[2]) else frame

    def send(self, can_id: int, data: bytes, bitrate_switch: bool) -> None:
        """Send one frame, as CAN FD when it is longer than 8 bytes.

        Raises OSError EIO when the adapter does not take it, for whatever reason: whether it has
        gone is reported by receiving.
        """
        fd = len(data) > CLASSIC_BYTES
        message = can.Message(
            arbitration_id=can_id & ~CAN_EFF_FLAG,
            is_extended_id=bool(can_id & CAN_EFF_FLAG),
            data=data,
            is_fd=fd,
            bitrate_switch=fd and bitrate_switch,
        )
        try:
            self._bus.send(message, timeout=SEND_WAIT)
        except Exception as error:
            raise OSError(errno.EIO, _reason(error)) from error
        if self._echoes is not None:
            self._echoes.sent(can_id, data)

    def is_same_interface(self) -> bool:
        """Whether the adapter is still there: only an error would show it."""
        return True

    def is_up(self) -> bool:
        """Whether the interface is up: adapters are, while open."""
        return True


def _hear_own_group_only(descriptor: int) -> None:
    """Linux gives every socket of a port the datagrams of all groups that anybody joined."""
    with socket.socket(fileno=os.dup(descriptor)) as same:
        if same.family == socket.AF_INET6:
            same.setsockopt(socket.IPPROTO_IPV6, IPV6_MULTICAST_ALL, 0)
        else:
            same.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)


def _filter(match: IdMatch) -> Any:
    extended = bool(match.can_id & CAN_EFF_FLAG)
    can_id, mask = match.can_id & ~CAN_EFF_FLAG, match.mask & ~CAN_EFF_FLAG
    return {"can_id": can_id, "can_mask": mask, "extended": extended}


def _frame(message: can.Message) -> Frame:
    """Return stamp, id and data, each of the type and within the range that all else relies on.

    Raises TypeError or ValueError: python-can looks at a message only where its driver asks for it.
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
    """Return the stamp [s] in whole microseconds, as a written log has it."""
    stamp = message.timestamp or time.time()
    if not isinstance(stamp, int | float):
        raise TypeError(f"its time stamp is {stamp!r:.40}")
    if not (math.isfinite(stamp) and 0.0 <= stamp <= MAX_STAMP):
        raise ValueError(f"its time stamp is {stamp!r:.40}")
    return round(stamp * 1e6) / 1e6


def _reason(error: Exception) -> str:
    """What is to be said of an error; with its kind where only that tells what it is about."""
    text = str(error)
    if text and isinstance(error, can.CanError | OSError):
        return text
    return f"{type(error).__name__}: {text}" if text else type(error).__name__
