"""A running daemon with a calibrated mount on a virtual bus, and frames for it."""

from __future__ import annotations

import random
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import can

from imucald.feeds.daemon_source import DaemonSource
from imucald.feeds.feed_loop import Feed
from imucald.service.service import Service
from service_bench import Bench, running
from threads import in_a_thread

AHEAD = 1.5
"""Acceleration of the vehicle [m/s^2], as a sensor at yaw 25 deg feels it."""
NOISE = 0.01
"""Of each axis [m/s^2]."""


def sensor_frame(noise: random.Random, ahead: float = AHEAD) -> bytes:
    """Accelerometer frame of a level sensor at yaw 25 deg in a vehicle that accelerates [m/s^2].

    With the noise of a real one: the daemon takes a sensor without any for a stuck one.
    """
    force = (0.90630779 * ahead, -0.42261826 * ahead, 9.80665)
    return struct.pack("<4h", *(round(noise.gauss(one, NOISE) / 0.002) for one in force), 0)


@contextmanager
def calibrated(folder: Path) -> Iterator[tuple[Bench, Service]]:
    bench = Bench(folder)
    service = bench.service()
    bench.drive(service)
    service.orders.hold("the test")
    with running(service):
        yield bench, service


@contextmanager
def traffic(channel: str, rate: float = 100.0, ahead: float = AHEAD) -> Iterator[threading.Event]:
    """Sensor frames without end; setting the event makes the sensor silent."""
    silent, ended = threading.Event(), threading.Event()

    def send() -> None:
        noise = random.Random(1)
        with can.Bus(interface="virtual", channel=channel) as bus:
            while not ended.wait(1.0 / rate):
                if not silent.is_set():
                    data = sensor_frame(noise, ahead)
                    bus.send(can.Message(arbitration_id=0x200, data=data, is_extended_id=False))

    thread = threading.Thread(target=send)
    thread.start()
    try:
        yield silent
    finally:
        ended.set()
        thread.join()


def source_of(service: Service, messages: list[str]) -> DaemonSource:
    path = service.options.status_socket
    assert path is not None
    return DaemonSource(path, messages.append)


def wait_until(condition: Callable[[], object], limit: float = 10.0) -> None:
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.02)


@contextmanager
def fed(feed: Feed) -> Iterator[None]:
    def stop() -> None:
        feed.stopping = True

    with in_a_thread(feed.run, stop, limit=10.0):
        yield
