"""The functions of an open interface that `Link` needs, and the function that opens one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from imucald.can.columns import IdMatch
from imucald.can.link.outbox import SendingPort
from imucald.can.link.socketcan import Frame, SocketCan


class Port(SendingPort, Protocol):
    """An open interface, with the functions that `Link` needs. Failures raise OSError."""

    lost: int
    receive_buffer: int
    rejected: int
    why_rejected: str

    def fileno(self) -> int | None:
        """Return a descriptor to wait on, if there is one."""

    def close(self) -> None:
        """Close the interface."""

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
