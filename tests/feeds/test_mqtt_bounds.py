"""A broker that sends more than an acknowledgement: its connection ends, no memory is taken."""

from __future__ import annotations

import contextlib
import socket
import tracemalloc
from collections.abc import Iterator

import pytest

from feed_bench import wait_until
from imucald.feeds.mqtt import MqttReceiver, MqttSettings
from threads import in_a_thread

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
    assert any("gone" in text or "reached" in text for text in said)


def test_an_acknowledgement_is_taken(said):
    broker = Broker(CONNACK, b"")
    with fed_by(broker, said) as receiver:
        wait_until(receiver._client.is_connected)
        assert broker.connections == 1
