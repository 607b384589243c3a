"""What the full estimator is given about sensor, vehicle and road: priors, limits, delays.

Every figure is a prior or a promise that the intervals rest on; `priors` says where each comes
from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cached_property
from typing import ClassVar, NamedTuple

from msgspec import Struct, field

from imucald.config.calibration import CalibrationSettings
from imucald.config.vehicle import VehicleSettings
from imucald.core.default_vehicle import UNDERSTEER
from imucald.mount.estimate import Targets
from imucald.mount.priors import (
    ACCEL_SCALE_STD,
    GYRO_MISALIGNMENT_STD,
    SLOPE_LENGTH,
    SLOPE_STD,
)


class DelayPrior(Struct, frozen=True):
    """Lateness of a vehicle signal against the accelerometer, before data speak [s].

    Positive: the signal arrives late. It is sought within what can be configured; where the delay
    is stated (`delay.SEARCHED_STD`), within mean +- 4 std too.
    """

    mean: float = 0.1
    std: float = 0.3


class Limits(NamedTuple):
    """Standard deviations [rad] below which an estimate is usable, and fine."""

    usable_yaw: float
    usable_tilt: float
    fine_yaw: float
    fine_tilt: float

    def about_axes(self, crown: float = 0.0) -> Targets:
        """The same about each axis of the vehicle; crown: what is in the roll besides [rad]."""
        usable, fine = self.usable_tilt, self.fine_tilt
        return Targets(
            (math.hypot(usable, crown), usable, self.usable_yaw),
            (math.hypot(fine, crown), fine, self.fine_yaw),
        )


class MountSettings(Struct, frozen=True, dict=True):
    """What both estimators take from the configuration, and what a model file knows better.

    crown_mean: mean lean of the roads towards the kerb (tangent); None: the configuration's.
    """

    OWN_LIMITS: ClassVar[Limits]
    """The estimator's, where the configuration gives none."""

    calibration: CalibrationSettings = field(default_factory=CalibrationSettings)
    vehicle: VehicleSettings = field(default_factory=VehicleSettings)
    crown_mean: float | None = None

    @cached_property
    def crown(self) -> float:
        """Expected lean as roll of the vehicle [rad]: positive where traffic keeps right."""
        mean = self.vehicle.crown_mean if self.crown_mean is None else self.crown_mean
        return self.vehicle.kerb * mean

    @cached_property
    def limits(self) -> Limits:
        """Limits of the states: the configured ones, else the estimator's own."""
        given, own = self.calibration.states, self.OWN_LIMITS
        return Limits(
            given.usable_yaw or own.usable_yaw,
            given.usable_tilt or own.usable_tilt,
            given.fine_yaw or own.fine_yaw,
            given.fine_tilt or own.fine_tilt,
        )

    @cached_property
    def targets(self) -> Targets:
        """The same about each axis of the vehicle, with the crown that roll cannot be rid of."""
        return self.limits.about_axes(self.vehicle.crown_std)


class EstimatorSettings(MountSettings, frozen=True):
    """What the user sets, what a model file says, and priors that nobody sets. SI units, rad."""

    OWN_LIMITS = Limits(
        usable_yaw=math.radians(1.0),
        usable_tilt=math.radians(2.0),
        fine_yaw=math.radians(0.3),
        fine_tilt=math.radians(0.7),
    )

    slope_std: float = SLOPE_STD
    """Road slope along and (about its mean) across the vehicle, rms tangent."""
    slope_length: float = SLOPE_LENGTH
    """Distance over which the slope forgets itself [m]."""
    unevenness: tuple[float, float] = (1.0, 1.0)
    """How many times `slope_std` the roads' tangents across and along are, where a model says that
    they are more uneven; what is taken for a moved sensor bears it in mind."""
    accel_scale_std: float = ACCEL_SCALE_STD
    """Scale error per axis of the accelerometer (part): in a tilted sensor a cross-axis error."""
    gyro_misalignment_std: float = GYRO_MISALIGNMENT_STD
    """Turn of the gyroscope's triad against the accelerometer's [rad]."""
    delays: Mapping[str, DelayPrior] = field(
        default_factory=lambda: {"speed": DelayPrior(0.1, 0.3), "yaw_rate": DelayPrior(0.05, 0.1)}
    )
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the sensor from the body's centre of rotation, vehicle axes [m], where a model knows it;
    what it is beyond that is found as nuisance."""
    understeer: float = UNDERSTEER
    """K in r = v * delta / (n * L * (1 + K v^2 / L)) [rad/(m/s^2)]."""
    uses_steering: bool = False
    """Whether the angle of the steering wheel may stand for the yaw rate."""
    are_sides_turned: bool = False
    """Whether the configuration turns signals that know left from right, so that as likely as not
    the accelerometer is mirrored instead (`mirror`): what they say of it is no confirmation."""
