"""What a bus link reports: state, counters, events for the log, and their texts with the remedy."""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass, field

from msgspec import Struct

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK
from imucald.core.text import counted

EVENT_PERIOD = 5.0
"""Events that may come with every frame are reported this often at most, with their count [s]."""


MAX_REASON = 200
"""Characters of a driver's text that are shown."""


class LinkState(enum.StrEnum):
    """How the bus is, as far as the interface shows."""

    UP = "up"
    DOWN = "down"  # the interface exists and is set down
    ABSENT = "absent"  # no such interface, or the adapter fails
    BUS_OFF = "bus_off"  # the controller has left the bus after too many errors


class LinkEvent(Struct, frozen=True):
    """Something worth a line in the log. `kind` is for programs, `text` for people.

    Kinds: the values of `LinkState` when it changes; conflict, lost, queue_full, rejected (seldom).
    """

    kind: str
    text: str


@dataclass(slots=True)
class LinkCounters:
    """What has passed since the start.

    received: frames handed out. lost: frames of ours that the kernel dropped unread (SocketCAN).
    late: frames handed out that had waited too long to be corrected, counted by who takes them.
    sent: frames the interface took. send_errors: frames not sent, by reason (absent, down,
    queue_full, bus_off, refused, too_long, adapter). conflicts: frames of other nodes under our
    output ids. foreign: frames not asked for that got past the filter. error_frames, bus_off:
    error frames, and how often the controller left the bus. went_down, reopened: how often the
    interface was set down, and how often it was opened again after it had gone. rejected: frames
    and records of a python-can driver that could not be understood.
    """

    received: int = 0
    lost: int = 0
    late: int = 0
    sent: int = 0
    send_errors: dict[str, int] = field(default_factory=dict)
    conflicts: int = 0
    foreign: int = 0
    error_frames: int = 0
    bus_off: int = 0
    went_down: int = 0
    reopened: int = 0
    rejected: int = 0

    def not_sent(self, reason: str) -> None:
        """Count a frame that was not sent."""
        self.send_errors[reason] = self.send_errors.get(reason, 0) + 1


class Announcer:
    """Hands events on; those of a kind that may flood only now and then."""

    def __init__(
        self, on_event: Callable[[LinkEvent], None] | None, clock: Callable[[], float]
    ) -> None:
        self._on_event = on_event
        self._clock = clock
        self._last: dict[str, tuple[float, int]] = {}

    def announce(self, kind: str, text: str) -> None:
        """Hand on an event."""
        if self._on_event is not None:
            self._on_event(LinkEvent(kind, text))

    def announce_seldom(self, kind: str, text: str) -> None:
        """Hand on at once, then at most every `EVENT_PERIOD`, saying how often it was meanwhile."""
        last, unannounced = self._last.get(kind, (-math.inf, 0))
        now = self._clock()
        if now - last < EVENT_PERIOD:
            self._last[kind] = (last, unannounced + 1)
            return
        self._last[kind] = (now, 0)
        self.announce(
            kind, text + (f" ({counted(unannounced, 'more time')} before)" if unannounced else "")
        )


def absent_text(interface: str, channel: str, error: OSError) -> str:
    """Return the text for an interface that cannot be opened now."""
    if interface != "socketcan":
        return f"{error}: is it plugged in, and is the channel's name right?"
    return (
        f"no CAN interface {channel} here ({error.strerror or error}). Remedy: name one of those "
        f"that `ip link show type can` lists, or for a trial: "
        f"ip link add dev {channel} type vcan && ip link set up {channel}"
    )


def down_text(channel: str) -> str:
    """Return the text for an interface that exists and is set down."""
    return (
        f"{channel} is set down. Remedy: ip link set up {channel} "
        "(a real interface needs its bit rate first: type can bitrate ...)"
    )


def bus_off_text(channel: str) -> str:
    """Return the text for a controller that has left the bus."""
    return (
        f"the controller of {channel} is bus-off (wrong bit rate, wiring, or no other node); "
        f"to restart by itself: ip link set {channel} type can restart-ms 100"
    )


def conflict_text(channel: str, can_id: int) -> str:
    """Return the text for a frame of another node under one of our output ids."""
    digits = 8 if can_id & CAN_EFF_FLAG else 3
    return (
        f"another node on {channel} sends our output id {can_id & CAN_EFF_MASK:0{digits}X}: "
        "choose other ids for the output, or stop the other sender"
    )


def rejected_text(channel: str, reason: str) -> str:
    """Return the text for frames of an adapter that make no sense."""
    return f"a frame of {channel} was rejected: it cannot be understood ({reason[:MAX_REASON]})"


def queue_full_text(channel: str) -> str:
    """Return the text for frames dropped because the interface does not take them."""
    return (
        f"the send queue of {channel} is full and frames are dropped: no node acknowledges them, "
        f"or it is too short (ip link set {channel} txqueuelen 100)"
    )
