"""`imucald demo --live`: a simulated bus, the real daemon and the monitor beside it, in one line.

The daemon is the one of `imucald run`, in a thread of its own; the monitor asks it through its
status socket, as it would any other. On python-can's virtual bus nothing has to be installed.
"""

from __future__ import annotations

import contextlib
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK
from imucald.can.python_can import can
from imucald.commands.monitor import watch
from imucald.core.angles import DEG_PER_RAD
from imucald.core.errors import ConfigError, LinkError
from imucald.core.orientation_words import sits_words
from imucald.core.rotations import angles_from_rotation
from imucald.service.journal import Journal
from imucald.service.service import Service, ServiceOptions
from imucald.simulation.drive import Drive
from imucald.traffic.can_log import live_frames
from imucald.traffic.drive_encoder import BusEncoder, example_config

START_S = 10.0
"""The daemon's socket must answer within this time [s]."""
AHEAD_S = 0.002
"""Frames due within this are sent at once: shorter sleeps are not dependable."""
CHANNELS = {"virtual": "imucald-live", "udp_multicast": "239.74.163.2", "socketcan": "vcan0"}


class SimulatedBus:
    """Sends a drive's frames at their times, in a thread.

    On the virtual bus stamps are those of the drive, so that it may pass faster than real time.
    """

    def __init__(self, drive: Drive, interface: str, channel: str, speed: float) -> None:
        options: dict[str, Any] = {}
        if interface == "virtual":
            options["preserve_timestamps"] = True
        try:
            self._bus = can.Bus(interface=interface, channel=channel, **options)
        except (can.CanError, OSError, ValueError, ImportError) as error:
            raise LinkError(f"interface {interface!r}, channel {channel!r}: {error}") from None
        self._drive, self._speed = drive, speed
        self._epoch = time.time()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._play, daemon=True)

    def start(self) -> None:
        """Begin to drive."""
        self._thread.start()

    def close(self) -> None:
        """Stop, wherever the drive is."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join(2.0)
        self._bus.shutdown()

    def _play(self) -> None:
        began = time.monotonic()
        for t, can_id, data in live_frames(self._drive, BusEncoder(example_config())):
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
    drive: Drive, interface: str, channel: str | None, speed: float, web: int | None
) -> None:
    """Show the drive live until it ends or Ctrl-C; then the truth. Raises LinkError."""
    if speed != 1.0 and interface != "virtual":
        raise ConfigError("--speed needs the virtual bus: elsewhere stamps are those of arrival")
    channel = channel or CHANNELS.get(interface, "")
    bus = SimulatedBus(drive, interface, channel, speed)
    note = f"simulated car (seed {drive.seed}) on {interface} {channel}"
    try:
        with _daemon(interface, channel) as socket:
            bus.start()
            watch(socket, drive.duration_s / speed, web, note)
    finally:
        bus.close()
    R = drive.truth.R_vehicle_from_sensor(drive.duration_s)
    roll, pitch, yaw = (a * DEG_PER_RAD for a in angles_from_rotation(R))
    print(f"\nThe truth: roll {roll:+.2f}°, pitch {pitch:+.2f}°, yaw {yaw:+.2f}°; {sits_words(R)}.")


@contextmanager
def _daemon(interface: str, channel: str) -> Iterator[Path]:
    """Run the daemon in a thread; yields its status socket."""
    config = example_config().path
    assert config is not None
    with tempfile.TemporaryDirectory(prefix="imucald-live-") as folder, _quiet() as journal:
        socket = Path(folder) / "status.sock"
        options = ServiceOptions(
            config=config, interface=interface, channel=channel, status_socket=socket
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
    """A log that goes nowhere: the monitor shows what happens."""
    with Path("/dev/null").open("w") as nowhere:
        yield Journal(nowhere)
