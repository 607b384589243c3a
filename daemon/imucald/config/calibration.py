"""How the mount is found."""

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
    """Method A, steps 1 to 3: when the vehicle stands, and its tilt from gravity."""

    samples: Annotated[int, Meta(ge=2, le=100_000)] = 20
    """Accelerometer samples that a window needs."""
    duration: Positive = 2.0
    """Time that it must span [s]."""
    threshold: tuple[Positive, Positive, Positive] = (0.4, 0.4, 0.4)
    """Largest max - min per axis [m/s^2], where speed is not known."""
    threshold_at_zero_speed: tuple[Positive, Positive, Positive] = (1.2, 1.2, 1.2)
    """The same where speed is known to be zero: a running engine shakes the sensor."""
    standstill_speed: Positive = 0.3
    """Speed up to which the vehicle stands [m/s]: one step of an OBD-II speed is 0.28 m/s."""
    average_stops: bool = True
    """All stops count (beyond the publication); else the last one decides."""


Recogniser = Literal["yaw_rate", "steering", "consistency"]


class StraightMotionSettings(Settings, frozen=True):
    """Method A, step 4: which motion counts as straight and of variable speed."""

    recognise_by: (
        Literal["all"]
        | Annotated[
            tuple[Recogniser | Annotated[tuple[Recogniser, ...], Meta(min_length=1)], ...],
            Meta(min_length=1),
        ]
    ) = ("yaw_rate", "steering", "consistency")
    """In order of preference; the first whose signal is there decides. A list within the list is a
    group whose members must all agree; `all` is the group of steering and yaw rate."""
    yaw_rate_limit_deg_s: Positive = 2.0
    """Yaw rate of straight motion where v r is known and `lateral_limit` gates it as well."""
    yaw_rate_limit_without_speed_deg_s: Positive = 1.0
    """The same where v r is unknown or not gated: 1 deg/s at 20 m/s is 0.35 m/s^2."""
    steering_limit_deg: Positive = 10.0
    """Angle of the steering wheel in straight motion."""
    lateral_limit: NotNegative = 0.6
    """Largest |v r| [m/s^2]; 0 switches this gate off."""
    min_speed_change: Positive = 0.25
    """Smallest |dv/dt| [m/s^2]: below, slope and noise decide the angle."""
    manoeuvre_peak: Positive = 0.8
    """|dv/dt| that a manoeuvre must reach to count [m/s^2]."""
    min_speed: Positive = 1.0
    """Slower than this nothing is learnt: manoeuvring, clutch, signal dead zone [m/s]."""
    min_speed_without_reverse: Positive = 2.0
    """The same where no signal shows reverse gear: nobody reverses faster for long [m/s]."""
    consistency_window: Annotated[int, Meta(ge=2, le=1000)] = 15
    """Successive angles, ten a second, that must agree."""
    consistency_range_deg: Positive = 25.0
    """Range within which they agree."""
    consistency_mean: Positive = 1.0
    """Time over which each angle is averaged [s]: road noise is as large as braking otherwise."""

    @property
    def groups(self) -> tuple[tuple[Recogniser, ...], ...]:
        """Groups by preference; the members of one must all agree."""
        if self.recognise_by == "all":
            return (("steering", "yaw_rate"),)
        return tuple(one if isinstance(one, tuple) else (one,) for one in self.recognise_by)

    @property
    def recognisers(self) -> frozenset[Recogniser]:
        """All that are named."""
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
    """What may separate accelerating from braking. Speed does alone; without it the others vote."""
    subtract_lateral: bool = True
    """Subtract v r where speed and yaw rate are known (beyond the publication)."""
    remove_offset_after: NotNegative = 1.0
    """Time constant of the mean that is removed, since slope and bias wander [s]; 0: never."""


class MethodASettings(Settings, frozen=True):
    """Method A as a whole."""

    to_the_letter: bool = False
    """As published: the last stop that passed the static test levels, by one threshold; what was
    added takes no part (average of stops, level without a stop, crown of the road, v r and its
    gate, removed offset, weight by speed and by agreement, settling, shortest manoeuvre)."""
    level: bool = True
    """Level by gravity; else the accelerometer is taken as level (claims 1 to 5 without 6)."""


class StateLimits(Settings, frozen=True):
    """Standard deviations below which a state is reached; it ends beyond 1.4 times or twice them.

    Where they are not given, each estimator has its own; the full one then takes 2.8 times
    its `usable_yaw_deg` where only cross-axis errors that show in nothing are left.
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
    """A mount that is known: it serves from the first frame on."""

    roll_deg: Angle
    pitch_deg: Annotated[float, Meta(ge=-90, le=90)]
    yaw_deg: Angle
    std_deg: PerAxis
    """Standard deviations about the vehicle's axes [deg]."""
    hold: bool = False
    """Nothing is learnt: the drive may only confirm or doubt it."""

    roll = Radians("roll_deg")
    pitch = Radians("pitch_deg")
    yaw = Radians("yaw_deg")
    std = RadiansPerAxis("std_deg")


SensorAxis = Literal["x", "-x", "y", "-y", "z", "-z"]


class OrientationSettings(Settings, frozen=True):
    """Which of the sensor's axes points roughly where: within 60 degrees confirms, beyond 120 is a
    fault. No prior, a check."""

    up: SensorAxis | None = None
    forward: SensorAxis | None = None


class CalibrationSettings(Settings, frozen=True):
    """How the mount is found."""

    estimator: Literal["joint", "full", "published"] = "joint"
    """"joint" finds a matrix and a zero for each sensor; "full" fuses all the evidence there is to
    one rotation; "published" is method A alone."""
    accelerometer_bias: Positive = 0.0981
    """Standard deviation of the accelerometer's zero error [m/s^2]: 10 mg, of a unit whose offset
    was set at the end of its line (assumption). Bare consumer parts state 20 to 50 mg typical (50 x
    and y, 80 z: MPU-6050, PS-MPU-6000A-00 rev. 3.4): such a sensor wants 0.2 to 0.5."""
    accelerometer_range: Positive | None = None
    """Full scale [m/s^2]; nothing is learnt close to it."""
    cross_axis: Annotated[float, Meta(ge=0, le=0.05)] = 0.0
    """Cross-axis error of the accelerometer (part): widens the intervals."""
    speed_delay: SpeedDelay | None = None
    """How late speed is against the accelerometer [s]; estimated when absent."""
    mount: KnownMount | None = None
    """Where the mount is known already."""
    orientation: OrientationSettings = OrientationSettings()
    """How the sensor sits roughly, where that is known."""
    states: StateLimits = StateLimits()
    static: StaticTestSettings = StaticTestSettings()
    straight: StraightMotionSettings = StraightMotionSettings()
    target_angle: TargetAngleSettings = TargetAngleSettings()
    method_a: MethodASettings = MethodASettings()

    @property
    def full_scale(self) -> float:
        """Full scale of the accelerometer [m/s^2]; infinite where it is not given."""
        return math.inf if self.accelerometer_range is None else self.accelerometer_range
