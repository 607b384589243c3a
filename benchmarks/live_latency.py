"""The live daemon on python-can's virtual bus: latency, losses, start, memory, processor share.

    python -m benchmarks.live_latency [--seconds 20]

Latency: from handing an accelerometer or gyroscope frame to the bus to holding its corrected
frame, at 400 samples a second in a simulated drive with speed and all else. Sender and receiver
share one interpreter with the daemon here, so their time is in it. Losses: 8,000 frames a second
on the bus, 5 % of them ours. Start and memory: a process of its own, until it says that it listens.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from benchmarks.measured import EXAMPLES, environment, imucald, verdict
from imucald.can.columns import CAN_EFF_FLAG
from imucald.can.python_can import can
from imucald.cli import PROCESS_SETTINGS
from imucald.runtime.output.output_frames import output_database
from imucald.runtime.session import make_engine, open_config
from imucald.service.live import Daemon, open_link
from imucald.simulation import random_model, simulate
from imucald.traffic.can_log import live_frames
from imucald.traffic.drive_encoder import BusEncoder

CONFIG = EXAMPLES / "passenger_car.yaml"
RATE_HZ = 200.0
"""Of accelerometer and of gyroscope."""
FULL_RATE = 8000.0
"""Frames per second of a full classic bus."""
BAR_P99_MS, BAR_READY_S, BAR_MEMORY_MIB = 0.5, 0.5, 90.0
Frame = tuple[float, int, bytes]


class RunningDaemon:
    """A daemon on a virtual channel, in a thread."""

    def __init__(self, channel: str) -> None:
        loaded = open_config(CONFIG)
        self.engine = make_engine(loaded)
        matches, own = self.engine.router.matches, self.engine.output.can_ids
        self.link = open_link(loaded, matches, own, "virtual", channel)
        self.daemon = Daemon(self.engine, self.link)
        self.processor_s = 0.0
        self.steps: list[float] = []  # processor time of handling one frame [s]
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        now = began = time.thread_time()
        while not self.daemon.stopping:
            handled = self.daemon.serve_once()
            before, now = now, time.thread_time()
            if handled == 1:
                self.steps.append(now - before)
        self.processor_s = now - began

    def stop(self) -> None:
        """Stop the daemon and close its bus."""
        self.daemon.stop()
        self._thread.join()
        self.link.close()


@contextmanager
def running(channel: str) -> Iterator[tuple[RunningDaemon, can.BusABC]]:
    daemon = RunningDaemon(channel)
    bus = can.Bus(interface="virtual", channel=channel)
    try:
        yield daemon, bus
    finally:
        daemon.stop()
        bus.shutdown()


def drive_frames(seconds: float) -> list[Frame]:
    """Frames of a simulated drive with the IMU at 200 Hz, from its beginning."""
    model = random_model(5).with_changes({"accel.rate_hz": RATE_HZ, "gyro.rate_hz": RATE_HZ})
    drive = simulate(model, 5, seconds / 60.0)
    return list(live_frames(drive, BusEncoder(open_config(CONFIG))))


def send(bus: can.BusABC, can_id: int, data: bytes) -> None:
    extended = bool(can_id & CAN_EFF_FLAG)
    bus.send(
        can.Message(
            arbitration_id=can_id & ~CAN_EFF_FLAG,
            data=data,
            is_extended_id=extended,
            timestamp=time.time(),
        )
    )


def exchanged(bus: can.BusABC, frames: list[Frame], answers: dict[int, int]) -> list[float]:
    """Send frames in real time, waiting for the answer where there is one; times taken [s]."""
    taken: list[float] = []
    began = time.perf_counter()
    for t, can_id, data in frames:
        while (left := began + t - time.perf_counter()) > 0.0:
            time.sleep(left)  # spinning would keep the interpreter from the daemon
        sent = time.perf_counter()
        send(bus, can_id, data)
        wanted = answers.get(can_id)
        while wanted is not None:
            answer = bus.recv(0.5)
            if answer is None:
                raise RuntimeError("a sample was not answered within 0.5 s")
            if answer.arbitration_id == wanted:
                taken.append(time.perf_counter() - sent)
                break
    return taken


def bare_exchange(frames: list[Frame], answers: dict[int, int]) -> list[float]:
    """The same with a thread that answers at once: what machine and interpreter take already."""
    stopping = threading.Event()
    echo = can.Bus(interface="virtual", channel="bare")

    def answer() -> None:
        while not stopping.is_set():
            message = echo.recv(0.05)
            if message is not None and message.arbitration_id in answers:
                send(echo, answers[message.arbitration_id], bytes(8))

    thread = threading.Thread(target=answer)
    thread.start()
    bus = can.Bus(interface="virtual", channel="bare")
    try:
        return exchanged(bus, frames, answers)
    finally:
        stopping.set()
        thread.join()
        for one in (bus, echo):
            one.shutdown()


def latency(seconds: float) -> bool:
    """Send a drive in real time; each sample's corrected frame is waited for."""
    names = {"IMU_Accel": "IMUCALD_Acceleration", "IMU_Gyro": "IMUCALD_AngularRate"}
    frames = drive_frames(seconds)
    with running("latency") as (running_daemon, bus):
        answers = {
            route.match.can_id: output_database().message(names[route.name]).can_id
            for route in running_daemon.engine.router.routes
            if route.name in names
        }
        taken = exchanged(bus, frames, answers)
    p50, p99, worst = (1e3 * x for x in np.quantile(taken, [0.5, 0.99, 1.0]))
    bare50, bare99 = (1e3 * x for x in np.quantile(bare_exchange(frames, answers), [0.5, 0.99]))
    own50, own99 = (1e3 * x for x in np.quantile(running_daemon.steps, [0.5, 0.99]))
    met = bool(p99 <= BAR_P99_MS)
    share = 100 * running_daemon.processor_s / seconds
    print(
        f"latency of {len(taken)} samples at {len(taken) / seconds:.0f}/s: p50 {p50:.3f},"
        f" p99 {p99:.3f}, max {worst:.2f} ms (bar p99 {BAR_P99_MS}: {verdict(met)})"
    )
    print(f"  without the daemon, same exchange: p50 {bare50:.3f}, p99 {bare99:.3f} ms")
    print(
        f"  processor time of one frame in the daemon: p50 {own50:.3f}, p99 {own99:.3f} ms;"
        f" share of one processor {share:.1f} %"
    )
    return met


def losses(seconds: float) -> bool:
    """A full bus: 19 foreign frames for each of ours."""
    ours = drive_frames(seconds * 1.5)[: int(FULL_RATE * seconds / 20)]
    with running("losses") as (running_daemon, bus):
        began = time.perf_counter()
        for k, (_, can_id, data) in enumerate(ours):
            for j in range(19):
                send(bus, 0x700 + (k + j) % 64, b"\x55" * 8)
            send(bus, can_id, data)
            left = began + 20 * (k + 1) / FULL_RATE - time.perf_counter()
            if left > 0.001:
                time.sleep(left)
        wall = time.perf_counter() - began
        deadline = time.perf_counter() + 5.0
        engine, counters = running_daemon.engine, running_daemon.link.counters
        while counters.received < len(ours) and time.perf_counter() < deadline:
            time.sleep(0.05)
        used = engine.router.used + engine.router.rejected.total()
    met = counters.received == len(ours)
    print(
        f"full bus: {20 * len(ours)} frames at {20 * len(ours) / wall:.0f}/s, {len(ours)} ours,"
        f" {counters.received} received, {used} judged (bar none lost: {verdict(met)})"
    )
    return met


def start(rounds: int) -> bool:
    """Time until the process says that it listens, and its memory a second later."""
    ready, memory = [], []
    command = imucald(
        "run", "--config", CONFIG, "--interface", "virtual", "--channel", "start", "--seconds", "60"
    )
    for _ in range(rounds + 1):
        began = time.perf_counter()
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=environment())
        assert process.stderr is not None
        for line in process.stderr:
            if "listening" in line:
                break
        ready.append(time.perf_counter() - began)
        time.sleep(1.0)
        status = Path(f"/proc/{process.pid}/status").read_text(encoding="ascii")
        found = re.search(r"VmHWM:\s+(\d+) kB", status)
        memory.append(int(found[1]) / 1024.0 if found else float("nan"))
        process.terminate()
        process.wait()
    quickest = min(ready[1:])
    met_time, met_memory = quickest < BAR_READY_S, max(memory) < BAR_MEMORY_MIB
    print(f"ready after {quickest:.2f} s (bar {BAR_READY_S}: {verdict(met_time)})")
    print(f"memory {max(memory):.0f} MiB (bar {BAR_MEMORY_MIB:.0f}: {verdict(met_memory)})")
    return met_time and met_memory


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="of driving for the latency")
    options = parser.parse_args()
    if any(os.environ.get(name) is None for name in PROCESS_SETTINGS):
        os.execve(  # numpy has been imported: begin anew with the settings of the commands
            sys.executable,
            [sys.executable, "-m", "benchmarks.live_latency", *sys.argv[1:]],
            {**PROCESS_SETTINGS, **os.environ},
        )
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")
    results = [latency(options.seconds), losses(5.0), start(4)]
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
