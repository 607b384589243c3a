"""A CAN bus that is always there: opened, filtered, received from, sent to, lost and regained.

`Link` never raises for what happens on a bus. An interface that goes down, is deleted and made
again, a controller that is bus-off, a full send queue, a pulled adapter: each is a state, a counter
and an event, and `receive` returns what there is. It keeps no thread: healing happens inside
`receive`, so a loop that calls it at least every half second regains a bus within one second.

Of the frames on the bus only those asked for come out, and those that another node sends under our
own output ids are counted and announced (a conflict: two calibrators, or a wrong configuration).

What a bus link reports: state, counters, events for the log, and their texts with the remedy.
"""

from __future__ import annotations

import enum
import errno
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from types import TracebackType
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
from imucald.can.link.outbox import Outbox
from imucald.can.link.port import Port, open_port
from imucald.can.link.socketcan import CAN_ERR_BUSOFF, CAN_ERR_RESTARTED, MAX_BATCH, Frame
from imucald.core.errors import LinkError
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


def bus_off_text(channel: str) -> str:
    """Return the text for a controller that has left the bus."""
    return (
        f"the controller of {channel} is bus-off (wrong bit rate, wiring, or no other node). "
        f"To let it restart by itself, run: ip link set {channel} type can restart-ms 100"
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
    return (
        f"a frame on {channel} was rejected, since it cannot be understood ({reason[:MAX_REASON]})"
    )


def queue_full_text(channel: str) -> str:
    """Return the text for frames dropped because the interface does not take them."""
    return (
        f"the send queue of {channel} is full and frames are dropped: no other node "
        f"acknowledges them, or the queue is too short (ip link set {channel} txqueuelen 100)"
    )


__all__ = ["Frame", "Link", "LinkCounters", "LinkEvent", "LinkState"]

MIN_RETRY = 0.05
"""First pause before a lost interface is opened again [s]; doubled each time."""

MAX_RETRY = 0.2
"""Longest such pause [s]: frames shall resume within 1 s, on a busy machine too."""

CHECK_PERIOD = 0.2
"""A silent bus is asked this often whether its interface is still there and up [s]."""

RECEIVE_BUFFER = 4 << 20
"""Asked of the kernel [bytes]: some 4,000 frames with its overhead, seconds of a busy bus."""

FLUSH_PERIOD = 0.001
"""Pause between attempts to send while the send queue is full [s]."""

SEND_REASONS = {
    errno.ENETDOWN: "down",
    errno.EINVAL: "refused",  # an FD frame on a classic interface
    errno.EMSGSIZE: "refused",
    errno.EIO: "adapter",  # see adapter.py
}
"""Why a frame was not sent; any other error means that the interface has gone."""


class Link:
    """A bus of any python-can interface that heals itself.

    interface, channel: as python-can names them ("socketcan", "can0").
    receive: the ids wanted; those meant for another channel are left out.
    own_ids: ids that we send (with `CAN_EFF_FLAG` for 29-bit ones), watched for other senders.
    fd: take and send CAN FD frames too. bitrate_switch: send their payload at the data rate.
    bitrate, options: handed to python-can; a SocketCAN interface has its bit rate from `ip link`.
    receive_buffer: asked of the kernel [bytes]. wait: an interface that is not there yet is no
    error. on_event: called with each `LinkEvent`. clock: seconds, monotone.

    Raises LinkError (text with remedy) when the interface is not there and `wait` is false, or
    cannot be healed by time (unknown to python-can, not a CAN interface).
    """

    def __init__(
        self,
        interface: str,
        channel: str,
        *,
        receive: Sequence[IdMatch],
        own_ids: Iterable[int] = (),
        fd: bool = False,
        bitrate_switch: bool = True,
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
        """Whether the last `receive` took all that waited."""
        self._fd = fd
        self._bitrate = bitrate
        self._options = options
        self._buffer = receive_buffer
        self._clock = clock
        self._announcer = Announcer(on_event, clock)
        self._announced_state: LinkState | None = None
        self._port: Port | None = None
        self._opened_before = False
        self._lost_before = 0  # what earlier sockets had lost
        self._rejected_before = 0
        self._id_filter = LinkIdFilter(receive, own_ids, channel)
        self._outbox = Outbox(bitrate_switch, clock, self._frame_sent, self._queue_full)
        self._pause = MIN_RETRY
        self._next_try = self._next_check = -math.inf
        self._open(required=not wait)

    # ---- receiving ----------------------------------------------------------------------------

    def receive(self, timeout: float) -> list[Frame]:
        """Wait up to `timeout` [s] for frames of ours; return all that wait, oldest first.

        Each is (t [s], can_id with `CAN_EFF_FLAG` for 29 bits, data). Empty after the time-out, or
        whenever the bus is not there. Never raises for what happens on the bus.
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
        """Wait once, no longer than until the next check or attempt to send is due."""
        try:
            if self._outbox:
                self._flush(port)
                left = min(left, FLUSH_PERIOD)
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
        """Return the frames that are wanted; count the others and report what they mean."""
        if self.state is LinkState.DOWN:
            self._check(port)  # frames from before it went down may still come
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
            self._is_up_again()  # we hear the bus: some drivers do not report the restart
        return wanted

    def _conflict(self, can_id: int) -> None:
        self.counters.conflicts += 1
        self._announcer.announce_seldom("conflict", conflict_text(self.channel, can_id))

    def _error_frame(self, can_id: int) -> None:
        self.counters.error_frames += 1
        if can_id & CAN_ERR_RESTARTED:
            self._is_up_again()
        elif can_id & CAN_ERR_BUSOFF and self.state is not LinkState.BUS_OFF:
            self.counters.bus_off += 1
            self._enter(LinkState.BUS_OFF, bus_off_text(self.channel))

    def _count_losses(self, port: Port) -> None:
        lost = self._lost_before + port.lost
        if lost != self.counters.lost:
            self.counters.lost = lost
            self._announcer.announce_seldom(
                "lost", f"frames of {self.channel} were lost before they were read"
            )

    def _count_rejected(self, port: Port) -> None:
        self.counters.rejected = self._rejected_before + port.rejected
        self._announcer.announce_seldom("rejected", rejected_text(self.channel, port.why_rejected))

    # ---- sending ------------------------------------------------------------------------------

    def send(self, can_id: int, data: bytes) -> bool:
        """Send one frame, at once or (with a full send queue) within some milliseconds.

        can_id: with `CAN_EFF_FLAG` for 29 bits; data: up to 8 bytes, 64 with CAN FD. Returns
        whether it was accepted; what is not sent is counted by reason. Never blocks.
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
        """Send what is held; OSError when that shows that the interface is down or gone."""
        try:
            self._outbox.flush(port)
        except OSError as error:
            if self._failed_to_send(error):
                raise

    def _failed_to_send(self, error: OSError) -> bool:
        """Count a frame that was not sent; whether the interface is to blame, not the frame."""
        reason = SEND_REASONS.get(error.errno or 0, "absent")
        self.counters.not_sent(reason)
        return reason in ("absent", "down")

    def _frame_sent(self) -> None:
        self.counters.sent += 1

    def _queue_full(self) -> None:
        self.counters.not_sent("bus_off" if self.state is LinkState.BUS_OFF else "queue_full")
        self._announcer.announce_seldom("queue_full", queue_full_text(self.channel))

    # ---- losing and regaining -----------------------------------------------------------------

    def _open(self, required: bool) -> Port | None:
        """Try to open the interface. With `required`, failing raises LinkError."""
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
        """Open again when the pause since the last attempt is over."""
        if self._clock() < self._next_try:
            return None
        try:
            port = self._open(required=False)
        except LinkError as error:  # something else has taken the name; it may go again
            port = None
            self._enter(LinkState.ABSENT, f"{error}; waiting")
        if port is None:
            self._next_try = self._clock() + self._pause
            self._pause = min(2 * self._pause, MAX_RETRY)
        return port

    def _failed(self, port: Port, error: OSError) -> None:
        """Take in what the interface reported: down (it is kept) or gone (opened again later)."""
        if error.errno == errno.ENETDOWN and port.is_same_interface():
            self._went_down()
            self._check(port)  # it may be up again already
        else:
            self._let_go(port, error.strerror or str(error))

    def _check(self, port: Port) -> None:
        """Ask the system how the interface is: it may have been replaced without a word."""
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
        """Change the state, and report it if it is another one."""
        self.state = state
        if state is not self._announced_state:
            self._announced_state = state
            self._announcer.announce(str(state), text)

    # ---- the rest -----------------------------------------------------------------------------

    @property
    def receive_buffer(self) -> int:
        """What the kernel granted for frames that wait to be read [bytes]; 0 when not known."""
        return self._port.receive_buffer if self._port else 0

    def fileno(self) -> int | None:
        """Return the open bus's descriptor (another one after a loss), None where there is none."""
        return self._port.fileno() if self._port else None

    def close(self) -> None:
        """Close the bus; frames that the interface has not taken yet are given up."""
        if self._port is not None:
            self._port.close()
            self._port = None
            self.state = LinkState.ABSENT

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
