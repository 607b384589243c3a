"""The bus link on python-can's virtual bus, and its healing with a port that fails as told."""

from __future__ import annotations

import errno
import itertools
import os
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK, IdMatch
from imucald.can.link import socketcan
from imucald.can.link.link import Link, LinkEvent, LinkState
from imucald.can.link.port import HELD_FRAMES, MAX_HOLD, Outbox
from imucald.can.link.socketcan import MAX_BATCH, MAX_FILTERS, SocketCan, packed_filters
from imucald.can.python_can import can
from imucald.core.errors import LinkError

WANTED = IdMatch(0x123, CAN_SFF_MASK)
WANTED_J1939 = IdMatch(0x18FEF100 | CAN_EFF_FLAG, 0x00FFFF00)
OWN = 0x600
_channels = itertools.count()


@pytest.fixture
def channel() -> str:
    return f"test-link-{next(_channels)}"


@pytest.fixture
def other(channel: str) -> Iterator[Any]:
    """Another node on the same virtual bus."""
    with can.Bus(interface="virtual", channel=channel) as bus:
        yield bus


def message(can_id: int, data: bytes = b"\x01\x02", **more: Any) -> Any:
    return can.Message(arbitration_id=can_id, data=data, **{"is_extended_id": False, **more})


def test_only_the_wanted_frames_come_out_in_order(channel: str, other: Any) -> None:
    with Link("virtual", channel, receive=[WANTED, WANTED_J1939]) as link:
        other.send(message(0x123, b"\x01"))
        other.send(message(0x124, b"\x02"))
        other.send(message(0x123, b"\x03", is_extended_id=True))  # same number, another id
        other.send(message(0x0CFEF127, b"\x04", is_extended_id=True))
        other.send(message(0x123, b"", is_remote_frame=True, dlc=2))
        other.send(message(0x123, b"\x05"))
        frames = link.receive(1.0)
    assert [(can_id, data) for _, can_id, data in frames] == [
        (0x123, b"\x01"),
        (0x0CFEF127 | CAN_EFF_FLAG, b"\x04"),
        (0x123, b"\x05"),
    ]
    assert link.counters.received == 3
    assert link.counters.foreign == 3


def test_a_match_for_another_channel_is_not_ours(channel: str, other: Any) -> None:
    elsewhere = IdMatch(0x124, CAN_SFF_MASK, channel="another")
    with Link("virtual", channel, receive=[WANTED, elsewhere]) as link:
        other.send(message(0x124))
        other.send(message(0x123))
        assert [can_id for _, can_id, _ in link.receive(1.0)] == [0x123]


def test_stamps_are_whole_microseconds_as_in_a_written_log(channel: str, other: Any) -> None:
    with Link("virtual", channel, receive=[WANTED]) as link:
        before = time.time()
        other.send(message(0x123))
        ((stamp, _, _),) = link.receive(1.0)
    assert float(f"{stamp:.6f}") == stamp
    assert before - 1e-3 < stamp < time.time() + 1e-3


def test_what_we_send_arrives_elsewhere_and_is_no_conflict(channel: str, other: Any) -> None:
    everything = IdMatch(0, 0)
    with Link("virtual", channel, receive=[everything], own_ids=[OWN]) as link:
        assert link.send(OWN, b"\x0a\x0b")
        assert link.send(0x18FF0001 | CAN_EFF_FLAG, b"\x0c")
        first, second = other.recv(1), other.recv(1)
        assert link.receive(0.02) == []
    assert (first.arbitration_id, bytes(first.data), first.is_extended_id) == (
        OWN,
        b"\n\x0b",
        False,
    )
    assert (second.arbitration_id, second.is_extended_id) == (0x18FF0001, True)
    assert (link.counters.sent, link.counters.conflicts) == (2, 0)


def test_another_sender_of_our_ids_raises_the_alarm_once_and_counts_all(
    channel: str, other: Any
) -> None:
    events: list[LinkEvent] = []
    with Link(
        "virtual", channel, receive=[IdMatch(0, 0)], own_ids=[OWN], on_event=events.append
    ) as link:
        for _ in range(5):
            other.send(message(OWN))
        assert link.receive(0.05) == []  # never handed on, though all ids were asked for
    assert link.counters.conflicts == 5
    assert [event.kind for event in events] == ["up", "conflict"]
    assert "600" in events[1].text


def test_fd_payloads_up_to_64_bytes(channel: str, other: Any) -> None:
    with Link("virtual", channel, receive=[WANTED], fd=True) as link:
        other.send(message(0x123, bytes(range(64)), is_fd=True))
        assert link.receive(1.0)[0][2] == bytes(range(64))
        assert link.send(OWN, bytes(range(48)))
        sent = other.recv(1)
    assert sent.is_fd
    assert bytes(sent.data) == bytes(range(48))


def test_too_long_a_payload_is_refused_and_counted(channel: str) -> None:
    with Link("virtual", channel, receive=[]) as link:
        assert not link.send(OWN, bytes(9))
    assert link.counters.send_errors == {"too_long": 1}


def test_receive_takes_no_longer_than_asked(channel: str) -> None:
    with Link("virtual", channel, receive=[WANTED]) as link:
        start = time.monotonic()
        assert link.receive(0.3) == []
        assert link.receive(0.0) == []
    assert 0.29 < time.monotonic() - start < 0.6


def test_fuzzed_ids_neither_crash_nor_fill_the_memory(channel: str, other: Any) -> None:
    with Link("virtual", channel, receive=[WANTED]) as link:
        for can_id in range(5000):
            other.send(message(can_id * 7919, is_extended_id=True))
        other.send(message(0x123))
        frames = link.receive(1.0)
        while not frames:
            frames = link.receive(1.0)
        assert len(link._id_filter) <= 4096
    assert link.counters.foreign == 5000


@pytest.mark.parametrize(
    ("interface", "name", "words"),
    [
        ("no_such_driver", "x", "no_such_driver"),
        ("virtual", "", "channel is needed"),
    ],
)
def test_what_time_cannot_heal_is_an_error_with_its_reason(
    interface: str, name: str, words: str
) -> None:
    with pytest.raises(LinkError, match=words):
        Link(interface, name, receive=[], wait=True)


def test_an_interface_with_a_name_that_is_no_utf_8_is_asked_by_its_bytes(monkeypatch) -> None:
    asked: list[bytes] = []

    def ioctl(_socket: object, _request: int, what: bytes) -> bytes:
        asked.append(what[:16].rstrip(b"\0"))
        return what[:16] + b"\1" + what[17:]

    monkeypatch.setattr(socketcan.fcntl, "ioctl", ioctl)
    port = object.__new__(SocketCan)  # the kernel here may have no CAN
    port._channel, port._socket = os.fsdecode(b"can\xff"), None  # type: ignore[assignment]
    assert port.is_up()
    assert asked == [b"can\xff"]


def test_kernel_filters_compare_format_and_leave_out_remote_frames() -> None:
    packed = packed_filters([WANTED, WANTED, WANTED_J1939])
    words = [int.from_bytes(packed[i : i + 4], "little") for i in range(0, len(packed), 4)]
    assert words == [0x123, 0xC00007FF, 0x98FEF100, 0xC0FFFF00]  # the flags of linux/can.h
    assert packed_filters([]) == b""
    too_many = [IdMatch(i | CAN_EFF_FLAG, CAN_EFF_MASK) for i in range(MAX_FILTERS + 1)]
    assert packed_filters(too_many) == bytes(8)  # everything; the link sorts


# ---- a port that fails as told ----------------------------------------------------------------


class Faulty:
    """An interface whose next outcomes are written down; a clock that only waiting moves."""

    def __init__(self) -> None:
        self.lost = 0
        self.receive_buffer = 0
        self.rejected, self.why_rejected = 0, ""
        self.now = 0.0
        self.there = True
        self.up = True
        self.closed = False
        self.send_error: int | None = None
        self.incoming: list[Any] = []  # batches of frames, or an errno
        self.taken: list[tuple[float, int, bytes]] = []

    def clock(self) -> float:
        self.now += 1e-6
        return self.now

    def fileno(self) -> int | None:
        return None

    def close(self) -> None:
        self.closed = True

    def give_up(self) -> None:
        self.lost += sum(len(batch) for batch in self.incoming if not isinstance(batch, int))
        self.incoming = []

    def receive(self, timeout: float) -> list[Any]:
        if not self.incoming:
            self.now += timeout
            return []
        next_one = self.incoming.pop(0)
        if isinstance(next_one, int):
            raise OSError(next_one, "told so")
        return list(next_one)

    def send(self, can_id: int, data: bytes) -> None:
        if self.send_error is not None:
            raise OSError(self.send_error, "told so")
        self.taken.append((self.now, can_id, data))

    def is_same_interface(self) -> bool:
        return self.there

    def is_up(self) -> bool:
        return self.up


@pytest.fixture
def faulty_link(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    def make(**options: Any) -> tuple[Link, Faulty, list[str]]:
        port, kinds = Faulty(), []

        def open_again(_link: Link) -> Faulty:
            if not port.there:
                raise OSError(errno.ENODEV, "No such device")
            return port

        def sleep(seconds: float) -> None:
            port.now += seconds + 1e-6

        monkeypatch.setattr(Link, "_new_port", open_again)
        monkeypatch.setattr("imucald.can.link.link.time.sleep", sleep)
        link = Link(
            "socketcan",
            "can0",
            receive=[WANTED],
            own_ids=[OWN],
            clock=port.clock,
            on_event=lambda event: kinds.append(event.kind),
            **options,
        )
        return link, port, kinds

    return make


FRAME = (1.0, 0x123, b"\x01")


def test_a_quick_down_and_up_is_counted_and_loses_nothing(faulty_link: Any) -> None:
    link, port, kinds = faulty_link()
    port.incoming = [errno.ENETDOWN, [FRAME]]
    assert link.receive(1.0) == [FRAME]
    assert kinds == ["up", "down", "up"]
    assert (link.counters.went_down, link.counters.reopened) == (1, 0)


def test_down_for_a_while_then_up(faulty_link: Any) -> None:
    link, port, kinds = faulty_link()
    port.incoming, port.up = [errno.ENETDOWN], False
    assert link.receive(1.0) == []
    assert link.state is LinkState.DOWN
    port.up = True
    assert link.receive(0.5) == []
    assert link.state is LinkState.UP
    assert kinds == ["up", "down", "up"]


def test_frames_queued_before_the_loss_do_not_pretend_that_it_is_up(faulty_link: Any) -> None:
    link, port, _ = faulty_link()
    port.incoming, port.up = [errno.ENETDOWN, [FRAME]], False
    assert link.receive(1.0) == [FRAME]
    assert link.state is LinkState.DOWN


def test_a_deleted_interface_is_opened_again_within_half_a_second(faulty_link: Any) -> None:
    link, port, kinds = faulty_link()
    port.incoming, port.there = [errno.ENODEV], False
    assert link.receive(20.0) == []
    assert link.state is LinkState.ABSENT
    assert port.closed
    assert link.fileno() is None
    port.there, start = True, port.now
    port.incoming = [[FRAME]]
    assert link.receive(20.0) == [FRAME]
    assert port.now - start < 0.5
    assert kinds == ["up", "absent", "up"]
    assert link.counters.reopened == 1


def test_a_silently_replaced_interface_is_noticed_by_its_silence(faulty_link: Any) -> None:
    link, port, kinds = faulty_link()
    link.receive(1.0)
    port.there = False  # the kernel says nothing on this socket any more
    assert link.receive(0.5) == []
    assert kinds == ["up", "absent"]


def test_it_says_whether_it_took_all_that_waited(faulty_link: Any) -> None:
    link, port, _ = faulty_link()
    port.incoming = [[FRAME] * MAX_BATCH, [FRAME] * 3, errno.ENETDOWN]
    assert len(link.receive(1.0)) == MAX_BATCH
    assert not link.is_empty
    link.receive(1.0)
    assert link.is_empty
    link.receive(0.0)
    assert not link.is_empty, "an error may come before frames that wait"
    link.receive(0.5)
    assert link.is_empty


def test_losses_add_up_over_reopened_sockets(faulty_link: Any) -> None:
    link, port, kinds = faulty_link()
    port.lost, port.incoming = 7, [[FRAME], errno.ENODEV]
    link.receive(1.0)
    link.receive(0.1)
    port.lost = 2  # a new socket counts from zero
    port.incoming = [[FRAME]]
    link.receive(1.0)
    assert link.counters.lost == 9
    assert kinds.count("lost") == 1  # told seldom


def test_frames_that_waited_when_the_interface_went_are_lost_and_counted(faulty_link: Any) -> None:
    link, port, _ = faulty_link()
    port.there, port.incoming = False, [errno.ENODEV, [FRAME] * 5]
    assert link.receive(0.1) == []
    assert link.state is LinkState.ABSENT
    assert link.counters.lost == 5


def test_bus_off_is_a_state_until_the_restart(faulty_link: Any) -> None:
    link, port, kinds = faulty_link()
    port.incoming = [[(1.0, 0x20000040, bytes(8))]]
    assert link.receive(0.1) == []
    assert link.state is LinkState.BUS_OFF
    port.incoming = [[(2.0, 0x20000100, bytes(8))]]
    link.receive(0.1)
    assert kinds == ["up", "bus_off", "up"]
    assert (link.counters.bus_off, link.counters.error_frames) == (1, 2)


def test_a_frame_heard_ends_bus_off_where_the_driver_is_silent(faulty_link: Any) -> None:
    link, port, _ = faulty_link()
    port.incoming = [[(1.0, 0x20000040, bytes(8))], [FRAME]]
    assert link.receive(0.1) == [FRAME]
    assert link.state is LinkState.UP


@pytest.mark.parametrize(
    ("number", "reason", "state"),
    [
        (errno.ENETDOWN, "down", LinkState.DOWN),
        (errno.ENODEV, "absent", LinkState.ABSENT),
        (errno.ENXIO, "absent", LinkState.ABSENT),
        (errno.EINVAL, "refused", LinkState.UP),
        (errno.EIO, "adapter", LinkState.UP),
    ],
)
def test_what_cannot_be_sent_is_counted_by_reason(
    faulty_link: Any, number: int, reason: str, state: LinkState
) -> None:
    link, port, _ = faulty_link()
    port.send_error, port.up = number, state is not LinkState.DOWN
    assert not link.send(OWN, b"\x01")
    assert link.counters.send_errors == {reason: 1}
    assert link.state is state


def test_a_burst_into_a_full_queue_is_sent_a_little_later_in_order(faulty_link: Any) -> None:
    link, port, kinds = faulty_link()
    port.send_error = errno.ENOBUFS
    assert all(link.send(OWN, bytes([i])) for i in range(10))
    port.send_error = None
    link.receive(0.01)
    assert [data[0] for _, _, data in port.taken] == list(range(10))
    assert (link.counters.sent, link.counters.send_errors, kinds) == (10, {}, ["up"])


def test_a_queue_that_stays_full_costs_frames_not_time(faulty_link: Any) -> None:
    link, port, kinds = faulty_link()
    port.send_error = errno.ENOBUFS
    for i in range(100):
        link.send(OWN, bytes([i]))
    assert link.counters.send_errors == {"queue_full": 100 - HELD_FRAMES}
    assert kinds == ["up", "queue_full"]
    assert port.now < 0.01
    link.receive(2 * MAX_HOLD)
    port.send_error = None
    link.receive(0.01)
    assert port.taken == []  # a stale sample is worth nothing
    assert link.counters.send_errors == {"queue_full": 100}


def test_a_frame_behind_held_ones_does_not_overtake_them() -> None:
    port, sent = Faulty(), []
    outbox = Outbox(port.clock, lambda: sent.append(1), lambda: None)
    port.send_error = errno.EAGAIN
    outbox.send(port, 1, b"")
    port.send_error = None
    outbox.send(port, 2, b"")
    assert [can_id for _, can_id, _ in port.taken] == [1, 2]
    assert len(outbox) == 0
    assert len(sent) == 2


def test_sending_without_an_interface_is_counted(faulty_link: Any) -> None:
    link, port, _ = faulty_link()
    port.send_error = errno.ENOBUFS
    link.send(OWN, b"\x01")  # held when the interface goes
    port.incoming, port.there = [errno.ENODEV], False
    link.receive(0.1)
    assert not link.send(OWN, b"\x02")
    assert link.counters.send_errors == {"absent": 2}
