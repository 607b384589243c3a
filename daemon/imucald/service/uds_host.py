"""The running calibration as the diagnostic server uses it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from typing import Final, Protocol

from msgspec import to_builtins

from imucald import __version__
from imucald.can.dbc.database import MAX_FILE_BYTES
from imucald.can.link.link import LinkCounters
from imucald.config import LoadedConfig
from imucald.core.files import read_regular
from imucald.motion.ticks import TICK_RATE
from imucald.mount.estimate import MountEstimate, MountEstimator
from imucald.mount.hysteresis import BAD
from imucald.runtime.engine import Engine
from imucald.runtime.mount_orders import TESTER, MountOrders
from imucald.uds.host import FrameCounts, Identity, Symptoms

SPEED_AGE_TICKS: Final = 2.0 * TICK_RATE
"""A speed counts as known if a sample came within this time: for sources of one sample per
second.
"""
STANDING_SPEED: Final = 0.1
"""A vehicle below this speed stands [m/s]: it is less than the first step of a coarse speed
signal.
"""
START_S: Final = 2.0
"""Time from the start before which no input is missing [s]."""


class RunningService(Protocol):
    """Service that runs the calibration; its engine and configuration change at a reload."""

    @property
    def engine(self) -> Engine:
        """The engine that runs now."""
        ...

    @property
    def loaded(self) -> LoadedConfig:
        """The present configuration."""
        ...

    @property
    def link_counters(self) -> LinkCounters:
        """Counters of the bus link."""
        ...

    @property
    def state_corrupt(self) -> bool | None:
        """True if an invalid saved state was found; None if no state is kept."""
        ...

    @property
    def state_forgotten(self) -> bool:
        """True if no forgotten state would return at another start."""
        ...

    @property
    def orders(self) -> MountOrders:
        """Orders that may be given about the mount."""
        ...

    def check_sensors(self) -> bool:
        """Repeat the sensor check at the next rest; return whether there is one to repeat."""
        ...

    @property
    def sensors_checked(self) -> bool:
        """True if the sensor check has been made."""
        ...

    def log_tester(self, text: str) -> None:
        """Log what a tester did; such lines may come without end."""
        ...


class LiveHost:
    """The running calibration as the server uses it. See `uds.host.Host`."""

    def __init__(self, service: RunningService, clock: Callable[[], float]) -> None:
        self._service = service
        self._clock = clock
        self._began = clock()
        self._estimate: tuple[MountEstimator, int, MountEstimate] | None = None
        self._known_as: tuple[LoadedConfig, Identity] | None = None

    @property
    def identity(self) -> Identity:
        """Software, vehicle and configuration."""
        loaded = self._service.loaded
        if self._known_as is None or self._known_as[0] is not loaded:
            made = Identity(__version__, loaded.config.vehicle.id, configuration_identity(loaded))
            self._known_as = loaded, made
        return self._known_as[1]

    @property
    def quality(self) -> int:
        """Quality of the present correction."""
        return self._service.engine.pipeline.quality

    @property
    def standing(self) -> bool | None:
        """True if the vehicle stands, by a speed at most two seconds old."""
        pipeline = self._service.engine.pipeline
        if pipeline.speed is None:
            return None
        tick, speed = pipeline.speed
        return None if pipeline.k - tick > SPEED_AGE_TICKS else abs(speed) < STANDING_SPEED

    @property
    def uptime(self) -> float:
        """Seconds since the start."""
        return self._clock() - self._began

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge; computed once a tick, however often it is
        requested.
        """
        pipeline = self._service.engine.pipeline
        known = self._estimate
        if known is None or known[0] is not pipeline.estimator or known[1] != pipeline.k:
            known = pipeline.estimator, pipeline.k, pipeline.estimator.estimate()
            self._estimate = known
        return known[2]

    def counts(self) -> FrameCounts:
        """Counters of engine and link."""
        engine, link = self._service.engine, self._service.link_counters
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
            "accelerometer": health.accelerometer_missing,
            "gyroscope": health.gyroscope_missing,
            "speed": health.speed_missing,
        }
        watched = {"accel": "accelerometer", "gyro": "gyroscope", "speed": "speed"}
        if self.uptime < START_S:
            watched = {}
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
            missing={name: missing[name] for c, name in watched.items() if c in channels},
            counts=self.counts(),
            state_corrupt=self._service.state_corrupt,
            faulty={
                name: [str(fault) for fault in faults.get(c, ())]
                for c, name in names.items()
                if c in channels
            },
        )

    def begin_calibration(self) -> None:
        """Restart and keep the former estimator for a return."""
        self._service.orders.begin(TESTER)

    def return_to_former(self) -> bool:
        """Use the former estimator again, unless it was made for other settings."""
        return self._service.orders.return_to_former(TESTER)

    def accept_calibration(self) -> None:
        """Drop the former estimator."""
        self._service.orders.accept()

    def check_sensors(self) -> bool:
        """Repeat the sensor check at the next rest; return whether there is one to repeat."""
        return self._service.check_sensors()

    @property
    def sensors_checked(self) -> bool:
        """True if the sensor check has been made."""
        return self._service.sensors_checked

    def forget(self) -> None:
        """Restart and forget all that was saved."""
        self._service.orders.reset(TESTER)

    @property
    def is_forgotten(self) -> bool:
        """True if no forgotten state would return at another start."""
        return self._service.state_forgotten


def configuration_identity(loaded: LoadedConfig) -> bytes:
    """Return 32 bytes (SHA-256) over the present settings and the databases that they name.

    Defaults count as if they were written in the file; comments and the order of keys do not count.
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
