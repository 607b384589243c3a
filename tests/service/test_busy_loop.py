"""A loop that is behind: the watchdog and whoever asks hear from it within a batch of frames."""

from __future__ import annotations

import contextlib
import itertools
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest

import shuttle
from imucald.core.errors import LinkError
from imucald.service.asking import ask
from imucald.service.journal import Journal
from imucald.service.line_server import BACKLOG
from imucald.service.notify import Notifier
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service
from imucald.service.status import StatusServer

LEVEL = bytes.fromhex("0000000027130000")
BATCH = 1024
FRAME_S = 0.005
"""As long as a frame takes in an emulated machine under load."""
WATCHDOG_S = 3.0


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


class Heard(Notifier):
    """Notes when the watchdog is fed."""

    def __init__(self, clock: Clock) -> None:
        super().__init__({})
        self.clock = clock
        self.times = [clock()]

    def feed(self) -> None:
        self.times.append(self.clock())


def test_the_watchdog_is_fed_within_a_batch_and_chores_are_not_starved(tmp_path: Path):
    clock = Clock()
    heard = Heard(clock)
    options = ServiceOptions(shuttle.write(tmp_path, cycles=1), interface="virtual", channel="busy")
    service = Service(options, Journal(), heard, clock)
    frames = [(1.6e9 + 0.01 * i, 0x200, LEVEL) for i in range(BATCH)]
    seconds: list[float] = []
    handle = service.engine.frame

    def slow(*frame: Any):
        clock.now += FRAME_S
        return handle(*frame)

    service.engine.frame = slow  # type: ignore[method-assign]
    service.link.receive = lambda _: frames  # type: ignore[method-assign, assignment]
    service._every_second = seconds.append  # type: ignore[method-assign]
    service.run(3 * BATCH * FRAME_S)
    service.close()
    gaps = [b - a for a, b in itertools.pairwise(heard.times)]
    assert BATCH * FRAME_S > WATCHDOG_S, "a batch takes longer than the watchdog waits"
    assert max(gaps) < WATCHDOG_S / 4
    assert len(seconds) >= 3


def test_whoever_asks_while_all_places_are_taken_waits_for_one(tmp_path: Path):
    server = StatusServer(tmp_path / "s", lambda: {"state": "fine"})
    waiting = []
    for _ in range(2 * BACKLOG):
        client = socket.socket(socket.AF_UNIX)
        client.setblocking(False)
        waiting.append(client)
        try:
            client.connect(str(server.path))
        except BlockingIOError:
            break
    else:
        raise AssertionError("the queue is not full: this proves nothing")
    ended = threading.Event()

    def serve() -> None:
        time.sleep(0.3)
        while not ended.wait(0.01):
            server.poll()

    loop = threading.Thread(target=serve)
    loop.start()
    for client in waiting[:-1]:
        client.close()
    try:
        assert ask(server.path, "status") == '{"state": "fine"}\n'
    finally:
        ended.set()
        loop.join()
        server.close()
        waiting[-1].close()


def test_a_queue_that_stays_full_is_reported_in_the_end(tmp_path: Path):
    server = StatusServer(tmp_path / "s", dict)
    waiting = []
    for _ in range(2 * BACKLOG):
        client = socket.socket(socket.AF_UNIX)
        client.setblocking(False)
        waiting.append(client)
        with contextlib.suppress(BlockingIOError):
            client.connect(str(server.path))
    with pytest.raises(LinkError, match="did not answer"):
        ask(server.path, "status", timeout=0.2)
    for client in waiting:
        client.close()
    server.close()
