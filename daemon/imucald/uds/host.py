"""What the server asks of the calibration it speaks for, and has done to it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from imucald.mount.estimate import MountEstimate


@dataclass(frozen=True)
class Identity:
    """What does not change while the daemon runs.

    configuration: 32 bytes that differ when the configuration does.
    """

    version: str
    vehicle: str
    configuration: bytes


@dataclass(frozen=True)
class FrameCounts:
    """What has happened since the start.

    faults: rejected frames and samples by reason. conflicts: frames of others under our ids.
    """

    received: int = 0
    used: int = 0
    sent: int = 0
    rejected: int = 0
    lost: int = 0
    conflicts: int = 0
    faults: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Symptoms:
    """What the DTCs are made from; None where it cannot be reported.

    usable: a correction is in force. moved: the sensor seems to have been moved. missing: inputs
    by name ("accelerometer", "gyroscope", "speed") that are configured: whether they are missing.
    faulty: sensors by name that are configured, "speed" and "yaw_rate": their faults ("stuck",
    "saturated", "implausible"). state_corrupt: a saved state was found and could not be used.
    """

    usable: bool
    moved: bool
    missing: Mapping[str, bool]
    counts: FrameCounts
    state_corrupt: bool | None = None
    faulty: Mapping[str, Collection[str]] = field(default_factory=dict)


class Host(Protocol):
    """One calibration on one bus."""

    @property
    def identity(self) -> Identity:
        """Who it is."""
        ...

    @property
    def quality(self) -> int:
        """Quality of the correction in force, as in the corrected frames."""
        ...

    @property
    def standing(self) -> bool | None:
        """Whether the vehicle stands; None where its speed is not known."""
        ...

    @property
    def uptime(self) -> float:
        """Seconds since the start."""
        ...

    def estimate(self) -> MountEstimate:
        """The present state of knowledge about the mount."""
        ...

    def counts(self) -> FrameCounts:
        """What has happened since the start."""
        ...

    def begin_calibration(self) -> None:
        """Begin again; what was known is kept aside for `return_to_former`."""
        ...

    def return_to_former(self) -> bool:
        """Take back what was kept aside; whether it still fits."""
        ...

    def accept_calibration(self) -> None:
        """Let go of what was kept aside."""
        ...

    def check_sensors(self) -> bool:
        """Repeat the sensor check at the next rest; whether there is one to repeat."""
        ...

    @property
    def sensors_checked(self) -> bool:
        """Whether the sensor check has been made."""
        ...

    def forget(self) -> None:
        """Begin again and keep nothing, a saved state neither."""
        ...

    @property
    def is_forgotten(self) -> bool:
        """Whether the disk has taken that: nothing comes back with another start."""
        ...
