"""What an estimator of the mount says: rotation, uncertainty, state, and what it waits for."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np
from msgspec import Struct, field
from numpy.typing import ArrayLike, NDArray

from imucald.core.rotations import (
    Matrix3,
    Rows,
    Vector,
    angles_from_rotation,
    quaternion_from_rotation,
)
from imucald.core.samples import GRAVITY
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

    They hold for `MountEstimate.judged_std`: that about x contains the road's crown.
    """

    usable: tuple[float, float, float]
    fine: tuple[float, float, float]


class Gate(Struct, frozen=True):
    """One thing that an estimate waits for.

    share: how much of it is there (0 to 1). left: driving that the rest takes, as the last minutes
    were [s]; None: not known.
    """

    name: str
    share: float
    left: float | None = None


class Progress(Struct, frozen=True):
    """How far an estimate is on its way to the state `goal`."""

    goal: MountState
    gates: tuple[Gate, ...]


def _rows(matrix: Matrix3) -> Rows:
    xx, xy, xz, yx, yy, yz, zx, zy, zz = matrix.ravel().tolist()
    return xx, xy, xz, yx, yy, yz, zx, zy, zz


HOUSING = ""
"""In the place of a channel: the rotation alone, see `Correction.of`."""
NO_OFFSET: Vector = (0.0, 0.0, 0.0)


class Correction(Struct, frozen=True):
    """What is applied to the samples of the next tick; matrices row by row.

    rotation: R_vehicle_from_sensor, of the housing: for what else sits in it, a magnetometer or
    another sensor with parallel axes, whose own errors nobody knows.
    force, force_offset: W and o [m/s^2, vehicle axes]; the accelerometer's W f_sensor - o is sent.
    rate, rate_offset: the same for the gyroscope [rad/s].
    """

    rotation: Rows
    force: Rows
    rate: Rows
    force_offset: Vector = NO_OFFSET
    rate_offset: Vector = NO_OFFSET

    @classmethod
    def turning(cls, R_vehicle_from_sensor: Matrix3) -> Correction:
        """That of sensors without an error of their own: a rotation (3, 3) alone."""
        rows = _rows(R_vehicle_from_sensor)
        return cls(rows, rows, rows)

    @classmethod
    def with_matrices(
        cls,
        R_vehicle_from_sensor: Matrix3,
        force: Matrix3,
        rate: Matrix3,
        force_offset: ArrayLike = NO_OFFSET,
        rate_offset: ArrayLike = NO_OFFSET,
    ) -> Correction:
        """The same from matrices (3, 3) and offsets (3,)."""
        a, b, c = np.asarray(force_offset, dtype=float).tolist()
        p, q, r = np.asarray(rate_offset, dtype=float).tolist()
        return cls(_rows(R_vehicle_from_sensor), _rows(force), _rows(rate), (a, b, c), (p, q, r))

    @property
    def is_rotation(self) -> bool:
        """Whether the correction of both sensors is a rotation and nothing else."""
        is_one = self.force == self.rotation and self.rate == self.rotation
        return is_one and self.force_offset == NO_OFFSET and self.rate_offset == NO_OFFSET

    def of(self, channel: str) -> tuple[Rows, Vector]:
        """Matrix and offset for the samples of a channel; the rotation for all but two."""
        if channel == "accel":
            return self.force, self.force_offset
        if channel == "gyro":
            return self.rate, self.rate_offset
        return self.rotation, NO_OFFSET

    def applied(self, channel: str, values: Sequence[float]) -> Vector:
        """A sample (3,) of a channel in vehicle axes."""
        # Each sample on a bus comes through here: `of` and `times` would double what it takes.
        if channel == "accel":
            matrix, offset = self.force, self.force_offset
        elif channel == "gyro":
            matrix, offset = self.rate, self.rate_offset
        else:
            matrix, offset = self.rotation, NO_OFFSET
        a, b, c, d, e, f, g, h, i = matrix
        x, y, z = values
        p, q, r = offset
        return (
            a * x + b * y + c * z - p,
            d * x + e * y + f * z - q,
            g * x + h * y + i * z - r,
        )

    def matrix(self) -> Matrix3:
        """R_vehicle_from_sensor (3, 3)."""
        return np.array(self.rotation).reshape(3, 3)


class SentDeviations(Struct, frozen=True):
    """Standard deviations of what is left in corrected samples of the true force and rate.

    With E = (applied matrix)(response of the sensor) - 1: xy, yx, zx, zy are the force's
    cross-talk E_xy, ..., of which E_xy is the part of a lateral force that the forward axis shows
    [rad]; zero_x, zero_y the force that it shows on level ground [m/s^2]; rate_xz, rate_yz the
    rate's E_xz and E_yz [rad].
    """

    xy: float
    yx: float
    zx: float
    zy: float
    zero_x: float
    zero_y: float
    rate_xz: float
    rate_yz: float

    @classmethod
    def of_rotation(
        cls, x: float, y: float, z: float, zero: tuple[float, float] = (0.0, 0.0)
    ) -> SentDeviations:
        """Where a rotation alone is applied: from its deviations about the vehicle's axes [rad].

        They speak of the angle of the housing. A rotation that is off by e leaves E = -skew(e), so
        that one angle is in several entries, which are not independent. Cross-axis errors of the
        sensors themselves are in them only as far as the covariance was widened for them; the
        deviation about x contains the crown of roads, and so zy and zero_y do.

        zero: the estimated zero of the accelerometer, level part in vehicle axes [m/s^2]. The
        rotation does not take it off, so it stays in the force on level ground. An error of that
        estimate leaves nothing there: the rotation is found from gravity less the estimate, and is
        wrong by as much in the other direction.
        """
        level = math.hypot(GRAVITY * y, zero[0]), math.hypot(GRAVITY * x, zero[1])
        return cls(z, z, y, x, *level, y, x)


class MountEstimate(Struct, frozen=True, dict=True):
    """One state of knowledge about the mount.

    R_vehicle_from_sensor: (3, 3), or None before there is any estimate.
    covariance: (3, 3) of the rotation-vector error about the vehicle's axes [rad^2]:
    R_true = exp(skew(e)) @ R_vehicle_from_sensor with e ~ (0, covariance).
    waiting_for: per angle, what is still missing, in words; no entry where nothing is.
    missing: the same as a code, for the bus.
    faults: contradictions between signals that stand, by the names of
    `contradictions.StandingFault`; while there is any, nothing is sent as good.
    targets: what `judged_std` must fall below; None where the estimator states none.
    progress: how far it is on the way to the next state; None where driving does not lead there.
    judged_as: (3,) deviations that are judged instead of those of the housing's rotation [rad];
    None: `std` itself is judged.
    matrices: what will be applied when it is reached, where that is more than the rotation.
    deviations: of what that leaves in the samples; None: `sent` follows from the covariance.
    """

    state: MountState
    R_vehicle_from_sensor: Matrix3 | None = None
    covariance: NDArray[np.float64] | None = None
    waiting_for: Mapping[str, str] = field(default_factory=dict)
    missing: Mapping[str, Missing] = field(default_factory=dict)
    details: Mapping[str, object] = field(default_factory=dict)
    faults: tuple[str, ...] = ()
    targets: Targets | None = None
    matrices: Correction | None = None
    deviations: SentDeviations | None = None
    judged_as: tuple[float, float, float] | None = None
    progress: Progress | None = None

    @property
    def judged_std(self) -> tuple[float, float, float] | None:
        """What states are judged by: deviations about the vehicle's x, y, z [rad], or None."""
        return self.std if self.judged_as is None else self.judged_as

    @cached_property
    def correction(self) -> Correction | None:
        """What will be applied when it is reached, or None."""
        if self.matrices is not None or self.R_vehicle_from_sensor is None:
            return self.matrices
        return Correction.turning(self.R_vehicle_from_sensor)

    @cached_property
    def sent(self) -> SentDeviations | None:
        """Deviations of what a consumer gets, or None."""
        if self.deviations is not None or self.std is None:
            return self.deviations
        return SentDeviations.of_rotation(*self.std)

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


class MountEstimator(Protocol):
    """What every mount estimator can do. Pure: no I/O, no clock.

    The pipeline calls `step` once per closed tick (10 Hz, see `motion.ticks`), in time order,
    without holes; `gap` when time was discontinuous before the next tick. `correction` is read
    after each step and applied to all samples of the next tick; None means not usable.
    """

    @property
    def correction(self) -> Correction | None:
        """What to apply now (smooth from tick to tick), or None: not usable yet."""
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
