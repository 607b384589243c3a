"""`imucald demo --live`: a simulated bus, the real daemon and its monitor, with one command.

The daemon is the same as in `imucald run`, but runs in a thread. The monitor reads the daemon's
status socket, as for any other daemon. python-can's virtual bus needs no installation. Before the
start, `imucald simulate` writes the drive to a log in a separate process. The log is read while it
is played. Therefore the memory for the simulation is free again when the daemon starts.
"""

from __future__ import annotations

import contextlib
import json
import math
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK
from imucald.can.logs.log_reader import LogReader
from imucald.can.python_can import can
from imucald.commands.monitor import watch
from imucald.commands.terminal import plain_console
from imucald.config.root import example_path
from imucald.core.errors import ConfigError, LinkError
from imucald.core.orientation_words import sits_words
from imucald.core.rotations import rotation_from_angles
from imucald.mount.mount_words import angles_line
from imucald.service.asking import ask, content
from imucald.service.journal import Journal
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service

START_S = 10.0
"""Longest time until the daemon's socket must answer [s]."""
AHEAD_S = 0.002
"""Frames due within this time are sent at once [s], because shorter sleeps are not reliable."""


class SimulatedBus:
    """Sends the frames of a drive's log at their times, in a thread.

    The frames have the time stamps of the drive. Therefore the drive may run faster than real time.
    """

    def __init__(self, log: Path, interface: str, channel: str, speed: float) -> None:
        options: dict[str, Any] = {}
        if interface == "virtual":
            options["preserve_timestamps"] = True
        try:
            self._bus = can.Bus(interface=interface, channel=channel, **options)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise LinkError(f"interface {interface!r}, channel {channel!r}: {error}") from None
        self._log, self._speed = log, speed
        self._epoch = time.time()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._play, daemon=True)

    def start(self) -> None:
        """Start the drive."""
        self._thread.start()

    def is_over(self) -> bool:
        """True if the last frame was sent. On a busy machine, sending takes longer than the
        drive."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """Stop sending frames. The call is allowed at any time of the drive."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        self._bus.shutdown()

    def _play(self) -> None:
        began, first = time.monotonic(), None
        frames = (row for chunk in LogReader([self._log]) for row in chunk.rows())
        for stamp, can_id, data in frames:
            first = stamp if first is None else first
            t = stamp - first
            wait = began + t / self._speed - time.monotonic()
            if wait > AHEAD_S and self._ended.wait(wait):
                return
            message = can.Message(
                timestamp=self._epoch + t,
                arbitration_id=can_id & CAN_EFF_MASK,
                is_extended_id=bool(can_id & CAN_EFF_FLAG),
                data=data,
            )
            with contextlib.suppress(can.CanError, OSError):  # lost, as on a real bus
                self._bus.send(message)


def run_live(
    seed: int,
    minutes: float,
    mount: str | None,
    interface: str,
    channel: str | None,
    speed: float,
    web: int | None,
) -> None:
    """Show a drive live until its end or Ctrl-C, then the truth. Raises ConfigError, LinkError."""
    if speed != 1.0 and interface != "virtual":
        raise ConfigError(
            "--speed needs the virtual bus (leave --interface out): on other buses, frames "
            "get the time at which they arrive"
        )
    usual = {"virtual": "imucald-live", "udp_multicast": "239.74.163.2", "socketcan": "vcan0"}
    channel = channel or usual.get(interface, "")
    note = f"simulated car (seed {seed}) on {interface} {channel}"
    note += f", {speed:g} times real time" if speed != 1.0 else ""
    with tempfile.TemporaryDirectory(prefix="imucald-live-") as folder:
        log = Path(folder) / "drive.log"
        bus = SimulatedBus(log, interface, channel, speed)
        try:
            truth = _simulated(log, seed, minutes, mount)
            with _daemon(interface, channel) as socket:
                bus.start()
                asked = f"{note}; status, hold, ...: --socket {socket}"
                watch(socket, bus.is_over, web, asked)
                found = _found(socket)
        finally:
            bus.close()
    angles = [truth["mount"][f"{name}_deg"] for name in ("roll", "pitch", "yaw")]
    words = sits_words(rotation_from_angles(*map(math.radians, angles)))
    roll, pitch, yaw = angles
    console = plain_console()
    console.print(f"\nFound:     {found}")
    console.print(f"The truth: roll {roll:+.2f}°, pitch {pitch:+.2f}°, yaw {yaw:+.2f}°; {words}.")


def _found(socket: Path) -> str:
    try:
        status = content(socket, "status", ask(socket, "status"))
    except LinkError:
        return "not known"
    return f"{angles_line(status['mount']) or 'no angles yet'} (mount: {status['state']})"


def _simulated(log: Path, seed: int, minutes: float, mount: str | None) -> dict[str, Any]:
    """Write a drive to a log and return its truth. Raises ConfigError if the drive cannot be
    simulated."""
    command = [sys.executable, "-P", "-m", "imucald", "simulate", "--out", str(log)]
    command += ["--seed", str(seed), "--minutes", str(minutes)]
    command += ["--mount", mount] if mount else []
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise ConfigError(done.stderr.strip().removeprefix("imucald: "))
    truth: dict[str, Any] = json.loads(log.with_name("drive.truth.json").read_text("utf-8"))
    return truth


@contextmanager
def _daemon(interface: str, channel: str) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="imucald-live-") as folder, _quiet() as journal:
        socket = Path(folder) / "status.sock"
        options = ServiceOptions(
            config=example_path(), interface=interface, channel=channel, status_socket=socket
        )
        service = Service(options, journal)
        thread = threading.Thread(target=service.run, daemon=True)
        thread.start()
        try:
            yield socket
        finally:
            service.stop()
            thread.join(START_S)
            service.close()


@contextmanager
def _quiet() -> Iterator[Journal]:
    """Make a journal without output, because the monitor shows the events."""
    with Path("/dev/null").open("w") as nowhere:
        yield Journal(nowhere)
