"""Methods B, C and D: attitude of the vehicle, direction of travel of a carried terminal."""

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
"""The reading of an accelerometer at rest on the axis that points up: +g ("force") or -g."""


class MotionCompensationSettings(Settings, frozen=True):
    """Method B: the vehicle's acceleration is subtracted from the specific force."""

    average: Positive = 0.2
    """Time over which speed is averaged [s]."""
    interval: Annotated[float, Meta(gt=0, le=4.0)] = 1.0
    """Shortest time between two averages that are differenced [s]; it smooths a coarse speed."""
    timeout: Annotated[float, Meta(gt=0, le=4.0)] = 3.0
    """A speed older than this is not used [s]; OBD-II answers come once a second."""
    delay: SpeedDelay | None = None
    """Delay of the speed against the accelerometer [s]; default: calibration.speed_delay, or 0."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Position of the sensor from the middle of the non-steered axle: forward, left, up [m]."""
    speed_is: Literal["along_road", "horizontal"] = "along_road"
    """Kind of speed: along the road (wheels) or horizontal (satellites)."""
    centripetal: Literal["full", "plane"] = "full"
    """Centripetal acceleration: omega x v, or yaw rate times speed (method B alone)."""
    rate_time: NotNegative = 0.0
    """Method B alone: time constant with which the specific force corrects the angles
    integrated from the rate [s]; 0: specific force alone."""
    send: bool = False
    """True: the specific force less the vehicle's acceleration is sent and reported
    (`IMUCALD_FreeAcceleration`)."""
    speed_noise: Positive = 0.03
    """Standard deviation of an averaged speed [m/s]."""
    speed_scale: Share = 0.02
    """Relative uncertainty of speed: tyre radius, slip."""
    creep_speed: NotNegative = 1.0
    """A speed signal may show zero up to this true speed [m/s]."""
    lever_uncertainty: NotNegative = 1.0
    """Standard deviation of the lever arm, side-slip included [m]."""


class FilterSettings(Settings, frozen=True):
    """Method C: the nine-state filter."""

    heading: Literal["free", "signal", "magnetometer"] = "free"
    """Source of the heading; free: the heading is relative to the start."""
    declination_deg: Angle = 0.0
    """Magnetic declination, east positive."""
    check: Positive = 30.0
    """Duration of the rest for the sensor check [s]."""
    check_level: bool = False
    """True: the check is made on level ground. The mean in all axes is then the accelerometer's
    error."""
    start: Positive = 5.0
    """Duration of the rest for the start [s], or of motion if the vehicle does not stand."""
    longest_step: Positive = 0.5
    """Gyroscope samples further apart than this are a gap [s]."""
    rest_update: bool = True
    """True: the gyroscope's zero error is estimated at each rest (not in the publication)."""
    rest_accel_spread: Positive = 0.25
    """Largest standard deviation of the accelerometer at rest, with a running engine [m/s^2]."""
    rest_gyro_spread_deg_s: Positive = 0.5
    """Largest standard deviation of the gyroscope at rest."""
    gyro_resolution_deg_s: NotNegative | None = None
    """Step of the gyroscope's signals; default: the database's."""
    gyro_noise_deg_s: PerAxis = 0.01
    """Noise density of the gyroscope [deg/s/sqrt(Hz)]: one number, or `[x, y, z]` in vehicle
    axes."""
    gyro_start_deg_s: PerAxis = 0.5
    """Standard deviation of the gyroscope's zero error before any check."""
    gyro_random_deg_s: PerAxis = 0.01
    """Random walk of the gyroscope's zero error: sqrt(2) of this value in gyro_random_time."""
    gyro_random_time: Positive = 600.0
    """Time of the gyroscope's random walk [s]."""
    gyro_gain: Share = 0.01
    """Standard deviation of the gyroscope's gain, equal in all turns: consumer parts have up to
    3 %."""
    gyro_scale: Share = 0.003
    """Part of a turned angle that leaks into the other axes."""
    accel_noise: PerAxis = 0.02
    """Standard deviation of an interval's mean specific force [m/s^2]."""
    accel_random: PerAxis | None = None
    """Accelerometer error (Gauss-Markov), standard deviation [m/s^2]; default: calibration's."""
    accel_random_time: Positive = 1800.0
    """Correlation time of this accelerometer error [s]."""
    unknown_motion: Positive = 1.0
    """Standard deviation of horizontal acceleration while the speed is unknown [m/s^2]."""
    heading_noise_deg: Positive = 2.0
    """Standard deviation of a heading signal."""
    magnetometer_noise_deg: Positive = 10.0
    """Standard deviation of a heading from the magnetometer: steel deflects it."""
    gate: Positive = 4.0
    """An innovation beyond this number of standard deviations gets a larger noise. A heading beyond
    it is not used."""

    declination = Radians("declination_deg")
    rest_gyro_spread = Radians("rest_gyro_spread_deg_s")
    gyro_resolution = RadiansOrNone("gyro_resolution_deg_s")
    gyro_noise = RadiansPerAxis("gyro_noise_deg_s")
    gyro_start = RadiansPerAxis("gyro_start_deg_s")
    gyro_random = RadiansPerAxis("gyro_random_deg_s")
    heading_noise = Radians("heading_noise_deg")
    magnetometer_noise = Radians("magnetometer_noise_deg")


class AttitudeSettings(Settings, frozen=True):
    """Attitude of the vehicle: methods B and C on the corrected samples."""

    enabled: bool = False
    """True: the attitude is computed and sent. This needs a gyroscope."""
    method: Literal["filter", "compensation"] = "filter"
    """Methods B and C together, or B alone: roll and pitch of each sample, unfiltered."""
    rate: Literal[1, 2, 5, 10] = 10
    """Attitude frames per second."""
    squat: float = 0.0
    """Nose-up pitch of the body per forward specific force [rad/(m/s^2)], for the grade."""
    grade_time: Positive = 1.0
    """Time constant of the road grade [s]: longer than an oscillation of the body."""
    compensation: MotionCompensationSettings = MotionCompensationSettings()
    filter: FilterSettings = FilterSettings()


class StepSettings(Settings, frozen=True):
    """Method D, step 1: step cycles."""

    shortest: Positive = 0.28
    """Shortest step cycle [s], that of a run."""
    longest: Annotated[float, Meta(gt=0, le=5.0)] = 1.2
    """Longest step cycle [s]; slower motion is not walking."""
    threshold: Positive = 0.35
    """Smallest amplitude of the vertical acceleration about its mean, to both sides [m/s^2]."""
    corner_hz: Positive = 3.0
    """Corner of the low-pass of the vertical acceleration. Shocks of the heel do not pass it."""
    gravity_time: Positive = 1.5
    """Time constant of the mean of the vertical acceleration [s]: longer than a stride."""


class ChoiceSettings(Settings, frozen=True):
    """Method D, steps 2 and 5: the choice between the two headings."""

    turn_deg: Positive = 60.0
    """A larger change of the compass since the last cycle is a turn."""
    tilt_on_turn_deg: NotNegative = 5.0
    """During a turn the tilt heading is used if pitch or roll exceeds this angle."""
    differ_deg: NotNegative = 30.0
    """The two headings contradict each other if they differ by more than this."""
    tilt_deg: NotNegative = 5.0
    """In other cases the tilt heading is used if pitch or roll exceeds this angle."""

    turn = Radians("turn_deg")
    tilt_on_turn = Radians("tilt_on_turn_deg")
    differ = Radians("differ_deg")
    tilt = Radians("tilt_deg")


class AlternativeSettings(Settings, frozen=True):
    """The alternative to method D."""

    gravity_time: Positive = 3.0
    """Time constant with which the accelerometer levels the attitude [s]."""
    compass_time: Positive = 20.0
    """Time constant with which a heading signal turns the attitude [s]."""
    lead_deg: Angle = 120.0
    """Phase by which forward acceleration leads vertical acceleration at the step's frequency: a
    quarter period in the trunk, more in a hand. Only the sign of the direction depends on it."""
    memory_steps: Positive = 20.0
    """Number of steps after which the weight of an old direction has fallen to 1/e."""
    carry_change_deg: Positive = 35.0
    """If the vertical moves by this angle in the terminal, the average starts again."""

    lead = Radians("lead_deg")
    carry_change = Radians("carry_change_deg")


class TravelDirectionSettings(Settings, frozen=True):
    """Direction of travel of a carried terminal: method D, on samples in terminal axes."""

    enabled: bool = False
    """True: the direction is computed and sent. This needs a magnetometer or a heading."""
    method: Literal["alternative", "published"] = "alternative"
    """Method whose heading is sent; without a gyroscope always the published method."""
    convention: AxisConvention = "force"
    """Reading of the accelerometer at rest on the axis that points up: +g or -g."""
    compass: Literal["clockwise", "counter_clockwise"] = "clockwise"
    """Positive direction of the heading signal. A magnetometer has a sign for each axis."""
    declination_deg: Angle = 0.0
    """Magnetic declination, east positive."""
    steps: StepSettings = StepSettings()
    choice: ChoiceSettings = ChoiceSettings()
    alternative: AlternativeSettings = AlternativeSettings()

    declination = Radians("declination_deg")
