"""The service on a kernel's CAN: the interface fails at random, the bus is flooded and spoofed."""

from __future__ import annotations

import contextlib
import json
import random
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import shuttle
from imucald.runtime.session import make_engine, open_config
from imucald.service.asking import ask
from imucald.service.saved_state import SavedState, StateStore, state_key

pytestmark = pytest.mark.slow

FRAME = struct.Struct("=IB3x8s")
RAW, CORRECTED = 0x200, 0x640
SO_TIMESTAMPNS = 35
STAMP = struct.Struct("@ll")
STAMP_BYTES = socket.CMSG_SPACE(STAMP.size)
RESUME_S = 1.0
DOWN_UPS, DELETIONS = 50, 20
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
COVARIANCE = (1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4)


class Process:
    """A running `imucald run` with a saved mount (the identity), so that it corrects at once."""

    def __init__(self, folder: Path, channel: str) -> None:
        config = shuttle.write(folder, cycles=1)
        loaded = open_config(config)
        key = state_key(loaded, make_engine(loaded).router)
        StateStore(folder / "state", key).save(SavedState(IDENTITY, COVARIANCE, "fine"))
        self.socket = folder / "status.sock"
        options = ["--config", str(config), "--interface", "socketcan", "--channel", channel]
        options += ["--state-dir", str(folder / "state"), "--status-socket", str(self.socket)]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "imucald", "run", *options], stderr=subprocess.DEVNULL
        )
        end = time.monotonic() + 30.0
        while not self.socket.exists():
            assert self.process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.05)

    def status(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(ask(self.socket, "status"))
        return found

    def stop(self) -> float:
        began = time.monotonic()
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(10.0) == 0
        return time.monotonic() - began


@contextmanager
def running(folder: Path, channel: str) -> Iterator[Process]:
    daemon = Process(folder, channel)
    try:
        yield daemon
    finally:
        daemon.process.kill()
        daemon.process.wait()


class Node:
    """Sends accelerometer frames, each with another value; knows which came back corrected.

    stale: corrected frames that came on the bus more than 0.3 s after the one they are made of.
    Both times are the kernel's: how long this thread was held up says nothing about the daemon.
    """

    def __init__(self, channel: str) -> None:
        self.channel = channel
        self.sent: dict[int, float] = {}
        self.number = 0
        self.heard = 0.0
        self.stale = self.good = 0
        self.on = True
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        while self.on:
            with (
                contextlib.suppress(OSError),
                socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus,
            ):
                option = struct.pack("=IIII", RAW, 0x7FF, CORRECTED, 0x7FF)
                bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, option)
                bus.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_RECV_OWN_MSGS, 1)
                bus.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
                bus.bind((self.channel,))
                bus.setblocking(False)
                self._exchange(bus)
            time.sleep(0.01)

    def _exchange(self, bus: socket.socket) -> None:
        index = socket.if_nametoindex(self.channel)
        while self.on and socket.if_nametoindex(self.channel) == index:
            self.number = self.number % 4000 + 1
            bus.send(FRAME.pack(RAW, 8, struct.pack("<3hxx", self.number, 0, 4903)))
            time.sleep(0.005)
            with contextlib.suppress(BlockingIOError):
                while True:
                    frame, ((_, _, stamp),), _, _ = bus.recvmsg(16, STAMP_BYTES)
                    seconds, nanoseconds = STAMP.unpack(stamp)
                    can_id, _, data = FRAME.unpack(frame)
                    self._take(seconds + nanoseconds / 1e9, can_id, data)

    def _take(self, t: float, can_id: int, data: bytes) -> None:
        (value,) = struct.unpack("<h", data[:2])
        if can_id == RAW:
            self.sent[value] = t
        elif data[6] & 0xF > 0:  # a quality: corrected
            self.heard = time.monotonic()
            self.good += 1
            self.stale += t - self.sent.get(value, -1.0) > 0.3

    def wait_for_answer(self, since: float) -> float:
        while self.heard < since:
            assert time.monotonic() - since < 10.0, "no corrected frame any more"
            time.sleep(0.002)
        return self.heard - since

    def stop(self) -> None:
        self.on = False
        self.thread.join()


def test_an_interface_that_fails_at_random_is_survived_and_nothing_stale_is_sent(vcan, tmp_path):
    random.seed(8)
    faults = ["down"] * DOWN_UPS + ["deleted"] * DELETIONS
    random.shuffle(faults)
    times: dict[str, list[float]] = {"down": [], "deleted": []}
    with running(tmp_path, vcan.name) as daemon:
        node = Node(vcan.name)
        try:
            node.wait_for_answer(time.monotonic())
            for fault in faults:
                (vcan.down if fault == "down" else vcan.delete)()
                time.sleep(random.uniform(0.0, 0.15))
                (vcan.up if fault == "down" else vcan.create)()
                times[fault].append(node.wait_for_answer(time.monotonic()))
                time.sleep(random.uniform(0.0, 0.05))
        finally:
            node.stop()
        link = daemon.status()["link"]
        assert daemon.stop() < 1.0
    print({fault: round(max(t), 3) for fault, t in times.items()}, node.good, link)
    assert max(times["down"] + times["deleted"]) < RESUME_S
    assert node.stale == 0
    assert node.good > 200
    assert link["reopened"] >= DELETIONS // 2  # down and deleted at once may count as one
    assert link["went_down"] > 0


def test_an_interface_that_flaps_without_end_costs_no_memory_and_few_lines(vcan, tmp_path):
    """Some hundred times in 20 s: a loose contact at a gateway goes on for days."""
    with running(tmp_path, vcan.name) as daemon:
        node = Node(vcan.name)
        try:
            node.wait_for_answer(time.monotonic())
            before = daemon.status()
            flaps, end = 0, time.monotonic() + 20.0
            while time.monotonic() < end:
                vcan.down()
                time.sleep(0.06)
                vcan.up()
                time.sleep(0.06)
                flaps += 1
            assert node.wait_for_answer(time.monotonic()) < RESUME_S
            after = daemon.status()
            events = json.loads(ask(daemon.socket, "events"))["events"]
        finally:
            node.stop()
        daemon.stop()
    about_bus = [event for event in events if vcan.name in event["text"]]
    print(flaps, after["link"]["went_down"], len(about_bus), after["process"])
    assert after["link"]["went_down"] > 50
    assert after["link"]["state"] == "up"
    assert len(about_bus) < 30
    assert after["process"]["open_files"] == before["process"]["open_files"]
    assert after["process"]["rss_bytes"] - before["process"]["rss_bytes"] < 2 << 20


def test_a_flood_loses_none_of_ours_or_counts_each_and_shows_it(vcan, tmp_path):
    """As fast as the bus takes it, with some 400 frames/s of ours inside."""
    with running(tmp_path, vcan.name) as daemon:
        flood = subprocess.Popen(
            ["cangen", vcan.name, "-g", "0", "-I", "3A0", "-L", "8", "-i"],
            stderr=subprocess.DEVNULL,
        )
        sent = 0
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind((vcan.name,))
            end = time.monotonic() + 3.0
            while time.monotonic() < end:
                for _ in range(4):
                    bus.send(FRAME.pack(0x200, 8, struct.pack("<3hxx", sent % 4000, 0, 4903)))
                    sent += 1
                time.sleep(0.008)
        flood.terminate()
        flood.wait(10)
        time.sleep(0.7)
        status = daemon.status()
        daemon.stop()
    print(sent, status["frames"], status["link"])
    assert status["frames"]["used"] + status["link"]["lost"] == sent
    assert status["link"]["foreign"] == 0, "the kernel's filter let the flood through"


def test_spoofed_frames_are_refused_counted_and_cost_no_memory(vcan, tmp_path):
    """Our own ids, frames too short, and a torrent of both: told in status, memory bounded."""
    with running(tmp_path, vcan.name) as daemon:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind((vcan.name,))

            def spoof(count: int) -> None:
                for number in range(count):
                    bus.send(FRAME.pack(0x640 + number % 6, 8, bytes(8)))
                    bus.send(FRAME.pack(0x200, 3, bytes(8)))
                    bus.send(FRAME.pack(0x201, 8, b"\xff\x7f" * 4))
                    if number % 20 == 0:
                        time.sleep(0.005)

            spoof(1000)
            time.sleep(0.5)
            before = daemon.status()
            spoof(4000)
            time.sleep(0.7)
        status = daemon.status()
        daemon.stop()
    assert status["link"]["conflicts"] > before["link"]["conflicts"] > 0
    assert status["frames"]["rejected"]["short_frame"] > 1000
    assert status["health"]["id_conflict"]
    assert status["health"]["input_rejected"]
    assert status["signals"].get("accel", {"samples": 0})["samples"] == 0
    assert status["mount"]["yaw_deg"] == 0.0
    growth = status["process"]["rss_bytes"] - before["process"]["rss_bytes"]
    assert growth < 2 << 20
