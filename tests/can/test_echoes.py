"""Frames that a bus hands back to their sender are not another node's."""

from __future__ import annotations

import socket
import time

import pytest

from imucald.can.columns import IdMatch
from imucald.can.link.adapter import ECHO_S, Echoes
from imucald.can.link.link import Link
from imucald.can.python_can import can

OURS, THEIRS = 0x640, 0x200
PORT = 43117


class Clock:
    def __init__(self) -> None:
        self.now = 5.0

    def __call__(self) -> float:
        return self.now


def test_each_frame_that_was_sent_is_taken_back_once() -> None:
    echoes = Echoes(Clock())
    echoes.sent(OURS, b"\x01")
    echoes.sent(OURS, b"\x02")
    assert echoes.is_own(OURS, b"\x02")
    assert not echoes.is_own(OURS, b"\x02")
    assert not echoes.is_own(THEIRS, b"\x01")
    assert echoes.is_own(OURS, b"\x01")


def test_what_comes_much_later_is_not_an_echo() -> None:
    clock = Clock()
    echoes = Echoes(clock)
    echoes.sent(OURS, b"\x01")
    clock.now += 1.01 * ECHO_S
    assert not echoes.is_own(OURS, b"\x01")


def multicast(port: int) -> can.BusABC:
    return can.Bus(interface="udp_multicast", channel="239.74.163.2", port=port)


@pytest.fixture(scope="module")
def has_multicast() -> None:
    pytest.importorskip("msgpack")
    try:
        with multicast(PORT) as one, multicast(PORT) as two:
            one.send(can.Message(arbitration_id=1, data=b"x", is_extended_id=False))
            if two.recv(1.0) is None:
                pytest.skip("multicast does not come back here")
    except (OSError, can.CanError, socket.gaierror):
        pytest.skip("no multicast here")


@pytest.mark.usefixtures("has_multicast")
def test_on_multicast_only_another_sender_is_a_conflict() -> None:
    with (
        Link(
            "udp_multicast",
            "239.74.163.2",
            receive=[IdMatch(THEIRS, 0x7FF)],
            own_ids=[OURS],
            options={"port": PORT + 1},
        ) as link,
        multicast(PORT + 1) as other,
    ):

        def drain() -> int:
            end, n = time.monotonic() + 0.3, 0
            while time.monotonic() < end:
                n += len(link.receive(0.05))
            return n

        for i in range(20):
            assert link.send(OURS, bytes([i] * 8))
        drain()
        assert link.counters.conflicts == 0
        other.send(can.Message(arbitration_id=THEIRS, data=b"12", is_extended_id=False))
        assert drain() == 1
        other.send(can.Message(arbitration_id=OURS, data=bytes(8 * [99]), is_extended_id=False))
        drain()
        assert link.counters.conflicts == 1
