"""How the mount is found; defaults are those of the estimators."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta

from imucald.config.base import Model, NotNegative, Positive
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.method_a.settings import PublishedSettings

_METHOD_A = PublishedSettings()
_FULL = EstimatorSettings()


def _deg(radians: float) -> float:
    return round(math.degrees(radians), 6)


class StaticTest(Model, frozen=True):
    """Method A, steps 1 to 3: when the vehicle stands, and its tilt from gravity."""

    samples: Annotated[int, Meta(ge=2, le=100_000)] = _METHOD_A.static.count
    """Accelerometer samples that a window needs."""
    duration: Positive = _METHOD_A.static.seconds
    """Time that it must span [s]."""
    threshold: tuple[Positive, Positive, Positive] = _METHOD_A.static.thresholds
    """Largest max - min per axis [m/s^2], where speed is not known."""
    threshold_at_zero_speed: tuple[Positive, Positive, Positive] = (
        _METHOD_A.static.thresholds_at_zero_speed
    )
    """The same where speed is known to be zero: a running engine shakes the sensor."""
    standstill_speed: Positive = _METHOD_A.standstill_speed
    """Speed up to which the vehicle stands [m/s]."""
    average_stops: bool = _METHOD_A.average_stops
    """All stops count (beyond the publication); else the last one decides."""


class StraightMotion(Model, frozen=True):
    """Method A, step 4: which motion counts as straight and of variable speed."""

    recognise_by: Annotated[
        tuple[Literal["yaw_rate", "steering", "consistency"], ...], Meta(min_length=1)
    ] = ("yaw_rate", "steering", "consistency")
    """In order of preference; the first whose signal is there decides."""
    yaw_rate_limit_deg_s: Positive = _deg(_METHOD_A.yaw_rate_limit)
    yaw_rate_limit_without_speed_deg_s: Positive = _deg(_METHOD_A.yaw_rate_limit_without_speed)
    steering_limit_deg: Positive = _deg(_METHOD_A.steering_limit)
    lateral_limit: NotNegative = _METHOD_A.lateral_limit
    """Largest |v r| [m/s^2]; 0 switches this gate off."""
    min_speed_change: Positive = _METHOD_A.min_speed_change
    """Smallest |dv/dt| [m/s^2]."""
    manoeuvre_peak: Positive = _METHOD_A.manoeuvre_peak
    """|dv/dt| that a manoeuvre must reach to count [m/s^2]."""
    min_speed: Positive = _METHOD_A.min_speed
    """[m/s]"""
    consistency_window: Annotated[int, Meta(ge=2, le=1000)] = _METHOD_A.consistency_window
    """Successive angles, ten a second, that must agree."""
    consistency_range_deg: Positive = _deg(_METHOD_A.consistency_spread)


class TargetAngle(Model, frozen=True):
    """Method A, step 5: the yaw angle and its sign."""

    sign_from: Annotated[
        tuple[Literal["speed", "brake", "turn", "first_motion"], ...], Meta(min_length=1)
    ] = ("speed", "brake", "turn", "first_motion")
    """What may tell accelerating from braking, in order of preference."""
    subtract_lateral: bool = _METHOD_A.subtract_lateral
    """Subtract v r where speed and yaw rate are known (beyond the publication)."""
    remove_offset_after: NotNegative = _METHOD_A.remove_offset_after
    """Time constant of the mean that is removed, since slope and bias wander [s]; 0: never."""


class States(Model, frozen=True):
    """From which standard deviations on the estimate is used; left again at 1.4 times.

    Where they are not given, each estimator has its own.
    """

    usable_yaw_deg: Positive | None = None
    usable_tilt_deg: Positive | None = None
    fine_yaw_deg: Positive | None = None
    fine_tilt_deg: Positive | None = None


class Calibration(Model, frozen=True):
    """How the mount is found."""

    estimator: Literal["full", "published"] = "full"
    """"published" is method A alone; "full" fuses all the evidence there is."""
    accelerometer_bias: Positive = round(_FULL.accel_bias_std, 6)
    """Standard deviation of the accelerometer's zero error [m/s^2]."""
    accelerometer_range: Positive | None = None
    """Full scale [m/s^2]; nothing is learnt close to it."""
    cross_axis: Annotated[float, Meta(ge=0, le=0.05)] = 0.0
    """Cross-axis error of the accelerometer (part): widens the intervals."""
    speed_delay: Annotated[float, Meta(ge=-0.5, le=1.2)] | None = None
    """How late speed is against the accelerometer [s]; estimated when absent."""
    states: States = States()
    static: StaticTest = StaticTest()
    straight: StraightMotion = StraightMotion()
    target_angle: TargetAngle = TargetAngle()
