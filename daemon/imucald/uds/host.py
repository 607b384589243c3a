"""The interface between a calibration and the UDS server: data to read, and actions."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Protocol

from imucald.mount.estimate import MountEstimate


@dataclass(frozen=True)
class Identity:
    """Data that do not change while the daemon runs.

    configuration: 32 bytes that change if the configuration changes.
    """

    version: str
    vehicle: str
    configuration: bytes


@dataclass(frozen=True)
class FrameCounts:
    """Numbers of frames since the start.

    faults: rejected frames and samples by reason. conflicts: frames of other nodes with our ids.
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
    """The inputs of the DTC tests. A value is None if it cannot be determined.

    usable: a correction is active. moved: the sensor seems to have been moved. missing: for each
    configured input ("accelerometer", "gyroscope", "speed"), whether it is missing. faulty: for
    each configured sensor, "speed" and "yaw_rate", its faults ("stuck", "saturated",
    "implausible"). state_corrupt: a saved state was found but could not be used.
    """

    usable: bool
    moved: bool
    missing: Mapping[str, bool]
    counts: FrameCounts
    state_corrupt: bool | None = None
    faulty: Mapping[str, Collection[str]] = field(default_factory=dict)


class Host(Protocol):
    """Interface of one calibration on one bus."""

    @property
    def identity(self) -> Identity:
        """The identity of the calibration."""
        ...

    @property
    def quality(self) -> int:
        """Quality of the active correction, as in the corrected frames."""
        ...

    @property
    def standing(self) -> bool | None:
        """True if the vehicle stands; None if its speed is not known."""
        ...

    @property
    def uptime(self) -> float:
        """Time since the start [s]."""
        ...

    def estimate(self) -> MountEstimate:
        """The present estimate of the mount."""
        ...

    def counts(self) -> FrameCounts:
        """Numbers of frames since the start."""
        ...

    def begin_calibration(self) -> None:
        """Start a new calibration. The former calibration is kept for `return_to_former`."""
        ...

    def return_to_former(self) -> bool:
        """Use the former calibration again. Return False if the settings have changed, so that the
        former calibration cannot be used."""
        ...

    def accept_calibration(self) -> None:
        """Accept the new calibration, and delete the former calibration."""
        ...

    def check_sensors(self) -> bool:
        """Repeat the sensor check at the next standstill. Return whether there is a sensor
        check."""
        ...

    @property
    def sensors_checked(self) -> bool:
        """True if the sensor check is complete."""
        ...

    def forget(self) -> None:
        """Start a new calibration, and delete the former calibration and the saved state."""
        ...

    @property
    def is_forgotten(self) -> bool:
        """True if the deletion is stored on disk, so that a restart cannot restore anything."""
        ...
