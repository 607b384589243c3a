"""What the full estimator is told about sensor, vehicle and road: priors, limits, delays.

Every figure is a prior or a promise that the intervals rest on; `priors` says where each comes
from.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from imucald.mount.priors import (
    ACCEL_BIAS_STD,
    ACCEL_SCALE_STD,
    GYRO_MISALIGNMENT_STD,
    SLOPE_LENGTH,
    SLOPE_STD,
    UNDERSTEER,
)


@dataclass(frozen=True)
class DelayPrior:
    """Lateness of a vehicle signal against the accelerometer, before data speak [s].

    Positive: the signal arrives late. Sought within mean +- 4 std (at most -0.5 .. 1.2 s).
    """

    mean: float = 0.1
    std: float = 0.3


@dataclass(frozen=True)
class EstimatorSettings:
    """Settings of `FullEstimator`; SI units, angles in rad."""

    accel_bias_std: float = ACCEL_BIAS_STD
    """Accelerometer bias per axis [m/s^2], one standard deviation; 10 mg."""
    slope_std: float = SLOPE_STD
    """Road slope along and (about its mean) across the vehicle, rms tangent."""
    slope_length: float = SLOPE_LENGTH
    """Distance over which the slope forgets itself [m]."""
    unevenness: tuple[float, float] = (1.0, 1.0)
    """How many times `slope_std` the roads' tangents across and along are, where a model says that
    they are more uneven; what is taken for a moved sensor bears it in mind."""
    driving_side: str = "right"
    """"right" or "left": the kerb, towards which roads lean; "none": no mean lean."""
    crown_mean: float = 0.012
    """Mean lean of the road towards the kerb (tangent)."""
    crown_std: float = 0.0065
    """Spread of that mean from drive to drive; no drive can tell it from mount roll."""
    accel_cross_axis_std: float = 0.0
    """Cross-axis error of the accelerometer (part); bounds what the accelerometer can say."""
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
    steering_ratio: float | None = None
    """Steering-wheel angle over road-wheel angle; None: steering is not used for yaw rate."""
    wheelbase: float = 2.7
    """[m]"""
    understeer: float = UNDERSTEER
    """K in r = v * delta / (n * L * (1 + K v^2 / L)) [rad/(m/s^2)]."""
    track: float = 1.55
    """Distance between left and right wheels [m]."""
    accel_range: float = math.inf
    """Full scale of the accelerometer [m/s^2]; beyond 98 % of it nothing is learnt."""
    usable_std: float = math.radians(1.0)
    """Yaw is usable below this standard deviation."""
    usable_tilt_std: float = math.radians(2.0)
    fine_std: float = math.radians(0.3)
    fine_tilt_std: float = math.radians(0.7)

    @property
    def crown(self) -> float:
        """Expected lean as roll of the vehicle [rad]: positive where traffic keeps right."""
        sign = {"right": 1.0, "left": -1.0}.get(self.driving_side, 0.0)
        return sign * self.crown_mean
