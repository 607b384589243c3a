"""A running service with diagnostics on python-can's virtual bus, and testers for it."""

from __future__ import annotations

import io
import itertools
import math
import struct
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

import shuttle
from imucald.can.logs.log_reader import LogReader
from imucald.can.python_can import can  # before isotp, which would import all of it
from imucald.service.journal import Journal
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service

import isotp  # isort: skip
import udsoncan  # isort: skip
from udsoncan.client import Client  # isort: skip
from udsoncan.connections import PythonIsoTpConnection  # isort: skip

from uds_bench import key_of

REQUEST, RESPONSE, TO_ALL = 0x7B0, 0x7B8, 0x7DF
CHANNELS = itertools.count()
SIMULATED = Path(__file__).parent.parent / "config" / "examples" / "passenger_car.yaml"
SECTION = f"""
vehicle: {{id: WVWZZZ1JZXW000001}}
diagnostics:
  enabled: true
  request_id: {REQUEST:#x}
  response_id: {RESPONSE:#x}
  security: {{key_function: "uds_bench:key_of", delay: 1.0}}
"""


class Bytes(udsoncan.DidCodec):
    """A data identifier as a tuple of numbers, or (form None) as text to the end."""

    def __init__(self, form: str | None) -> None:
        self.form = form

    def decode(self, payload: bytes) -> Any:
        return payload.decode() if self.form is None else struct.unpack(f">{self.form}", payload)

    def __len__(self) -> int:
        if self.form is None:
            raise udsoncan.DidCodec.ReadAllRemainingData
        return struct.calcsize(f">{self.form}")


IDENTIFIERS: Mapping[int, Bytes] = {
    0xF186: Bytes("B"),
    0xF190: Bytes("17s"),
    0xF195: Bytes(None),
    0xFD00: Bytes("3h"),
    0xFD01: Bytes("3H"),
    0xFD02: Bytes("4f"),
    0xFD03: Bytes("B"),
    0xFD04: Bytes("B"),
    0xFD05: Bytes("3B"),
    0xFD06: Bytes("32s"),
    0xFD08: Bytes("6I"),
    0xFD09: Bytes("12I"),
    0xFD0A: Bytes("I"),
    0xFD0B: Bytes("4I"),
    0xFD0C: Bytes("6I"),
}


def with_diagnostics(folder: Path, cycles: int = 3) -> Path:
    """A drive and its configuration, diagnostics switched on; return the configuration's path."""
    config = shuttle.write(folder, cycles=cycles)
    config.write_text(config.read_text() + SECTION)
    return config


def guarded_config(folder: Path) -> Path:
    """The simulated bus, whose IMU frames have counters and checksums, with diagnostics."""
    settings = yaml.safe_load(SIMULATED.read_text())
    settings["database"] = str((SIMULATED.parent / settings["database"]).resolve())
    settings |= yaml.safe_load(SECTION)
    config = folder / "guarded.yaml"
    config.write_text(yaml.safe_dump(settings))
    return config


@contextmanager
def asking(bus: Any, extended_ids: bool = False, **config: Any) -> Iterator[Client]:
    """A workshop's tester on a bus, with the right key."""
    mode = isotp.AddressingMode
    address = isotp.Address(mode.Normal_11bits, txid=REQUEST, rxid=RESPONSE)
    if extended_ids:
        address = isotp.Address(mode.Normal_29bits, txid=0x18DA55F1, rxid=0x18DAF155)
    stack = isotp.CanStack(bus, address=address, params={"tx_padding": 0xAA, "stmin": 2})
    settings = {
        **udsoncan.configs.default_client_config,
        "data_identifiers": IDENTIFIERS,
        "security_algo": lambda seed, **_: key_of(seed),
        "request_timeout": 3.0,
        "p2_timeout": 2.0,  # a busy machine
        "use_server_timing": False,
        **config,
    }
    with Client(PythonIsoTpConnection(stack), config=settings) as client:
        yield client


def frames_of(log: Path) -> list[tuple[float, int, bytes]]:
    """The drive's frames of ours."""
    return [
        (t, can_id, data[:n].tobytes())
        for chunk in LogReader([log])
        for t, can_id, n, data in zip(
            chunk.t.tolist(), chunk.can_id.tolist(), chunk.length.tolist(), chunk.data, strict=True
        )
        if 0x200 <= can_id <= 0x202
    ]


class UdsBench:
    """A service in a thread, and the bus it is on."""

    def __init__(
        self, folder: Path, config: Path, frames: list[tuple[float, int, bytes]] | None = None
    ) -> None:
        self.folder = folder
        self.log = io.StringIO()
        channel = f"uds-{next(CHANNELS)}"
        options = ServiceOptions(
            config, interface="virtual", channel=channel, state_folder=folder / "state"
        )
        self.service = Service(options, Journal(self.log))
        self.bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
        self.tester_bus = can.Bus(interface="virtual", channel=channel)
        self._thread = threading.Thread(target=self.service.run)
        self.frames = frames or frames_of(folder / "shuttle.log")
        self.start = self.frames[0][0]
        self._played = 0

    def play(self, until: float, change: Callable[[int, bytes], bytes] | None = None) -> None:
        """Send the drive up to this time from its start [s], as fast as it is taken in."""
        while self._played < len(self.frames):
            t, can_id, data = self.frames[self._played]
            if t - self.start >= until:
                break
            self.send(can_id, data if change is None else change(can_id, data), t)
            self._played += 1
            if self._played % 200 == 0:
                self.wait_for(lambda: self.service.link.counters.received > self._played - 100)
        self.wait_for(lambda: self.service.engine.pipeline.k >= math.floor(10 * until) - 2)

    def send(self, can_id: int, data: bytes, t: float | None = None) -> None:
        """Send one frame."""
        self.bus.send(
            can.Message(
                timestamp=time.time() if t is None else t,
                arbitration_id=can_id,
                is_extended_id=can_id > 0x7FF,
                data=data,
            )
        )

    def wait_for(self, condition: Callable[[], bool], limit: float = 10.0) -> None:
        end = time.monotonic() + limit
        while not condition():
            assert time.monotonic() < end, "it did not come about"
            assert self._thread.is_alive(), self.log.getvalue()
            time.sleep(0.002)

    def __enter__(self) -> UdsBench:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.service.stop()
        self._thread.join(5.0)
        assert not self._thread.is_alive()
        self.service.close()
        self.bus.shutdown()
        self.tester_bus.shutdown()
