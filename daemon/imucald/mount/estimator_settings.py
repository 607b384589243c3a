"""Settings of the joint estimator about sensor, vehicle and road: priors, limits, delays.

The intervals of the estimate depend on these values. `joint.state.Priors` gives sources.
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
from imucald.core.samples import GRAVITY
from imucald.drive.roads import SLOPE
from imucald.mount.estimate import Targets


class DelayPrior(Struct, frozen=True):
    """Prior of the delay of a vehicle signal against the accelerometer [s].

    Positive: the signal arrives late. The default allows every delay that can be configured.
    """

    mean: float = 0.1
    std: float = 0.5


class Limits(NamedTuple):
    """Standard deviations [rad] below which an estimate is usable, or fine."""

    usable_yaw: float
    usable_tilt: float
    fine_yaw: float
    fine_tilt: float

    def about_axes(self, crown: float = 0.0) -> Targets:
        """Return the limits about each axis of the vehicle.

        crown: additional deviation of the roll [rad].
        """
        usable, fine = self.usable_tilt, self.fine_tilt
        return Targets(
            (math.hypot(usable, crown), usable, self.usable_yaw),
            (math.hypot(fine, crown), fine, self.fine_yaw),
        )


class MountSettings(Struct, frozen=True, dict=True):
    """Settings of both estimators, from the configuration or, where it has them, from the model
    file.

    crown_mean: mean lean of the roads towards the kerb (tangent); None: use the value of the
    configuration.
    """

    OWN_LIMITS: ClassVar[Limits]
    """Limits of the estimator itself, used where the configuration gives none."""

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
        """Limits of the states: the configured limits, otherwise the limits of the estimator
        itself."""
        given, own = self.calibration.states, self.OWN_LIMITS
        return Limits(
            given.usable_yaw or own.usable_yaw,
            given.usable_tilt or own.usable_tilt,
            given.fine_yaw or own.fine_yaw,
            given.fine_tilt or own.fine_tilt,
        )

    @cached_property
    def targets(self) -> Targets:
        """Limits about each axis of the vehicle. The limit about x includes the crown, because the
        roll always contains the crown.
        """
        return self.limits.about_axes(self.vehicle.crown_std)


LEVEL = (0.2, 0.1)
"""Level zero below which an estimate is usable, and below which it is fine [m/s^2]."""


class EstimatorSettings(MountSettings, frozen=True):
    """Settings by the user, settings from a model file, and fixed priors. SI units, rad."""

    OWN_LIMITS = Limits(
        usable_yaw=math.radians(1.0),
        usable_tilt=LEVEL[0] / GRAVITY,
        fine_yaw=math.radians(0.3),
        fine_tilt=LEVEL[1] / GRAVITY,
    )
    """Limits of the cross-talk xy and yx, as a yaw angle, and of the level zero, as a tilt."""

    slope: float = SLOPE
    """Prior deviation of the roads' slopes (tangent). A model file may state steeper roads."""
    delays: Mapping[str, DelayPrior] = field(
        default_factory=lambda: {"speed": DelayPrior(), "yaw_rate": DelayPrior(0.05, 0.1)}
    )
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Lever arm of the sensor from the body's centre of rotation, vehicle axes [m], if a model file
    states it. The remaining lever arm is estimated as a nuisance parameter.
    """
    understeer: float = UNDERSTEER
    """K in r = v * delta / (n * L * (1 + K v^2 / L)) [rad/(m/s^2)]."""
    uses_steering: bool = False
    """True if the steering wheel angle may replace the yaw rate."""
    are_sides_turned: bool = False
    """True if the configuration inverts the sign of signals that distinguish left from right.

    In this case the accelerometer may be mirrored instead (`mirror`), so these signals do not
    confirm its signs.
    """
