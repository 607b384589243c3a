"""Settings of methods B and C (attitude of the vehicle) and method D (direction of travel of a
carried terminal)."""

from __future__ import annotations

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
    Share,
    SpeedDelay,
)

AxisConvention = Literal["force", "gravity"]
"""Sign convention of the accelerometer: at rest, the axis that points up reads +g ("force") or -g
("gravity")."""


class MotionCompensationSettings(Settings, frozen=True):
    """Method B: the vehicle's acceleration is subtracted from the specific force."""

    average: Positive = 0.2
    """Time over which the speed is averaged [s]."""
    interval: Annotated[float, Meta(gt=0, le=4.0)] = 1.0
    """Shortest time between the two speed averages whose difference gives the acceleration [s]. A
    longer time smooths a speed with coarse resolution."""
    timeout: Annotated[float, Meta(gt=0, le=4.0)] = 3.0
    """Largest age of a speed that is used [s]. OBD-II gives one speed per second."""
    delay: SpeedDelay | None = None
    """Delay of the speed relative to the accelerometer [s]; default: calibration.speed_delay, or
    0."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the sensor relative to the middle of the non-steered axle: forward, left, up
    [m]."""
    speed_is: Literal["along_road", "horizontal"] = "along_road"
    """Direction in which the speed is measured: along the road (wheels) or horizontal
    (satellites)."""
    centripetal: Literal["full", "plane"] = "full"
    """Calculation of the centripetal acceleration: full (omega x v), or plane (yaw rate times
    speed; only with method B alone)."""
    rate_time: NotNegative = 0.0
    """Only with method B alone: time constant with which the specific force corrects the angles
    integrated from the turn rate [s]. With 0, only the specific force is used."""
    send: bool = False
    """True: the specific force minus the vehicle's acceleration is sent and reported
    (`IMUCALD_FreeAcceleration`)."""
    speed_noise: Positive = 0.03
    """Standard deviation of an averaged speed [m/s]."""
    speed_scale: Share = 0.02
    """Relative uncertainty of the speed, from tyre radius and slip."""
    creep_speed: NotNegative = 1.0
    """Largest true speed at which the speed signal may still show zero [m/s]."""
    lever_uncertainty: NotNegative = 1.0
    """Standard deviation of the lever arm, including the effect of side slip [m]."""


class FilterSettings(Settings, frozen=True):
    """Method C: the nine-state filter."""

    heading: Literal["free", "signal", "magnetometer"] = "free"
    """Source of the heading. With free, the heading is relative to the heading at the start."""
    declination_deg: Angle = 0.0
    """Magnetic declination, east positive."""
    check: Positive = 30.0
    """Duration of a standstill that is needed for the sensor check [s]."""
    check_level: bool = False
    """True: the sensor check is always on level ground. The mean reading of every axis then shows
    the error of the accelerometer."""
    start: Positive = 5.0
    """Duration of a standstill that is needed for the start [s]. If the vehicle does not stand, the
    same duration of motion is used."""
    longest_step: Positive = 0.5
    """A longer time between two gyroscope samples is a gap [s]."""
    rest_update: bool = True
    """True: the gyroscope's zero error is estimated at each standstill (not in the publication)."""
    rest_accel_spread: Positive = 0.25
    """Largest standard deviation of the accelerometer at standstill with a running engine
    [m/s^2]."""
    rest_gyro_spread_deg_s: Positive = 0.5
    """Largest standard deviation of the gyroscope at standstill."""
    gyro_resolution_deg_s: NotNegative | None = None
    """Resolution of the gyroscope's signals; default: the resolution in the database."""
    gyro_noise_deg_s: PerAxis = 0.01
    """Noise density of the gyroscope [deg/s/sqrt(Hz)]: one number, or `[x, y, z]` in vehicle
    axes."""
    gyro_start_deg_s: PerAxis = 0.5
    """Standard deviation of the gyroscope's zero error before the first check."""
    gyro_random_deg_s: PerAxis = 0.01
    """Random walk of the gyroscope's zero error: in gyro_random_time, the zero error changes by
    sqrt(2) times this value (standard deviation)."""
    gyro_random_time: Positive = 600.0
    """Time to which gyro_random_deg_s refers [s]."""
    gyro_gain: Share = 0.01
    """Standard deviation of the gyroscope's gain error, which is the same in all turns. Consumer
    sensors have up to 3 %."""
    gyro_scale: Share = 0.003
    """Share of a rotation about one axis that also appears in the other axes."""
    accel_noise: PerAxis = 0.02
    """Standard deviation of the mean specific force in an interval [m/s^2]."""
    accel_random: PerAxis | None = None
    """Standard deviation of the accelerometer error (Gauss-Markov process) [m/s^2]; default:
    calibration.accelerometer_bias."""
    accel_random_time: Positive = 1800.0
    """Correlation time of the accelerometer error [s]."""
    unknown_motion: Positive = 1.0
    """Standard deviation of horizontal acceleration while the speed is unknown [m/s^2]."""
    heading_noise_deg: Positive = 2.0
    """Standard deviation of a heading signal."""
    magnetometer_noise_deg: Positive = 10.0
    """Standard deviation of a heading from the magnetometer, because steel deflects the magnetic
    field."""
    gate: Positive = 4.0
    """For an innovation beyond this number of standard deviations, a larger noise is assumed. A
    heading with such an innovation is not used."""

    declination = Radians("declination_deg")
    rest_gyro_spread = Radians("rest_gyro_spread_deg_s")
    gyro_resolution = RadiansOrNone("gyro_resolution_deg_s")
    gyro_noise = RadiansPerAxis("gyro_noise_deg_s")
    gyro_start = RadiansPerAxis("gyro_start_deg_s")
    gyro_random = RadiansPerAxis("gyro_random_deg_s")
    heading_noise = Radians("heading_noise_deg")
    magnetometer_noise = Radians("magnetometer_noise_deg")


class AttitudeSettings(Settings, frozen=True):
    """Attitude of the vehicle, computed from corrected samples (methods B and C)."""

    enabled: bool = False
    """True: the attitude is computed and sent. The attitude requires a gyroscope."""
    method: Literal["filter", "compensation"] = "filter"
    """"filter" is methods B and C together. "compensation" is method B alone: roll and pitch from
    each sample, without a filter."""
    rate: Literal[1, 2, 5, 10] = 10
    """Attitude frames per second."""
    squat: float = 0.0
    """Nose-up pitch of the body per forward specific force [rad/(m/s^2)]. The grade is corrected
    for this pitch."""
    grade_time: Positive = 1.0
    """Time constant of the filter for the road grade [s]. The time should be longer than an
    oscillation of the body."""
    compensation: MotionCompensationSettings = MotionCompensationSettings()
    filter: FilterSettings = FilterSettings()


class StepSettings(Settings, frozen=True):
    """Method D, step 1: step cycles."""

    shortest: Positive = 0.28
    """Shortest step cycle [s]: a running person."""
    longest: Annotated[float, Meta(gt=0, le=5.0)] = 1.2
    """Longest step cycle [s]; slower motion is not walking."""
    threshold: Positive = 0.35
    """Smallest amplitude of the vertical acceleration, above and below its mean [m/s^2]."""
    corner_hz: Positive = 3.0
    """Corner frequency of the low-pass filter for the vertical acceleration. Shocks of the heel do
    not pass this filter."""
    gravity_time: Positive = 1.5
    """Time constant of the mean of the vertical acceleration [s]. The time should be longer than a
    stride."""


class ChoiceSettings(Settings, frozen=True):
    """Method D, steps 2 and 5: the choice between compass heading and tilt heading."""

    turn_deg: Positive = 60.0
    """If the compass changes by more than this since the last step cycle, the person turns."""
    tilt_on_turn_deg: NotNegative = 5.0
    """During a turn the tilt heading is used if pitch or roll exceeds this angle."""
    differ_deg: NotNegative = 30.0
    """The two headings contradict each other if their difference exceeds this angle."""
    tilt_deg: NotNegative = 5.0
    """If the person does not turn and the headings do not contradict each other, the tilt heading
    is used if pitch or roll exceeds this angle."""

    turn = Radians("turn_deg")
    tilt_on_turn = Radians("tilt_on_turn_deg")
    differ = Radians("differ_deg")
    tilt = Radians("tilt_deg")


class AlternativeSettings(Settings, frozen=True):
    """The alternative to method D."""

    gravity_time: Positive = 3.0
    """Time constant with which the accelerometer corrects roll and pitch of the terminal [s]."""
    compass_time: Positive = 20.0
    """Time constant with which a heading signal corrects the heading of the terminal [s]."""
    lead_deg: Angle = 120.0
    """Phase by which forward acceleration leads vertical acceleration at the step's frequency: a
    quarter period at the trunk, more in a hand. This phase affects only the sign of the direction.
    """
    memory_steps: Positive = 20.0
    """Number of steps after which the weight of an old direction has fallen to 1/e."""
    carry_change_deg: Positive = 35.0
    """If the direction of the vertical in terminal axes changes by this angle, the average starts
    again."""

    lead = Radians("lead_deg")
    carry_change = Radians("carry_change_deg")


class TravelDirectionSettings(Settings, frozen=True):
    """Direction of travel of a carried terminal (method D), from samples in terminal axes."""

    enabled: bool = False
    """True: the direction is computed and sent. The direction requires a magnetometer or a
    heading."""
    method: Literal["alternative", "published"] = "alternative"
    """Method whose heading is sent. Without a gyroscope, the published method is always used."""
    convention: AxisConvention = "force"
    """Sign convention of the accelerometer: at rest, the axis that points up reads +g ("force") or
    -g ("gravity")."""
    compass: Literal["clockwise", "counter_clockwise"] = "clockwise"
    """Positive direction of the heading signal. A magnetometer has a sign for each axis."""
    declination_deg: Angle = 0.0
    """Magnetic declination, east positive."""
    steps: StepSettings = StepSettings()
    choice: ChoiceSettings = ChoiceSettings()
    alternative: AlternativeSettings = AlternativeSettings()

    declination = Radians("declination_deg")
