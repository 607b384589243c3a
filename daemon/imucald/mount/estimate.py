"""Output of a mount estimator: rotation, uncertainty, state, missing evidence."""

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
"""Standard deviation of the change of a vehicle body's roll, pitch and yaw between drives [rad].

Load and springs hardly change the yaw. Tyres and axles change the yaw a little.
"""


class MountState(enum.IntEnum):
    """State of the mount calibration. The numbers are also sent on the bus."""

    WAITING = 0
    LEVELLED = 1
    USABLE = 2
    FINE = 3
    SUSPECT = 4
    RECALIBRATING = 5
    RESTORED = 6


GOOD_NAMES = ("usable", "fine")
"""Names of the states in which a mount counts as good. Files and `status` use these names."""


class Missing(enum.IntEnum):
    """Reason why an angle is not known yet. The numbers are also sent on the bus."""

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

    The targets are compared with `MountEstimate.judged_std`. The judged deviation about x may
    contain the road's crown.
    """

    usable: tuple[float, float, float]
    fine: tuple[float, float, float]


class Gate(Struct, frozen=True):
    """One condition of the next state.

    share: fulfilled share (0 to 1). left: driving time until the condition is met [s], at the pace
    of the last minutes; None: not known.
    """

    name: str
    share: float
    left: float | None = None


class Progress(Struct, frozen=True):
    """Progress of an estimate towards the state `goal`."""

    goal: MountState
    gates: tuple[Gate, ...]


def _rows(matrix: Matrix3) -> Rows:
    xx, xy, xz, yx, yy, yz, zx, zy, zz = matrix.ravel().tolist()
    return xx, xy, xz, yx, yy, yz, zx, zy, zz


HOUSING = ""
"""Channel name for the rotation alone, see `Correction.matrix_and_offset`."""
NO_OFFSET: Vector = (0.0, 0.0, 0.0)


class Correction(Struct, frozen=True):
    """Correction of the samples of the next tick; matrices row by row.

    rotation: R_vehicle_from_sensor of the housing. This rotation is also applied to other sensors
    in the housing with parallel axes and unknown errors, such as a magnetometer. force,
    force_offset: matrix W and offset o of the accelerometer [m/s^2, vehicle axes]. The corrected
    sample is W f_sensor - o. rate, rate_offset: matrix and offset of the gyroscope [rad/s], used in
    the same way.
    """

    rotation: Rows
    force: Rows
    rate: Rows
    force_offset: Vector = NO_OFFSET
    rate_offset: Vector = NO_OFFSET

    @classmethod
    def turning(cls, R_vehicle_from_sensor: Matrix3) -> Correction:
        """Return the correction for sensors without errors of their own: a rotation (3, 3)
        alone."""
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
        """Return the correction from matrices (3, 3) and offsets (3,)."""
        a, b, c = np.asarray(force_offset, dtype=float).tolist()
        p, q, r = np.asarray(rate_offset, dtype=float).tolist()
        return cls(_rows(R_vehicle_from_sensor), _rows(force), _rows(rate), (a, b, c), (p, q, r))

    @property
    def is_rotation(self) -> bool:
        """True if the correction of both sensors is a pure rotation."""
        is_one = self.force == self.rotation and self.rate == self.rotation
        return is_one and self.force_offset == NO_OFFSET and self.rate_offset == NO_OFFSET

    def matrix_and_offset(self, channel: str) -> tuple[Rows, Vector]:
        """Return the matrix and the offset for the samples of a channel. A channel other than
        "accel" and "gyro" gets the rotation alone.
        """
        if channel == "accel":
            return self.force, self.force_offset
        if channel == "gyro":
            return self.rate, self.rate_offset
        return self.rotation, NO_OFFSET

    def applied(self, channel: str, values: Sequence[float]) -> Vector:
        """Return the corrected sample (3,) of a channel in vehicle axes."""
        # Each sample on a bus passes through here: `matrix_and_offset` and `times` would double
        # the time.
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
    """Standard deviations of the errors that remain in corrected samples of force and rate.

    The error matrix is E = (applied matrix)(response of the sensor) - 1. xy, yx, zx, zy: cross-talk
    E_xy, E_yx, E_zx, E_zy of the force. E_xy is the part of a lateral force that the forward axis
    shows [rad]. zero_x, zero_y: corrected force on level ground [m/s^2]. rate_xz, rate_yz: E_xz and
    E_yz of the rate [rad].
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
        """Return the deviations of samples that are corrected by a rotation alone.

        x, y, z: deviations of this rotation about the vehicle's axes [rad]. A rotation with the
        error e leaves E = -skew(e). The same angle is then in several entries of E, so the entries
        are not independent. Cross-axis errors of the sensors are included only as far as the
        covariance was enlarged for them. The deviation about x contains the crown of roads, so zy
        and zero_y contain the crown too. zero: level part of the accelerometer's estimated zero
        error, in vehicle axes [m/s^2]. The rotation does not remove this zero error, so it remains
        in the force on level ground. An error of the estimated zero error has no effect on level
        ground: the rotation is computed from gravity minus the estimate, so the rotation has an
        error of the same size and the opposite sign.
        """
        level = math.hypot(GRAVITY * y, zero[0]), math.hypot(GRAVITY * x, zero[1])
        return cls(z, z, y, x, *level, y, x)


class MountEstimate(Struct, frozen=True, dict=True):
    """Knowledge about the mount at one time.

    R_vehicle_from_sensor: (3, 3), or None before there is any estimate. covariance: (3, 3) of the
    rotation-vector error about the vehicle's axes [rad^2]: R_true = exp(skew(e)) @
    R_vehicle_from_sensor with e ~ (0, covariance). waiting_for: missing evidence of each angle in
    words; an angle without missing evidence has no entry. missing: missing evidence of each angle
    as a code for the bus. faults: present contradictions between signals, by the names of
    `contradictions.StandingFault`. While a fault is present, no data are sent as good. targets:
    limits for `judged_std`; None if the estimator has no limits. progress: progress to the next
    state; None if driving cannot reach the next state. judged_as: (3,) deviations that are compared
    with the targets [rad]; None: `std` is compared. matrices: correction that will be applied once
    the transition is over; None: the correction is the rotation alone. deviations: deviations of
    the errors that remain after `matrices`; None: `sent` is computed from the covariance.
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
        """Deviations about the vehicle's x, y, z [rad] that are compared with the targets, or
        None."""
        return self.std if self.judged_as is None else self.judged_as

    @cached_property
    def correction(self) -> Correction | None:
        """Correction that will be applied once the transition is over, or None."""
        if self.matrices is not None or self.R_vehicle_from_sensor is None:
            return self.matrices
        return Correction.turning(self.R_vehicle_from_sensor)

    @cached_property
    def sent(self) -> SentDeviations | None:
        """Deviations of the errors in the corrected samples, or None."""
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
        """Standard deviations [rad] of the angles roll, pitch and yaw; inf if not known."""
        if self.R_vehicle_from_sensor is None or self.covariance is None:
            return None
        return angle_deviations(self.R_vehicle_from_sensor, self.covariance.tolist())


class MountEstimator(Protocol):
    """Interface of every mount estimator. An estimator does no I/O and reads no clock.

    The pipeline calls `step` once per closed tick (10 Hz, see `motion.ticks`), in time order and
    without holes. If time jumps, the pipeline calls `gap` before the next tick. The pipeline reads
    `correction` after each step and applies it to all samples of the next tick. A correction of
    None means that there is no usable correction.
    """

    @property
    def correction(self) -> Correction | None:
        """Present correction, which changes smoothly from tick to tick, or None: not usable yet."""
        ...

    @property
    def state(self) -> MountState:
        """The present state. The pipeline reads this property after each step, so it must be
        cheap."""
        ...

    def step(self, tick: TickRow) -> None:
        """Process one tick."""
        ...

    def gap(self) -> None:
        """Note a jump of time: no difference is taken between values before the jump and values
        after it."""
        ...

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge."""
        ...


@runtime_checkable
class JudgesSignals(Protocol):
    """Interface of an estimator that finds stuck vehicle signals and does not use them."""

    @property
    def stuck_signals(self) -> Mapping[str, bool]:
        """True or False for each channel: whether the channel was stuck in the last block.

        The mapping is a new object for every block.
        """
        ...


@runtime_checkable
class KeepsTicks(Protocol):
    """Interface of an estimator that only stores most ticks. Replay passes such ticks together.

    The result equals the result of `step` tick by tick, to the last bit.
    """

    def quiet_ticks(self) -> int:
        """Return the number of next ticks that change neither correction, state nor estimate."""
        ...

    def keep_quiet(self, ticks: NDArray[np.float64]) -> None:
        """Process ticks (n, COLUMNS). n must not be larger than `quiet_ticks`."""
        ...
