"""A CAN bus that reconnects by itself: open, filter, receive, send, detect a loss, reconnect.

`Link` never raises an error for events on a bus. Such events are: an interface goes down or is
deleted and created again, a controller is bus-off, the send queue is full, an adapter is unplugged.
Each event sets a state, a counter and a `LinkEvent`, and `receive` returns the available frames.
There is no thread; `receive` reconnects. A loop that calls `receive` at least every half second is
connected again within one second after the bus returns.

`receive` returns only the wanted frames. Frames that another node sends with our own output ids are
counted and reported as a conflict (two calibrators, or a wrong configuration).

This module also defines the reports of a link: state, counters, events for the log, and the texts
with remedies.
"""

from __future__ import annotations

import enum
import errno
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

from msgspec import Struct

from imucald.can.columns import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CAN_ERR_FLAG,
    CLASSIC_BYTES,
    FD_BYTES,
    IdMatch,
)
from imucald.can.id_filter import FrameClass, LinkIdFilter
from imucald.can.link.port import Outbox, Port, open_port
from imucald.can.link.socketcan import CAN_ERR_BUSOFF, CAN_ERR_RESTARTED, MAX_BATCH, Frame
from imucald.core.errors import LinkError
from imucald.core.text import counted

EVENT_PERIOD = 5.0
"""Shortest time between reports of events that may occur with every frame [s]. A report states
their number."""


class LinkState(enum.StrEnum):
    """The state of the bus, as far as the interface shows it."""

    UP = "up"
    DOWN = "down"  # the interface exists and is set down
    ABSENT = "absent"  # no such interface, or the adapter fails
    BUS_OFF = "bus_off"  # the controller has left the bus after too many errors


class LinkEvent(Struct, frozen=True):
    """An event for the log. `kind` is for programs, `text` is for people.

    Kinds: the new value of `LinkState` after a change; conflict, lost, queue_full, rejected (the
    last four kinds are reported at a limited rate).
    """

    kind: str
    text: str


@dataclass(slots=True)
class LinkCounters:
    """Numbers of frames and events since the start.

    received: frames returned by `receive`. lost: wanted frames that the kernel dropped before we
    read them (SocketCAN). late: returned frames that had waited too long to be corrected; the
    caller counts them. sent: frames that the interface accepted. send_errors: frames not sent, by
    reason (absent, down, queue_full, bus_off, refused, too_long, adapter). conflicts: frames of
    other nodes with our output ids. foreign: unwanted frames that passed the filter. error_frames:
    error frames. bus_off: how often the controller left the bus. went_down: how often the interface
    was set down. reopened: how often it was opened again after a loss. rejected: frames and records
    of a python-can driver that could not be understood.
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
    """Passes events on. Frequent kinds of events are passed on at a limited rate."""

    def __init__(
        self, on_event: Callable[[LinkEvent], None] | None, clock: Callable[[], float]
    ) -> None:
        self._on_event = on_event
        self._clock = clock
        self._last: dict[str, tuple[float, int]] = {}

    def announce(self, kind: str, text: str) -> None:
        """Pass on an event."""
        if self._on_event is not None:
            self._on_event(LinkEvent(kind, text))

    def announce_seldom(self, kind: str, text: str) -> None:
        """Pass on the first event at once. Pass on later events of this kind at most every
        `EVENT_PERIOD`, with their number."""
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
        return f"{error}. Is the adapter plugged in? Is the name of the channel right?"
    return (
        f"no CAN interface {channel} here ({error.strerror or error}). Name one of the "
        "interfaces that `ip link show type can` lists, or for a trial run: ip link add dev "
        f"{channel} type vcan && ip link set up {channel}"
    )


def down_text(channel: str) -> str:
    """Return the text for an interface that exists and is set down."""
    return (
        f"{channel} is set down. Run: ip link set up {channel} (a real interface needs its "
        f"bit rate first: ip link set {channel} type can bitrate 500000)"
    )


__all__ = ["Frame", "Link", "LinkCounters", "LinkEvent", "LinkState"]

MIN_RETRY = 0.05
"""First pause before a lost interface is opened again [s]. The pause doubles after each attempt."""

CHECK_PERIOD = 0.2
"""Period of the check that the interface of a silent bus still exists and is up [s]."""

RECEIVE_BUFFER = 4 << 20
"""Requested size of the kernel's receive buffer [bytes]. With its overhead, a buffer of this size
holds about 4,000 frames: some seconds of a busy bus."""

SEND_REASONS = {
    errno.ENETDOWN: "down",
    errno.EINVAL: "refused",  # an FD frame on a classic interface
    errno.EMSGSIZE: "refused",
    errno.EIO: "adapter",  # see adapter.py
}
"""The reason why a frame was not sent, by error number. Any other error means that the interface is
gone."""


class Link:
    """A bus of any python-can interface that reconnects by itself.

    interface, channel: the names of python-can ("socketcan", "can0").
    receive: filters of the wanted ids; filters for other channels are ignored.
    own_ids: ids that we send (with `CAN_EFF_FLAG` for 29 bits); other senders of them are reported.
    fd: receive and send CAN FD frames too, with their payload at the data rate.
    bitrate, options: passed to python-can; for SocketCAN, `ip link` sets the bit rate.
    receive_buffer: requested from the kernel [bytes]. wait: if True, a missing interface is not an
    error. on_event: called with each `LinkEvent`. clock: monotonic [s].

    Raises LinkError (text with remedy) if the interface is missing and `wait` is false. LinkError
    is also raised if waiting cannot help (unknown to python-can, not a CAN interface).
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        *,
        receive: Sequence[IdMatch],
        own_ids: Iterable[int] = (),
        fd: bool = False,
        bitrate: int | None = None,
        options: Mapping[str, Any] | None = None,
        receive_buffer: int = RECEIVE_BUFFER,
        wait: bool = False,
        on_event: Callable[[LinkEvent], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not channel:
            raise LinkError("a channel is needed: the name of the CAN interface, such as can0")
        self.interface = interface
        self.channel = channel
        self.counters = LinkCounters()
        self.state = LinkState.ABSENT
        self.is_empty = True
        """True if the last `receive` returned all waiting frames."""
        self._fd = fd
        self._bitrate = bitrate
        self._options = options
        self._buffer = receive_buffer
        self._clock = clock
        self._announcer = Announcer(on_event, clock)
        self._announced_state: LinkState | None = None
        self._port: Port | None = None
        self._opened_before = False
        self._lost_before = 0  # losses of earlier sockets
        self._rejected_before = 0
        self._id_filter = LinkIdFilter(receive, own_ids, channel)
        self._outbox = Outbox(clock, self._frame_sent, self._queue_full)
        self._pause = MIN_RETRY
        self._next_try = self._next_check = -math.inf
        self._open(required=not wait)

    # ---- receiving ----------------------------------------------------------------------------

    def receive(self, timeout: float) -> list[Frame]:
        """Wait up to `timeout` [s] for wanted frames; return all waiting frames, oldest first.

        Each frame is (t [s], can_id with `CAN_EFF_FLAG` for 29 bits, data). The list is empty after
        the time-out or if the bus is absent. Events on the bus never raise an error.
        """
        end = self._clock() + timeout
        while True:
            left = max(0.0, end - self._clock())
            port = self._port or self._reopened()
            if port is None:
                self.is_empty = True
                time.sleep(min(left, max(0.0, self._next_try - self._clock())))
            elif frames := self._receive_once(port, left):
                return frames
            if self._clock() >= end:
                return []

    def _receive_once(self, port: Port, left: float) -> list[Frame]:
        """Wait once, at most until the next check or the next attempt to send."""
        try:
            if self._outbox:
                self._flush(port)
                left = min(left, 0.001)
            self.is_empty = False
            frames = port.receive(min(left, CHECK_PERIOD))
            self.is_empty = len(frames) < MAX_BATCH
        except OSError as error:
            self._failed(port, error)
            return []
        if self._rejected_before + port.rejected != self.counters.rejected:
            self._count_rejected(port)
        if frames:
            return self._sorted(port, frames)
        if self._clock() >= self._next_check:
            self._check(port)
        return []

    def _sorted(self, port: Port, frames: list[Frame]) -> list[Frame]:
        """Return the wanted frames. Other frames are counted, and events for them are reported."""
        if self.state is LinkState.DOWN:
            self._check(port)  # frames from before the loss may still arrive
        wanted = []
        classes = self._id_filter
        for frame in frames:
            kind = classes[frame[1]]
            if kind is FrameClass.WANTED:
                wanted.append(frame)
            elif kind is FrameClass.CONFLICT:
                self._conflict(frame[1])
            elif kind is FrameClass.ERROR:
                self._error_frame(frame[1])
            else:
                self.counters.foreign += 1
        self.counters.received += len(wanted)
        self._count_losses(port)
        if self.state is LinkState.BUS_OFF and frames[-1][1] & CAN_ERR_FLAG == 0:
            self._is_up_again()  # frames arrive; some drivers do not report the restart
        return wanted

    def _conflict(self, can_id: int) -> None:
        self.counters.conflicts += 1
        digits = 8 if can_id & CAN_EFF_FLAG else 3
        text = (
            f"another node on {self.channel} sends our output id "
            f"{can_id & CAN_EFF_MASK:0{digits}X}: choose other ids for the output, or stop the "
            "other sender"
        )
        self._announcer.announce_seldom("conflict", text)

    def _error_frame(self, can_id: int) -> None:
        self.counters.error_frames += 1
        if can_id & CAN_ERR_RESTARTED:
            self._is_up_again()
        elif can_id & CAN_ERR_BUSOFF and self.state is not LinkState.BUS_OFF:
            self.counters.bus_off += 1
            text = (
                f"the controller of {self.channel} is bus-off (wrong bit rate, wiring, or no other "
                f"node). To let it restart by itself, run: ip link set {self.channel} type can "
                "restart-ms 100"
            )
            self._enter(LinkState.BUS_OFF, text)

    def _count_losses(self, port: Port) -> None:
        lost = self._lost_before + port.lost
        if lost != self.counters.lost:
            self.counters.lost = lost
            self._announcer.announce_seldom(
                "lost", f"frames of {self.channel} were lost before they were read"
            )

    def _count_rejected(self, port: Port) -> None:
        self.counters.rejected = self._rejected_before + port.rejected
        why = port.why_rejected[:200]
        text = f"a frame on {self.channel} was rejected, since it cannot be understood ({why})"
        self._announcer.announce_seldom("rejected", text)

    # ---- sending ------------------------------------------------------------------------------

    def send(self, can_id: int, data: bytes) -> bool:
        """Send one frame, at once or (if the send queue is full) within some milliseconds.

        can_id: with `CAN_EFF_FLAG` for 29 bits; data: up to 8 bytes, 64 with CAN FD. Returns
        whether the frame was accepted. Frames that are not sent are counted by reason. Never
        blocks.
        """
        port = self._port
        if port is None or len(data) > (FD_BYTES if self._fd else CLASSIC_BYTES):
            self.counters.not_sent("absent" if port is None else "too_long")
            return False
        try:
            self._outbox.send(port, can_id, data)
        except OSError as error:
            if self._failed_to_send(error):
                self._failed(port, error)
            return False
        return True

    def _flush(self, port: Port) -> None:
        try:
            self._outbox.flush(port)
        except OSError as error:
            if self._failed_to_send(error):
                raise

    def _failed_to_send(self, error: OSError) -> bool:
        """Count a frame that was not sent. Return whether the interface is the cause."""
        reason = SEND_REASONS.get(error.errno or 0, "absent")
        self.counters.not_sent(reason)
        return reason in ("absent", "down")

    def _frame_sent(self) -> None:
        self.counters.sent += 1

    def _queue_full(self) -> None:
        self.counters.not_sent("bus_off" if self.state is LinkState.BUS_OFF else "queue_full")
        text = (
            f"the send queue of {self.channel} is full and frames are dropped: no other node "
            "acknowledges them, or the queue is too short "
            f"(ip link set {self.channel} txqueuelen 100)"
        )
        self._announcer.announce_seldom("queue_full", text)

    # ---- losing and regaining -----------------------------------------------------------------

    def _open(self, required: bool) -> Port | None:
        try:
            port = self._new_port()
        except OSError as error:
            if required:
                raise LinkError(absent_text(self.interface, self.channel, error)) from None
            self._enter(
                LinkState.ABSENT,
                absent_text(self.interface, self.channel, error) + "; waiting for it",
            )
            return None
        self._port = port
        self.counters.reopened += self._opened_before
        self._opened_before = True
        self._pause = MIN_RETRY
        if port.is_up():
            self._enter(LinkState.UP, f"{self.interface} {self.channel} is open")
        else:
            self._enter(LinkState.DOWN, down_text(self.channel))
        return port

    def _new_port(self) -> Port:
        filters = self._id_filter.filters()
        bus = self.interface, self.channel
        return open_port(*bus, filters, self._fd, self._bitrate, self._options, self._buffer)

    def _reopened(self) -> Port | None:
        """Try to open again if the pause since the last attempt is over."""
        if self._clock() < self._next_try:
            return None
        try:
            port = self._open(required=False)
        except LinkError as error:  # another interface has the name, maybe temporarily
            port = None
            self._enter(LinkState.ABSENT, f"{error}; waiting")
        if port is None:
            self._next_try = self._clock() + self._pause
            # frames must resume within 1 s, also on a busy machine
            self._pause = min(2 * self._pause, 0.2)
        return port

    def _failed(self, port: Port, error: OSError) -> None:
        """Handle an error of the interface: down (it stays open) or gone (reopened later)."""
        if error.errno == errno.ENETDOWN and port.is_same_interface():
            self._went_down()
            self._check(port)  # it may be up again already
        else:
            self._let_go(port, error.strerror or str(error))

    def _check(self, port: Port) -> None:
        """Ask the system for the interface's state. The interface may have been replaced without an
        error."""
        self._next_check = self._clock() + CHECK_PERIOD
        if not port.is_same_interface():
            self._let_go(port, "deleted or replaced")
        elif not port.is_up():
            self._went_down()
        elif self.state is LinkState.DOWN:
            self._is_up_again()

    def _let_go(self, port: Port, reason: str) -> None:
        port.give_up()
        self._count_losses(port)
        self._lost_before = self.counters.lost
        self._rejected_before = self.counters.rejected
        port.close()
        self._port = None
        for _ in range(self._outbox.clear()):
            self.counters.not_sent("absent")
        self._next_try = self._clock()
        self._enter(
            LinkState.ABSENT, f"{self.channel} has disappeared ({reason}); waiting until it is back"
        )

    def _went_down(self) -> None:
        if self.state is not LinkState.DOWN:
            self.counters.went_down += 1
            self._enter(LinkState.DOWN, down_text(self.channel))

    def _is_up_again(self) -> None:
        self._enter(LinkState.UP, f"{self.channel} is up again")

    def _enter(self, state: LinkState, text: str) -> None:
        self.state = state
        if state is not self._announced_state:
            self._announced_state = state
            self._announcer.announce(str(state), text)

    # ---- the rest -----------------------------------------------------------------------------

    @property
    def receive_buffer(self) -> int:
        """Size of the kernel's receive buffer [bytes]; 0 if not known."""
        return self._port.receive_buffer if self._port else 0

    def fileno(self) -> int | None:
        """Return the descriptor of the open bus (it changes after a loss); None if not open."""
        return self._port.fileno() if self._port else None

    def close(self) -> None:
        """Close the bus. Frames that the interface has not accepted yet are dropped."""
        if self._port is not None:
            self._port.close()
            self._port = None
            self.state = LinkState.ABSENT

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
