"""The bus link on a python-can adapter that fails: pulled out, refusing, plugged in again."""

from __future__ import annotations

import math
import os
import select
import socket
import sys
import time
import types
from typing import Any

import pytest

from imucald.can.columns import CAN_EFF_FLAG, CAN_SFF_MASK, IdMatch
from imucald.can.link.adapter import FAILING_S, MAX_FAILURES, Adapter
from imucald.can.link.link import Link, LinkEvent, LinkState
from imucald.can.python_can import can
from imucald.core.errors import LinkError

MATCHES = [IdMatch(0x123, CAN_SFF_MASK), IdMatch(0x18FEF100 | CAN_EFF_FLAG, 0x00FFFF00)]


class Plug:
    """A USB adapter as python-can shows it; `can.Bus` opens it while it is plugged in."""

    def __init__(self) -> None:
        self.there = True
        self.queue: list[Any] = []
        self.opened_with: list[dict[str, Any]] = []
        self.send_fails: Exception | None = None
        self.open_fails: Exception = can.CanInitializationError("no device")
        self.shutdown_fails: Exception = can.CanOperationError("device gone")

    def open(self, **arguments: Any) -> Plug:
        self.opened_with.append(arguments)
        if not self.there:
            raise self.open_fails
        return self

    def recv(self, timeout: float) -> Any:
        if not self.there:
            raise can.CanOperationError("device gone")
        if not self.queue:
            time.sleep(timeout)
            return None
        next_one = self.queue.pop(0)
        if isinstance(next_one, Exception):
            raise next_one
        return next_one

    def send(self, message: Any, timeout: float) -> None:
        if self.send_fails is not None:
            raise self.send_fails

    def fileno(self) -> int:
        raise NotImplementedError

    def shutdown(self) -> None:
        raise self.shutdown_fails


@pytest.fixture
def plug(monkeypatch: pytest.MonkeyPatch) -> Plug:
    adapter = Plug()
    monkeypatch.setattr(can, "Bus", adapter.open)
    return adapter


def test_the_driver_gets_filters_bit_rate_and_options(plug: Plug) -> None:
    options = {"serial": "X1"}
    with Link("kvaser", "0", receive=MATCHES, own_ids=[0x600], bitrate=500_000, options=options):
        pass
    (arguments,) = plug.opened_with
    assert arguments.pop("can_filters") == [
        {"can_id": 0x123, "can_mask": 0x7FF, "extended": False},
        {"can_id": 0x18FEF100, "can_mask": 0x00FFFF00, "extended": True},
        {"can_id": 0x600, "can_mask": 0x7FF, "extended": False},
    ]
    assert arguments == {"interface": "kvaser", "channel": "0", "bitrate": 500_000, "serial": "X1"}


def test_pulled_out_and_plugged_in_again(plug: Plug) -> None:
    kinds: list[str] = []
    link = Link("kvaser", "0", receive=MATCHES, on_event=lambda event: kinds.append(event.kind))
    plug.there = False
    assert link.receive(0.5) == []
    assert link.state is LinkState.ABSENT
    assert not link.send(0x600, b"")
    plug.there = True
    plug.queue = [can.Message(arbitration_id=0x123, data=b"\x01", is_extended_id=False)]
    start = time.monotonic()
    assert [data for _, _, data in link.receive(2.0)] == [b"\x01"]
    assert time.monotonic() - start < 1.0
    assert kinds == ["up", "absent", "up"]
    assert link.counters.reopened == 1


def test_frames_taken_before_the_failure_are_kept(plug: Plug) -> None:
    class Pulled(list[Any]):
        def pop(self, index: Any = -1) -> Any:
            plug.there = len(self) > 1
            return super().pop(index)

    link = Link("kvaser", "0", receive=MATCHES)
    plug.queue = Pulled(
        [can.Message(arbitration_id=0x123, data=bytes([i]), is_extended_id=False) for i in (1, 2)]
    )
    assert [data for _, _, data in link.receive(0.1)] == [b"\x01", b"\x02"]
    assert link.receive(0.5) == []
    assert link.state is LinkState.ABSENT


def test_echoes_of_our_own_frames_are_neither_input_nor_conflict(plug: Plug) -> None:
    link = Link("kvaser", "0", receive=MATCHES, own_ids=[0x600])
    plug.queue = [
        can.Message(arbitration_id=can_id, is_extended_id=False, is_rx=False)
        for can_id in (0x123, 0x600)
    ]
    assert link.receive(0.05) == []
    assert link.counters.conflicts == 0


def test_error_frames_of_an_adapter_tell_of_bus_off(plug: Plug) -> None:
    link = Link("kvaser", "0", receive=MATCHES)
    plug.queue = [can.Message(arbitration_id=0x40, is_error_frame=True, is_extended_id=False)]
    link.receive(0.05)
    assert link.state is LinkState.BUS_OFF


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("queue full"),
        OSError("write failed"),
        ValueError("length"),
        TypeError("a driver"),
    ],
)
def test_a_refused_frame_is_counted_and_the_adapter_kept(plug: Plug, error: Exception) -> None:
    link = Link("kvaser", "0", receive=MATCHES)
    plug.send_fails = error
    assert not link.send(0x600, b"\x01")
    assert link.counters.send_errors == {"adapter": 1}
    assert link.state is LinkState.UP


def test_not_plugged_in_at_the_start(plug: Plug) -> None:
    plug.there = False
    with pytest.raises(LinkError, match=r"no device\. Is the adapter plugged in"):
        Link("kvaser", "0", receive=MATCHES)
    link = Link("kvaser", "0", receive=MATCHES, wait=True)
    assert link.state is LinkState.ABSENT


def good(value: int = 1) -> Any:
    return can.Message(arbitration_id=0x123, data=bytes([value]), is_extended_id=False)


def changed(**attributes: Any) -> Any:
    """A message as a driver may hand it out: python-can does not look at it."""
    message = good(9)
    for name, value in attributes.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    "message",
    [
        changed(arbitration_id=0x123 * 1.0),
        changed(arbitration_id="123"),
        changed(arbitration_id=True),
        changed(arbitration_id=None),
        changed(arbitration_id=-1),
        changed(arbitration_id=0x923),  # the mask of 11 bits takes it for 0x123
        changed(arbitration_id=1 << 29, is_extended_id=True),
        changed(arbitration_id=1 << 29, is_error_frame=True),
        changed(arbitration_id=291.0, is_remote_frame=True),
        changed(data=None),
        changed(data=[1, 2]),
        changed(data="ab"),
        changed(data=7),
        changed(data=bytearray(65)),
        changed(timestamp=math.nan),
        changed(timestamp=math.inf),
        changed(timestamp=-1.0),
        changed(timestamp=1e300),
        changed(timestamp=10**400),
        changed(timestamp="now"),
        changed(timestamp=[1.0]),
        "no message at all",
    ],
    ids=lambda m: repr(m)[:60] if isinstance(m, str) else None,
)
def test_a_frame_that_makes_no_sense_is_rejected_and_the_link_stays_open(
    plug: Plug, message: Any
) -> None:
    events: list[LinkEvent] = []
    link = Link("kvaser", "0", receive=MATCHES, own_ids=[0x600], on_event=events.append)
    plug.queue = [good(1), message, good(2)]
    assert [data for _, _, data in link.receive(0.1)] == [b"\x01", b"\x02"]
    assert (link.counters.rejected, link.counters.reopened) == (1, 0)
    assert [event.kind for event in events] == ["up", "rejected"]
    assert len(plug.opened_with) == 1


@pytest.mark.parametrize(
    "error",
    [
        can.CanOperationError("could not unpack received message"),
        ValueError("invalid literal for int() with base 16: '2Z1'"),
        TypeError("unsupported operand type(s) for ^: 'int' and 'float'"),
        IndexError("bytearray index out of range"),
        OSError(),
    ],
    ids=lambda e: type(e).__name__,
)
def test_a_record_that_the_driver_does_not_understand_is_rejected_and_the_link_stays_open(
    plug: Plug, error: Exception
) -> None:
    events: list[LinkEvent] = []
    link = Link("slcan", "0", receive=MATCHES, on_event=events.append)
    for _ in range(20):
        plug.queue = [good(1), error, error, good(2), error]
        assert [data for _, _, data in link.receive(0.01)] == [b"\x01", b"\x02"]
    assert link.receive(0.01) == []
    assert (link.counters.rejected, link.counters.reopened) == (60, 0)
    assert [event.kind for event in events] == ["up", "rejected"]
    assert (str(error) or type(error).__name__) in events[1].text


def test_a_silent_bus_is_no_reason_to_reopen_for_a_damaged_record_now_and_then(plug: Plug) -> None:
    link = Link("slcan", "0", receive=MATCHES)
    end = time.monotonic() + 2.0 * FAILING_S
    sent = 0
    while time.monotonic() < end:
        plug.queue = [ValueError("damaged")] * (MAX_FAILURES + 8)
        sent += len(plug.queue)
        while plug.queue:  # on a busy machine the time is over before the queue is empty
            assert link.receive(0.01) == []
        assert link.receive(0.01) == []
    assert (link.counters.rejected, link.counters.reopened) == (sent, 0)


def test_a_driver_that_only_fails_is_closed_and_opened_again_and_takes_no_core(plug: Plug) -> None:
    class Failing(list[Any]):
        def pop(self, index: Any = -1) -> Any:
            return ValueError("dead")

    link = Link("slcan", "0", receive=MATCHES)
    plug.queue = Failing([0])
    began, processor = time.monotonic(), time.process_time()
    while not link.counters.reopened:
        assert link.receive(0.05) == []
        assert time.monotonic() - began < 2.0
    assert time.monotonic() - began > 0.9 * FAILING_S
    assert time.process_time() - processor < 0.7 * FAILING_S
    assert link.counters.rejected == 0, "they were no frames"
    plug.queue = [good(1)]
    assert [data for _, _, data in link.receive(1.0)] == [b"\x01"]


@pytest.mark.parametrize("error", [can.CanError("x"), RuntimeError("x"), AttributeError("x")])
def test_whatever_closing_and_opening_raise_the_link_heals(plug: Plug, error: Exception) -> None:
    link = Link("kvaser", "0", receive=MATCHES)
    plug.there, plug.open_fails, plug.shutdown_fails = False, error, error
    link.receive(0.5)
    assert link.state is LinkState.ABSENT
    plug.there, plug.queue = True, [good(1)]
    assert [data for _, _, data in link.receive(1.0)] == [b"\x01"]
    link.close()


def test_a_damaged_record_of_a_serial_adapter(monkeypatch: pytest.MonkeyPatch) -> None:
    """python-can's own slcan; pyserial is replaced by what only hands out bytes."""
    line = bytearray(b"t2012AABB\r")

    class Timeout:
        def __init__(self, seconds: float) -> None:
            self._end = time.monotonic() + (seconds or 0.0)

        def expired(self) -> bool:
            return time.monotonic() >= self._end

    class Port:
        in_waiting = property(lambda _: len(line))

        def read(self, size: int) -> bytes:
            part = bytes(line[:size])
            del line[:size]
            return part

        def write(self, data: bytes) -> int:
            return len(data)

        def fileno(self) -> int:
            raise NotImplementedError

        def flush(self) -> None: ...

        reset_input_buffer = close = flush

    serial = types.ModuleType("serial")
    serial.SerialException, serial.Timeout = OSError, Timeout  # type: ignore[attr-defined]
    serial.serial_for_url = lambda *_, **__: Port()  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "serial", serial)
    monkeypatch.delitem(sys.modules, "can.interfaces.slcan", raising=False)
    options = {"sleep_after_open": 0.0}
    matches = [IdMatch(0x201, CAN_SFF_MASK)]
    with Link("slcan", "/dev/ttyUSB0", receive=matches, options=options) as link:
        assert len(link.receive(0.1)) == 1
        line += b"t2Z12AABB\rt2012AACC\r"
        assert [data for _, _, data in link.receive(0.1)] == [b"\xaa\xcc"]
        assert (link.counters.rejected, link.counters.reopened) == (1, 0)
    monkeypatch.delitem(sys.modules, "can.interfaces.slcan", raising=False)


SOUND = {
    **dict.fromkeys(("is_extended_id", "is_remote_frame", "is_error_frame"), False),
    **dict.fromkeys(("is_fd", "bitrate_switch", "error_state_indicator"), False),
    **{"timestamp": 1.0, "arbitration_id": 0x201, "channel": None, "dlc": 2, "data": b"ab"},
}
"""A frame as python-can puts it into a datagram."""


def test_datagrams_that_are_no_frames_neither_end_nor_reopen_a_multicast_bus() -> None:
    msgpack = pytest.importorskip("msgpack")
    group = "239.74.163.77"
    hostile = [
        msgpack.packb(SOUND | change)
        for change in (
            {"arbitration_id": 513.0},
            {"arbitration_id": 513.0, "is_remote_frame": True},
            {"data": [300, 2]},
            {"dlc": 3},
            {"data": "ab"},
        )
    ]
    try:
        link = Link("udp_multicast", group, receive=[IdMatch(0x201, CAN_SFF_MASK)])
    except LinkError as error:
        pytest.skip(f"no multicast here: {error}")
    with link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        for datagram in (*hostile, b"junk", b"", msgpack.packb(SOUND)):
            out.sendto(datagram, (group, 43113))
        end, frames = time.monotonic() + 2.0, []
        while not frames and time.monotonic() < end:
            frames = link.receive(0.1)
        if not frames and not link.counters.rejected:
            pytest.skip("multicast does not come back here")
        assert [data for _, _, data in frames] == [b"ab"]
        assert link.counters.rejected >= len(hostile)
        assert (link.counters.reopened, link.state) == (0, LinkState.UP)


@pytest.mark.skipif(sys.platform != "linux", reason="what Linux does with groups of one port")
def test_a_multicast_group_does_not_hear_another_one_on_its_port() -> None:
    msgpack = pytest.importorskip("msgpack")
    other, group = f"239.211.19.{os.getpid() % 250}", f"239.74.163.{os.getpid() % 250}"
    wanted = [IdMatch(0x201, CAN_SFF_MASK)]
    try:
        links = [Link("udp_multicast", name, receive=wanted) for name in (other, group)]
    except LinkError as error:
        pytest.skip(f"no multicast here: {error}")
    frame = msgpack.packb(SOUND)
    with links[0] as there, links[1] as here, socket.socket(type=socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        out.sendto(frame, (other, 43113))
        if not there.receive(2.0):
            pytest.skip("multicast does not come back here")
        assert here.receive(0.3) == []
        out.sendto(frame, (group, 43113))
        assert len(here.receive(2.0)) == 1


@pytest.mark.skipif(sys.platform != "linux", reason="what Linux does with groups of one port")
def test_a_multicast_group_drops_what_another_one_sent_while_it_was_opened(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    msgpack = pytest.importorskip("msgpack")
    other, group = f"239.211.20.{os.getpid() % 250}", f"239.74.164.{os.getpid() % 250}"
    wanted = [IdMatch(0x201, CAN_SFF_MASK)]
    frame, opened = msgpack.packb(SOUND), can.Bus

    def bus_that_hears_another_group(**arguments: Any) -> can.BusABC:
        bus = opened(**arguments)
        out.sendto(frame, (other, 43113))
        select.select([bus.fileno()], [], [], 2.0)
        return bus

    try:
        there = Link("udp_multicast", other, receive=wanted)
    except LinkError as error:
        pytest.skip(f"no multicast here: {error}")
    with there, socket.socket(type=socket.SOCK_DGRAM) as out:
        out.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        monkeypatch.setattr(can, "Bus", bus_that_hears_another_group)
        with Link("udp_multicast", group, receive=wanted) as here:
            if not there.receive(2.0):
                pytest.skip("multicast does not come back here")
            assert here.receive(0.3) == []
            out.sendto(frame, (group, 43113))
            assert len(here.receive(2.0)) == 1


def test_a_descriptor_is_none_whatever_a_driver_that_has_gone_raises(
    plug: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fileno(_: Plug) -> int:
        raise RuntimeError("gone")

    monkeypatch.setattr(Plug, "fileno", fileno)
    assert Adapter("kvaser", "0", MATCHES).fileno() is None


def test_an_interface_that_python_can_does_not_know_is_named_with_those_it_has() -> None:
    with pytest.raises(LinkError, match=r"did you mean 'virtual'\?.*python-can has .*socketcan"):
        Adapter("virtaul", "here", MATCHES)
