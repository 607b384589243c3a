"""Any interface that python-can knows, with the verbs of a SocketCAN socket.

Adapters for USB, serial lines, remote buses, and the virtual bus of the demo. What SocketCAN does
in the kernel (filters, counted losses, interface states) an adapter may not do at all; ids are
therefore filtered again by the link, and only an error shows that the adapter has gone.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Mapping, Sequence
from typing import Any

from imucald.can.columns import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, CLASSIC_BYTES, IdMatch
from imucald.can.link.own_echoes import Echoes
from imucald.can.link.socketcan import MAX_BATCH, Frame
from imucald.can.python_can import can
from imucald.core.errors import LinkError
from imucald.core.extras import how_to_install

SEND_WAIT = 0.002
"""An adapter may block so long when its transmit queue is full [s]."""

ECHOING = ("udp_multicast",)
"""Interfaces of python-can that hand back what we sent without a mark."""

_IN_MEMORY = ("virtual",)  # no filter of their own; the link's is quicker than python-can's


class Adapter:
    """One open python-can bus. Its failures come out as OSError, as those of a socket do.

    Raises LinkError when python-can does not know the interface or its options, OSError when the
    device cannot be opened now.
    """

    lost = 0  # an adapter does not say what it dropped
    receive_buffer = 0

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
            raise LinkError(f"interface {interface!r}: {error}{remedy}") from None
        except (can.CanError, ValueError) as error:
            raise OSError(f"interface {interface!r}, channel {channel!r}: {error}") from error

    def fileno(self) -> int | None:
        """Return a descriptor that is readable when frames wait, None where there is none."""
        try:
            number = self._bus.fileno()
        except NotImplementedError:
            return None
        return number if number >= 0 else None

    def close(self) -> None:
        """Close the bus; an adapter that was pulled out may fail at that, and is gone anyway."""
        try:
            self._bus.shutdown()
        except (can.CanError, OSError):
            return

    def receive(self, timeout: float) -> list[Frame]:
        """Wait up to `timeout` [s] for a frame, then take all that wait (bounded)."""
        frames: list[Frame] = []
        receive = self._bus.recv
        try:
            message = receive(timeout)
            while message is not None:
                if message.is_rx and not self._is_echo(message):  # some hand back what we sent
                    frames.append((_stamp(message), _can_id(message), bytes(message.data)))
                if len(frames) >= MAX_BATCH:
                    break
                message = receive(0.0)
        except can.CanError as error:
            if not frames:
                raise OSError(str(error)) from error
        return frames

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
        except (can.CanError, OSError, ValueError) as error:
            raise OSError(errno.EIO, str(error)) from error
        if self._echoes is not None:
            self._echoes.sent(can_id, data)

    def _is_echo(self, message: can.Message) -> bool:
        echoes = self._echoes
        return echoes is not None and echoes.is_own(_can_id(message), bytes(message.data))

    def is_same_interface(self) -> bool:
        """Whether the adapter is still there: only an error would show it."""
        return True

    def is_up(self) -> bool:
        """Whether the interface is up: adapters are, while open."""
        return True


def _filter(match: IdMatch) -> Any:
    extended = bool(match.can_id & CAN_EFF_FLAG)
    can_id, mask = match.can_id & ~CAN_EFF_FLAG, match.mask & ~CAN_EFF_FLAG
    return {"can_id": can_id, "can_mask": mask, "extended": extended}


def _can_id(message: can.Message) -> int:
    can_id = message.arbitration_id
    if message.is_error_frame:
        return can_id | CAN_ERR_FLAG
    if message.is_remote_frame:
        can_id |= CAN_RTR_FLAG
    return can_id | CAN_EFF_FLAG if message.is_extended_id else can_id


def _stamp(message: can.Message) -> float:
    """Return the stamp [s] in whole microseconds, as a written log has it."""
    return round((message.timestamp or time.time()) * 1e6) / 1e6
