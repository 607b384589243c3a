"""The interface between the running calibration and the diagnostic server (UDS)."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from typing import Final, Protocol

from msgspec import to_builtins

from imucald import __version__
from imucald.can.dbc.database import MAX_FILE_BYTES
from imucald.can.link.link import Link
from imucald.config import LoadedConfig
from imucald.core.files import read_regular
from imucald.motion.ticks import TICK_RATE
from imucald.mount.estimate import MountEstimate, MountEstimator
from imucald.mount.hysteresis import BAD
from imucald.runtime.flow import STARTING_S
from imucald.runtime.mount_orders import TESTER, MountOrders, OrderedService
from imucald.uds.host import FrameCounts, Identity, Symptoms

SPEED_AGE_S: Final = 2.0
"""Largest age of a known speed [s]: some sources send one sample per second."""
STANDING_SPEED: Final = 0.1
"""A vehicle stands below this speed [m/s], which is finer than any speed signal."""


class RunningService(OrderedService, Protocol):
    """The service that runs the calibration, as the diagnostics see it."""

    @property
    def link(self) -> Link:
        """The bus."""
        ...

    @property
    def state_corrupt(self) -> bool | None:
        """True if the saved state was invalid; None if no state is kept."""
        ...

    @property
    def state_forgotten(self) -> bool:
        """True if the next start loads no forgotten state."""
        ...

    @property
    def orders(self) -> MountOrders:
        """Orders that may be given about the mount."""
        ...

    def check_sensors(self) -> bool:
        """Repeat the sensor check at the next standstill. Return whether there is a sensor
        check."""
        ...

    @property
    def sensors_checked(self) -> bool:
        """True if the sensor check has been completed."""
        ...

    def log_tester(self, text: str) -> None:
        """Log an action of a tester. The rate of these lines is limited, because a tester may
        repeat an action without end."""
        ...


class LiveHost:
    """Implements `uds.host.Host` with the running calibration."""

    def __init__(self, service: RunningService, clock: Callable[[], float]) -> None:
        self._service = service
        self._clock = clock
        self._began = clock()
        self._estimate: tuple[MountEstimator, int, MountEstimate] | None = None
        self._known_as: tuple[LoadedConfig, Identity] | None = None

    @property
    def identity(self) -> Identity:
        """Identity of software, vehicle and configuration."""
        loaded = self._service.loaded
        if self._known_as is None or self._known_as[0] is not loaded:
            made = Identity(__version__, loaded.config.vehicle.id, configuration_identity(loaded))
            self._known_as = loaded, made
        return self._known_as[1]

    @property
    def quality(self) -> int:
        """Quality of the present correction, as in the output frames."""
        return self._service.engine.pipeline.quality

    @property
    def standing(self) -> bool | None:
        """True if the vehicle stands, according to the last speed. None if the speed is older than
        two seconds or missing."""
        pipeline = self._service.engine.pipeline
        if pipeline.speed is None:
            return None
        tick, speed = pipeline.speed
        is_old = pipeline.k - tick > SPEED_AGE_S * TICK_RATE
        return None if is_old else abs(speed) < STANDING_SPEED

    @property
    def uptime(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._began

    def estimate(self) -> MountEstimate:
        """Return the present mount estimate. The estimate is computed at most once per tick."""
        pipeline = self._service.engine.pipeline
        known = self._estimate
        if known is None or known[0] is not pipeline.estimator or known[1] != pipeline.k:
            known = pipeline.estimator, pipeline.k, pipeline.estimator.estimate()
            self._estimate = known
        return known[2]

    def counts(self) -> FrameCounts:
        """Return the frame counters of engine and link."""
        engine, link = self._service.engine, self._service.link.counters
        rejected = engine.router.rejected
        return FrameCounts(
            received=link.received,
            used=engine.router.used,
            sent=link.sent,
            rejected=rejected.total(),
            lost=link.lost,
            conflicts=link.conflicts,
            faults=rejected,
        )

    def symptoms(self) -> Symptoms:
        """Return the symptoms from which the DTCs are made."""
        engine = self._service.engine
        health, channels = engine.health(), engine.router.channels
        missing = {
            "accel": health.accelerometer_missing,
            "gyro": health.gyroscope_missing,
            "speed": health.speed_missing,
        }
        if self.uptime < STARTING_S:
            missing = {}
        faults = engine.pipeline.health.unfit
        names = {
            "accel": "accelerometer",
            "gyro": "gyroscope",
            "mag": "magnetometer",
            "speed": "speed",
            "yaw_rate": "yaw_rate",
        }
        return Symptoms(
            usable=engine.pipeline.quality > 0,
            moved=engine.pipeline.estimator.state in BAD,
            missing={names[c]: flag for c, flag in missing.items() if c in channels},
            counts=self.counts(),
            state_corrupt=self._service.state_corrupt,
            faulty={
                name: [str(fault) for fault in faults.get(c, ())]
                for c, name in names.items()
                if c in channels
            },
        )

    def begin_calibration(self) -> None:
        """Start the calibration again. The old estimator is kept for `return_to_former`."""
        self._service.orders.begin(TESTER)

    def return_to_former(self) -> bool:
        """Use the old estimator again. Return False if the settings have changed since then."""
        return self._service.orders.return_to_former(TESTER)

    def accept_calibration(self) -> None:
        """Drop the old estimator."""
        self._service.orders.accept()

    def check_sensors(self) -> bool:
        """Repeat the sensor check at the next standstill. Return whether there is a sensor
        check."""
        return self._service.check_sensors()

    @property
    def sensors_checked(self) -> bool:
        """True if the sensor check has been completed."""
        return self._service.sensors_checked

    def forget(self) -> None:
        """Start the calibration again, and forget the saved state."""
        self._service.orders.reset(TESTER)

    @property
    def is_forgotten(self) -> bool:
        """True if the next start loads no forgotten state."""
        return self._service.state_forgotten


def configuration_identity(loaded: LoadedConfig) -> bytes:
    """Return a SHA-256 (32 bytes) of the present settings and the databases.

    A default has the same effect as the same value in the file. Comments and the order of keys have
    no effect.
    """
    digest = hashlib.sha256()
    settings = {k: v for k, v in to_builtins(loaded.config).items() if k != "database"}
    digest.update(json.dumps(settings, sort_keys=True).encode())
    for database in loaded.config.database:
        path = loaded.database_path(database)
        described = {k: v for k, v in to_builtins(database).items() if k != "path"}
        digest.update(json.dumps(described).encode())
        try:
            digest.update(hashlib.sha256(read_regular(path, MAX_FILE_BYTES)).digest())
        except OSError:  # the file was there at loading
            digest.update(b"unreadable")
    return digest.digest()
