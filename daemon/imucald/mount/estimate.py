"""What an estimator of the mount says: rotation, uncertainty, state, and what it waits for."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3, Rows, angles_from_rotation, quaternion_from_rotation
from imucald.motion.ticks import TickRow
from imucald.mount.angle_deviations import angle_deviations

ANGLES = ("roll", "pitch", "yaw")
BETWEEN_DRIVES_STD = (math.radians(0.3), math.radians(0.3), math.radians(0.15))
"""Roll, pitch, yaw [rad] by which a vehicle's body turns from drive to drive: load and springs do
not touch yaw much, tyres and axles do a little."""


class MountState(enum.IntEnum):
    """State of the mount calibration; the numbers are those on the bus."""

    WAITING = 0
    LEVELLED = 1
    USABLE = 2
    FINE = 3
    SUSPECT = 4
    RECALIBRATING = 5
    RESTORED = 6


class Missing(enum.IntEnum):
    """What an angle is waiting for; the numbers are those on the bus."""

    NOTHING = 0
    STANDSTILL = 1
    ACCELERATION = 2
    LEFT_TURN = 3
    RIGHT_TURN = 4
    TURNS = 5
    DIRECTION_OF_TRAVEL = 6
    AGREEMENT = 7
    MORE_DRIVING = 8
    ACCELEROMETER = 9
    SPEED = 10
    LEARNING_FROZEN = 14
    OTHER = 15


class Targets(Struct, frozen=True):
    """Standard deviations [rad] about the vehicle's x, y, z below which a state is reached.

    They hold for `MountEstimate.std`: that about x contains the road's crown.
    """

    usable: tuple[float, float, float]
    fine: tuple[float, float, float]


class MountEstimate(Struct, frozen=True, dict=True):
    """One state of knowledge about the mount.

    R_vehicle_from_sensor: (3, 3), or None before there is any estimate.
    covariance: (3, 3) of the rotation-vector error about the vehicle's axes [rad^2]:
    R_true = exp(skew(e)) @ R_vehicle_from_sensor with e ~ (0, covariance).
    waiting_for: per angle, what is still missing, in words; no entry where nothing is.
    missing: the same as a code, for the bus.
    faults: contradictions between signals that stand, by the names of
    `contradictions.StandingFault`; while there is any, nothing is sent as good.
    targets: what `std` must fall below; None where the estimator states none.
    """

    state: MountState
    R_vehicle_from_sensor: Matrix3 | None = None
    covariance: NDArray[np.float64] | None = None
    waiting_for: Mapping[str, str] = field(default_factory=dict)
    missing: Mapping[str, Missing] = field(default_factory=dict)
    details: Mapping[str, object] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    targets: Targets | None = None

    @cached_property
    def angles(self) -> tuple[float, float, float] | None:
        """Roll, pitch, yaw [rad], or None."""
        if self.R_vehicle_from_sensor is None:
            return None
        return angles_from_rotation(self.R_vehicle_from_sensor)

    @cached_property
    def quaternion(self) -> tuple[float, float, float, float] | None:
        """Unit quaternion (w, x, y, z), or None."""
        if self.R_vehicle_from_sensor is None:
            return None
        return quaternion_from_rotation(self.R_vehicle_from_sensor)

    @cached_property
    def std(self) -> tuple[float, float, float] | None:
        """Standard deviations [rad] of the rotation-vector error about vehicle x, y, z."""
        if self.covariance is None:
            return None
        x, y, z = (math.sqrt(max(float(self.covariance[i, i]), 0.0)) for i in range(3))
        return x, y, z

    @cached_property
    def angle_std(self) -> tuple[float, float, float] | None:
        """Standard deviations [rad] of roll, pitch and yaw themselves; inf where not known."""
        if self.R_vehicle_from_sensor is None or self.covariance is None:
            return None
        return angle_deviations(self.R_vehicle_from_sensor, self.covariance.tolist())


Correction = Rows
"""R_vehicle_from_sensor to apply to the samples of the next tick, row by row."""


class MountEstimator(Protocol):
    """The verbs of every mount estimator. Pure: no I/O, no clock.

    The pipeline calls `step` once per closed tick (10 Hz, see `motion.ticks`), in time order,
    without holes; `gap` when time was discontinuous before the next tick. `correction` is read
    after each step and applied to all samples of the next tick; None means not usable.
    """

    @property
    def correction(self) -> Correction | None:
        """The rotation to apply now (smooth from tick to tick), or None: not usable yet."""
        ...

    @property
    def state(self) -> MountState:
        """The present state; cheap, read after each step."""
        ...

    def step(self, tick: TickRow) -> None:
        """Take one tick."""
        ...

    def gap(self) -> None:
        """Time jumped: nothing before this may be differenced with what follows."""
        ...

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge."""
        ...


@runtime_checkable
class JudgesSignals(Protocol):
    """An estimator that finds out which of the vehicle's signals are stuck, and leaves them out."""

    @property
    def stuck_signals(self) -> Mapping[str, bool]:
        """By channel, whether it was stuck in the last block; a new mapping for every block."""
        ...


@runtime_checkable
class KeepsTicks(Protocol):
    """An estimator that for most ticks does nothing but keep them; replay hands those over at once.

    What comes of it equals `step` tick by tick, to the last bit.
    """

    def expect(self, ticks: NDArray[np.float64]) -> None:
        """Look at the ticks (n, COLUMNS) that come next: some of the work is less in one go.

        They are still to be taken, by `step` or `keep_quiet`, unless time jumps before.
        """
        ...

    def quiet_ticks(self) -> int:
        """Of the next ticks so many change neither correction, state nor estimate."""
        ...

    def keep_quiet(self, ticks: NDArray[np.float64]) -> None:
        """Take ticks (n, COLUMNS), no more than `quiet_ticks`."""
        ...
