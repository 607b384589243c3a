"""A broker that sends more than an acknowledgement, or reads nothing, or drops its connections."""

from __future__ import annotations

import contextlib
import socket
import time
import tracemalloc
from collections.abc import Iterator

import pytest

from feed_bench import wait_until
from imucald.feeds.daemon_source import Reading
from imucald.feeds.mqtt import MqttReceiver, MqttSettings
from threads import in_a_thread

QOS_2 = b"".join(
    b"\x34\x84\x06\x00\x01t" + mid.to_bytes(2, "big") + bytes(767) for mid in range(1, 1000)
)
"""Messages that a client keeps until they are released: a broker need not ever."""
NOT_UNDERSTOOD = b"\xf0\x00"
CONNACK = b"\x20\x02\x00\x00"
LONG = b"\x30\xff\xff\xff\x7f"
"""Head of a PUBLISH of 256 MiB, the longest that there is."""


class Broker:
    """Takes connections and answers each with what it was given."""

    def __init__(self, answer: bytes, more: bytes) -> None:
        self.server = socket.create_server(("127.0.0.1", 0))
        self.port = self.server.getsockname()[1]
        self.connections = 0
        self._answer, self._more = answer, more

    def run(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self.server.accept()
                self.connections += 1
                with connection, contextlib.suppress(OSError):
                    connection.settimeout(2.0)
                    connection.recv(1000)
                    connection.sendall(self._answer)
                    for _ in range(64 if self._more else 0):
                        connection.sendall(self._more)
                    while connection.recv(1000):
                        pass

    def stop(self) -> None:
        self.server.shutdown(socket.SHUT_RDWR)
        self.server.close()


@pytest.fixture
def said() -> list[str]:
    return []


@contextlib.contextmanager
def fed_by(broker: Broker, said: list[str]) -> Iterator[MqttReceiver]:
    receiver = MqttReceiver(MqttSettings("127.0.0.1", broker.port, "car"), said.append)
    with in_a_thread(broker.run, broker.stop):
        receiver.connect()
        try:
            yield receiver
        finally:
            receiver.close()


@pytest.mark.parametrize("is_after_connack", [True, False])
def test_a_long_packet_ends_the_connection_before_it_is_held(said, is_after_connack):
    broker = Broker((CONNACK if is_after_connack else b"") + LONG, b"x" * (1 << 20))
    tracemalloc.start()
    try:
        with fed_by(broker, said):
            wait_until(lambda: broker.connections >= 2)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 16 << 20
    assert any("closed" in text or "reached" in text for text in said)


def test_an_acknowledgement_is_taken(said):
    broker = Broker(CONNACK, b"")
    with fed_by(broker, said) as receiver:
        wait_until(receiver._client.is_connected)
        assert broker.connections == 1


def test_messages_that_would_be_kept_end_the_connection(said):
    broker = Broker(CONNACK + QOS_2, b"")
    with fed_by(broker, said) as receiver:
        wait_until(lambda: broker.connections >= 2)
        assert not receiver._client._in_messages


@pytest.mark.parametrize("packet", [b"\x90\x00", b"\x40\x01\x00", b"\x50\x00", NOT_UNDERSTOOD])
def test_a_packet_that_cannot_be_taken_apart_ends_the_connection_and_not_the_feed(said, packet):
    broker = Broker(CONNACK + packet, b"")
    with fed_by(broker, said):
        wait_until(lambda: broker.connections >= 2)


def test_a_broker_that_drops_its_connections_is_tried_ever_more_seldom(said):
    broker = Broker(CONNACK + NOT_UNDERSTOOD, b"")
    began = time.monotonic()
    with fed_by(broker, said):
        wait_until(lambda: broker.connections >= 4, 20.0)
    assert time.monotonic() - began > 1.0 + 2.0 + 4.0 - 0.5


def test_a_broker_that_does_not_read_for_a_while_gets_few_old_values(said):
    """20,000 readings while it does not read; then those that waited."""
    server = socket.create_server(("127.0.0.1", 0))
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 14)
    port = server.getsockname()[1]
    receiver = MqttReceiver(MqttSettings("127.0.0.1", port, "car"), said.append)
    receiver.connect()
    with server, server.accept()[0] as connection:
        connection.recv(1000)
        connection.sendall(CONNACK)
        wait_until(receiver._client.is_connected)
        for i in range(20_000):
            reading = Reading(float(i), None, False, {"acceleration": (1.0, 2.0, 3.0)})
            receiver.publish(reading)
        connection.settimeout(0.5)
        got = b""
        with contextlib.suppress(TimeoutError):
            while part := connection.recv(1 << 16):
                got += part
    receiver.close()
    assert 1 < got.count(b'"at"') < 2000
