"""Settings of the mount estimators."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta

from imucald.config.base import (
    Angle,
    NotNegative,
    PerAxis,
    Positive,
    Radians,
    RadiansOrNone,
    RadiansPerAxis,
    Settings,
    SpeedDelay,
)


class StaticTestSettings(Settings, frozen=True):
    """Method A, steps 1 to 3: standstill, and tilt from gravity."""

    samples: Annotated[int, Meta(ge=2, le=100_000)] = 20
    """Smallest number of accelerometer samples in a window at rest."""
    duration: Positive = 2.0
    """Duration of a window at rest [s]."""
    threshold: tuple[Positive, Positive, Positive] = (0.4, 0.4, 0.4)
    """Largest difference between maximum and minimum of each axis at rest [m/s^2] if the speed is
    unknown."""
    threshold_at_zero_speed: tuple[Positive, Positive, Positive] = (1.2, 1.2, 1.2)
    """Largest difference between maximum and minimum of each axis at rest [m/s^2] if the speed is
    zero. The value is larger because a running engine shakes the sensor."""
    standstill_speed: Positive = 0.3
    """Up to this speed, the vehicle counts as standing [m/s]. The resolution of an OBD-II speed is
    0.28 m/s."""
    average_stops: bool = True
    """True: all stops are used (not in the publication). False: only the last stop is used."""


Recogniser = Literal["yaw_rate", "steering", "consistency"]


class StraightMotionSettings(Settings, frozen=True):
    """Method A, step 4: recognition of straight motion at variable speed."""

    recognise_by: (
        Literal["all"]
        | Annotated[
            tuple[Recogniser | Annotated[tuple[Recogniser, ...], Meta(min_length=1)], ...],
            Meta(min_length=1),
        ]
    ) = ("yaw_rate", "steering", "consistency")
    """Tests in order of preference. The first test whose signal is present is used. All tests in an
    inner list must agree. `all` means steering and yaw rate."""
    yaw_rate_limit_deg_s: Positive = 2.0
    """Largest yaw rate of straight motion if speed times yaw rate (v r) is known and
    `lateral_limit` applies too."""
    yaw_rate_limit_without_speed_deg_s: Positive = 1.0
    """Largest yaw rate of straight motion if speed times yaw rate (v r) is unknown or not limited:
    1 deg/s at 20 m/s is 0.35 m/s^2."""
    steering_limit_deg: Positive = 10.0
    """Largest steering-wheel angle of straight motion."""
    lateral_limit: NotNegative = 0.6
    """Largest size of speed times yaw rate in straight motion [m/s^2]; 0 means no limit."""
    min_speed_change: Positive = 0.25
    """Smallest |dv/dt| that is used [m/s^2]. For smaller values, slope and noise would determine
    the angle."""
    manoeuvre_peak: Positive = 0.8
    """A manoeuvre counts only if |dv/dt| reaches this value [m/s^2]."""
    min_speed: Positive = 1.0
    """Nothing is learnt below this speed [m/s], because of the clutch, manoeuvring, and the dead
    zone of the speed signal."""
    min_speed_without_reverse: Positive = 2.0
    """Without a reverse signal, nothing is learnt below this speed [m/s], because drivers do not
    reverse faster than this for a long time."""
    consistency_window: Annotated[int, Meta(ge=2, le=1000)] = 15
    """Number of successive angles that must agree. There are ten angles per second."""
    consistency_range_deg: Positive = 25.0
    """The successive angles agree if their range is at most this angle."""
    consistency_mean: Positive = 1.0
    """Time over which each angle is averaged [s]. Without averaging, road noise is as large as
    braking."""

    @property
    def groups(self) -> tuple[tuple[Recogniser, ...], ...]:
        """Groups of tests in order of preference. All tests of a group must agree."""
        if self.recognise_by == "all":
            return (("steering", "yaw_rate"),)
        return tuple(one if isinstance(one, tuple) else (one,) for one in self.recognise_by)

    @property
    def recognisers(self) -> frozenset[Recogniser]:
        """All tests of `recognise_by`."""
        return frozenset(one for group in self.groups for one in group)

    yaw_rate_limit = Radians("yaw_rate_limit_deg_s")
    yaw_rate_limit_without_speed = Radians("yaw_rate_limit_without_speed_deg_s")
    steering_limit = Radians("steering_limit_deg")
    consistency_range = Radians("consistency_range_deg")


class TargetAngleSettings(Settings, frozen=True):
    """Method A, step 5: the yaw angle and its sign."""

    sign_from: Annotated[
        tuple[Literal["speed", "brake", "turn", "first_motion"], ...], Meta(min_length=1)
    ] = ("speed", "brake", "turn", "first_motion")
    """Signals that distinguish accelerating from braking. If the speed is known, it decides;
    otherwise the other signals vote."""
    subtract_lateral: bool = True
    """True: speed times yaw rate is subtracted if both are known (not in the publication)."""
    remove_offset_after: NotNegative = 1.0
    """Time constant of the mean that is subtracted, because slope and bias change slowly [s]; 0
    means that no mean is subtracted."""


class MethodASettings(Settings, frozen=True):
    """Settings of method A."""

    to_the_letter: bool = False
    """True: method A exactly as published. The last stop that passed the static test, with one
    threshold, gives the tilt. The additions of imucald are switched off: average of stops, tilt
    without a stop, crown of the road, speed times yaw rate and its limit, removed offset, weights
    by speed and by agreement, settling, shortest manoeuvre."""
    level: bool = True
    """True: the tilt is computed from gravity. False: the accelerometer is assumed to be level
    (claims 1 to 5)."""


class StateLimits(Settings, frozen=True):
    """Limits of standard deviations for a state. A state ends if a deviation exceeds 1.4 times its
    limit (*usable* without a gyroscope: twice its limit).

    Each estimator has its own defaults.
    """

    usable_yaw_deg: Positive | None = None
    usable_tilt_deg: Positive | None = None
    fine_yaw_deg: Positive | None = None
    fine_tilt_deg: Positive | None = None

    usable_yaw = RadiansOrNone("usable_yaw_deg")
    usable_tilt = RadiansOrNone("usable_tilt_deg")
    fine_yaw = RadiansOrNone("fine_yaw_deg")
    fine_tilt = RadiansOrNone("fine_tilt_deg")


class KnownMount(Settings, frozen=True):
    """A mount that a person states. The mount is used from the first frame on."""

    roll_deg: Angle
    pitch_deg: Annotated[float, Meta(ge=-90, le=90)]
    yaw_deg: Angle
    std_deg: PerAxis
    """Standard deviations about the vehicle's axes [deg]."""
    hold: bool = False
    """True: the mount is not changed. Driving can only confirm or contradict the mount."""

    roll = Radians("roll_deg")
    pitch = Radians("pitch_deg")
    yaw = Radians("yaw_deg")
    std = RadiansPerAxis("std_deg")


SensorAxis = Literal["x", "-x", "y", "-y", "z", "-z"]


class OrientationSettings(Settings, frozen=True):
    """Axes of the sensor that point roughly up and forward. The estimate is compared with these
    directions, but not changed by them. A difference of up to 60 degrees confirms the estimate; a
    difference of more than 120 degrees is a fault."""

    up: SensorAxis | None = None
    forward: SensorAxis | None = None


class CalibrationSettings(Settings, frozen=True):
    """Settings of the mount estimators."""

    estimator: Literal["joint", "full", "published"] = "joint"
    """Estimator: "joint" estimates a matrix and a zero error for each sensor; "published" is method
    A alone. Method A is also used if there is neither a speed nor a turn rate. "full" (earlier
    versions) means "joint"."""
    accelerometer_bias: Positive = 0.0981
    """Standard deviation of the accelerometer's zero error [m/s^2]. The default of 10 mg assumes a
    sensor whose offset was set at the factory. Uncalibrated consumer sensors have typically 20 to
    50 mg (50 in x and y, 80 in z: MPU-6050, PS-MPU-6000A-00 rev. 3.4) and need values of 0.2 to
    0.5."""
    accelerometer_range: Positive | None = None
    """Full scale of the accelerometer [m/s^2]. Values close to the full scale are not used."""
    cross_axis: Annotated[float, Meta(ge=0, le=0.05)] = 0.0
    """Cross-axis error of the accelerometer (fraction). With 0, six possible sizes are weighted
    according to the data."""
    speed_delay: SpeedDelay | None = None
    """Delay of the speed relative to the accelerometer [s]; estimated by default."""
    mount: KnownMount | None = None
    """A mount that is already known."""
    orientation: OrientationSettings = OrientationSettings()
    """Known approximate directions of the sensor's axes."""
    states: StateLimits = StateLimits()
    static: StaticTestSettings = StaticTestSettings()
    straight: StraightMotionSettings = StraightMotionSettings()
    target_angle: TargetAngleSettings = TargetAngleSettings()
    method_a: MethodASettings = MethodASettings()

    @property
    def full_scale(self) -> float:
        """Full scale of the accelerometer [m/s^2]; infinite by default."""
        return math.inf if self.accelerometer_range is None else self.accelerometer_range
