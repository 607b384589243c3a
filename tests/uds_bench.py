"""A calibration that is told what to say, and a key function: for tests of the diagnostics."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from imucald.core.rotations import rotation_from_angles
from imucald.mount.estimate import Missing, MountEstimate, MountState
from imucald.uds.host import FrameCounts, Identity
from imucald.uds.security import KeyFunction, Security
from imucald.uds.server import Server

ANGLES_DEG = (1.5, -20.25, 135.0)
STD_DEG = (0.1, 0.2, 0.4)
WHO = Identity("1.2.3", "WVWZZZ1JZXW000001", bytes(range(32)))
COUNTED = FrameCounts(10, 9, 8, 7, 6, 5, {"checksum": 3, "counter_jump": 2})


class Clock:
    """A monotonic clock that moves when told."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def key_of(seed: bytes) -> bytes:
    """The workshop's secret: every byte turned about, in reverse order."""
    return bytes(b ^ 0x5A for b in reversed(seed))


def estimate_of(state: MountState = MountState.FINE) -> MountEstimate:
    roll, pitch, yaw = (math.radians(a) for a in ANGLES_DEG)
    variance = [math.radians(s) ** 2 for s in STD_DEG]
    missing = {"yaw": Missing.LEFT_TURN} if state is MountState.LEVELLED else {}
    return MountEstimate(
        state, rotation_from_angles(roll, pitch, yaw), np.diag(variance), missing=missing
    )


@dataclass
class FakeHost:
    identity: Identity = WHO
    quality: int = 3
    standing: bool | None = True
    uptime: float = 12.7
    known: MountEstimate = field(default_factory=estimate_of)
    counted: FrameCounts = COUNTED
    former_fits: bool = True
    done: list[str] = field(default_factory=list)

    def estimate(self) -> MountEstimate:
        return self.known

    def counts(self) -> FrameCounts:
        return self.counted

    def begin_calibration(self) -> None:
        self.done.append("begin")
        self.quality = 0

    def return_to_former(self) -> bool:
        if not self.former_fits:
            return False
        self.done.append("return")
        self.quality = 3
        return True

    def accept_calibration(self) -> None:
        self.done.append("accept")

    has_check: bool = True
    is_forgotten: bool = True
    sensors_checked: bool = False

    def check_sensors(self) -> bool:
        self.done.append("check")
        return self.has_check

    def forget(self) -> None:
        self.done.append("forget")
        self.quality = 0


class Bench:
    """A server with a fake host and clock."""

    def __init__(self, key_function: KeyFunction | None = key_of, **options: Any) -> None:
        """options: of `Security`."""
        self.clock = Clock()
        self.host = FakeHost()
        security = Security(key_function, self.clock, **options)
        self.server = Server(self.host, self.clock, security)

    def ask(self, request: str, to_all: bool = False) -> str | None:
        """Request and response as hexadecimal text."""
        response = self.server.handle(bytes.fromhex(request), to_all)
        return None if response is None else response.hex(" ").upper()

    def unlock(self) -> None:
        assert self.ask("10 03") is not None
        seed = self.server.handle(bytes.fromhex("27 01"))
        assert seed is not None
        assert self.server.handle(b"\x27\x02" + key_of(seed[2:])) == b"\x67\x02"
