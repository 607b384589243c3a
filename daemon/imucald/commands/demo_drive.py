"""The demonstration: a simulated car and the real daemon on one virtual bus, in one process.

The car sends its frames in slices, with time stamps in simulated time. After each slice, the daemon
works until its queue is empty. Therefore a drive runs as fast as the machine allows, and always
gives the same numbers. A listener represents the control unit that uses the corrected frames. The
listener knows only ``imucald_out.dbc``, and accepts a frame only if its counter and checksum are
correct.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK
from imucald.can.python_can import can
from imucald.config import LoadedConfig, parse_config
from imucald.core.rotations import Matrix3, angles_from_rotation
from imucald.inputs.wiring import compile_router
from imucald.mount.estimate import ANGLES, MountEstimate
from imucald.mount.mount_words import SD_95
from imucald.runtime.input_health import LinkHealth
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.session import make_engine
from imucald.service.live import Daemon, open_link
from imucald.simulation.drive import Drive
from imucald.traffic.can_log import EPOCH_S, live_frames
from imucald.traffic.drive_encoder import BusEncoder

SLICE_S = 0.25
"""Length of a slice of the drive that the car sends before the daemon runs [s]. With this length,
the picture changes four times per second of driving, and the queues contain about a hundred frames.
"""
LAST_S = 60.0
"""Length of the part at the end of the drive in which acceleration and truth are compared [s]."""
UNKNOWN_STD = 1.0
"""An angle with a larger standard deviation counts as unknown [rad]."""

_LISTENER = """
database: imucald_out.dbc
signals:
  accelerometer:
    x: {signal: IMUCALD_Acceleration.AccelX, not_available: [-32768]}
    y: {signal: IMUCALD_Acceleration.AccelY, not_available: [-32768]}
    z: {signal: IMUCALD_Acceleration.AccelZ, not_available: [-32768]}
messages:
  IMUCALD_Acceleration:
    counter: {signal: Counter}
    checksum: {kind: crc8_j1850, signal: Checksum, id_bytes: 2}
"""
_channel_numbers = itertools.count()


@dataclass(frozen=True)
class Angle:
    """One mount angle and its true value [rad]. std: standard deviation of the angle. error:
    estimate minus truth."""

    name: str
    estimate: float
    std: float
    truth: float
    error: float

    @property
    def inside(self) -> bool:
        """True if the truth is within the 95 % interval."""
        return abs(self.error) <= SD_95 * self.std


@dataclass(frozen=True)
class Comparison:
    """Root mean square of the acceleration's error vector [m/s^2], over `count` samples.

    measured: error if the sensor's axes are used as the vehicle's axes. corrected: error of the
    samples in imucald's frames. known_mount: error if the mount were known exactly (from noise,
    vibration and bias).
    """

    count: int
    measured: float
    corrected: float
    known_mount: float


class Listener:
    """Another control unit on the bus. The listener decodes imucald's corrected acceleration."""

    def __init__(self) -> None:
        place = Path(str(resources.files("imucald"))) / "data" / "listener.yaml"
        self._router = compile_router(parse_config(_LISTENER, place))
        self.can_id = self._router.matches[0].can_id
        self.frames = 0
        """Number of frames for corrected acceleration, including frames *not available*."""
        self.values: list[tuple[float, ...] | None] = []
        """Corrected acceleration [m/s^2] in each frame; None for *not available*."""

    @property
    def damaged(self) -> int:
        """Number of frames with a wrong counter or checksum."""
        rejected = self._router.rejected
        return rejected.total() - rejected["not_available"]

    def take_frame(self, t: float, can_id: int, data: bytes) -> None:
        """Process one frame from the bus."""
        if can_id != self.can_id:
            return
        self.frames += 1
        samples, _, _ = self._router.frame(t, can_id, data)
        self.values.append(tuple(samples[0][1]) if samples else None)


class Demonstration:
    """A drive, the daemon and a listener on a virtual bus; a context manager.

    drive: the simulated drive of the car. loaded: the configuration, as for a real car.
    """

    def __init__(self, drive: Drive, loaded: LoadedConfig) -> None:
        self.drive = drive
        self.now = 0.0
        """Time in the drive [s]."""
        self.sent = 0
        """Number of frames that the car has sent."""
        self.snapshots: list[Snapshot] = []
        self.listener = Listener()
        self._frames = live_frames(drive, BusEncoder(loaded))
        self.engine = make_engine(loaded, self.snapshots.append, self._link_health)
        channel = f"imucald-demo-{next(_channel_numbers)}"
        self._car = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
        ids = self.engine.output.can_ids
        self.link = open_link(loaded, self.engine.router.matches, ids, "virtual", channel)
        # its clock advances in slices of the drive, so no frame is late
        self.daemon = Daemon(self.engine, self.link, lambda: self.now, max_age=math.inf)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.link.close()
        self._car.shutdown()

    def _link_health(self) -> LinkHealth:
        return self.daemon.link_health()

    # running -------------------------------------------------------------------------------

    def run(self) -> Iterator[float]:
        """Run the whole drive. Yields the time in the drive [s] after each slice."""
        waiting = next(self._frames, None)
        while waiting is not None:
            self.now += SLICE_S
            while waiting is not None and waiting[0] <= self.now:
                self._send(*waiting)
                waiting = next(self._frames, None)
            while self.daemon.serve_once(0.0):
                pass
            self._listen()
            yield self.now

    def _send(self, t: float, can_id: int, data: bytes) -> None:
        self._car.send(
            can.Message(
                timestamp=EPOCH_S + t,
                arbitration_id=can_id & CAN_EFF_MASK,
                is_extended_id=bool(can_id & CAN_EFF_FLAG),
                data=data,
            )
        )
        self.sent += 1

    def _listen(self) -> None:
        while (message := self._car.recv(0.0)) is not None:
            flag = CAN_EFF_FLAG if message.is_extended_id else 0
            self.listener.take_frame(self.now, message.arbitration_id | flag, bytes(message.data))

    # results -------------------------------------------------------------------------------

    @property
    def truth(self) -> Matrix3:
        """The true mount, R_vehicle_from_sensor."""
        return self.drive.truth.R_vehicle_from_sensor(self.now)

    def estimate(self) -> MountEstimate:
        """The daemon's present estimate."""
        return self.engine.pipeline.estimator.estimate()

    def motion(self) -> tuple[float, float, float]:
        """True present speed [m/s], change of speed [m/s^2] and yaw rate [rad/s]."""
        truth = self.drive.truth
        i = min(int(np.searchsorted(truth.t, self.now)), len(truth.t) - 1)
        return float(truth.speed[i]), float(truth.acceleration[i]), float(truth.yaw_rate[i])

    def acceleration(self) -> tuple[NDArray[np.float64], tuple[float, ...] | None]:
        """Return the newest acceleration as measured (3,) and as corrected [m/s^2]."""
        series = self.drive.samples["accel"]
        i = min(max(self.listener.frames, 1), len(series.t)) - 1
        return series.values[i], self.listener.values[-1] if self.listener.values else None

    def compare(self, last_s: float = LAST_S) -> Comparison | None:
        """Compare the acceleration that the listener received with the truth. None if the listener
        received no acceleration.

        Each accelerometer sample gives one corrected frame, so sample n belongs to frame n.
        """
        series, truth = self.drive.samples["accel"], self.drive.truth
        n = min(len(self.listener.values), len(series.t))
        chosen = [
            i
            for i in range(int(np.searchsorted(series.t, self.now - last_s)), n)
            if self.listener.values[i] is not None
        ]
        if not chosen:
            return None
        t, measured = series.t[chosen], series.values[chosen]
        corrected = np.array([self.listener.values[i] for i in chosen])
        real = np.column_stack([np.interp(t, truth.t, truth.force[:, i]) for i in range(3)])
        known = measured @ self.truth.T
        return Comparison(len(chosen), _rms(measured - real), _rms(corrected - real),
                          _rms(known - real))  # fmt: skip


def _rms(error: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(np.sum(error * error, axis=1))))


def angles_beside(estimate: MountEstimate, truth: Matrix3) -> list[Angle]:
    """Return the known angles of roll, pitch and yaw (see `UNKNOWN_STD`), with the truth."""
    R, std = estimate.R_vehicle_from_sensor, estimate.angle_std
    if R is None or std is None:
        return []
    here, real = angles_from_rotation(R), angles_from_rotation(truth)
    return [
        Angle(name, here[i], std[i], real[i], math.remainder(here[i] - real[i], 2.0 * math.pi))
        for i, name in enumerate(ANGLES)
        if std[i] < UNKNOWN_STD
    ]
