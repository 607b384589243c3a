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
    """Method B: how motion is taken out of the accelerometer."""

    average: Positive = 0.2
    """Time over which speed is averaged [s]."""
    interval: Annotated[float, Meta(gt=0, le=4.0)] = 1.0
    """Shortest time between two averages that are differenced [s]: coarse speed, quietly."""
    timeout: Annotated[float, Meta(gt=0, le=4.0)] = 3.0
    """Speed older than this is not known [s]; OBD-II answers come once a second."""
    delay: SpeedDelay | None = None
    """How late speed is against the accelerometer [s]; default: calibration.speed_delay, or 0."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Sensor from the middle of the axle that does not steer: forward, left, up [m]."""
    speed_is: Literal["along_road", "horizontal"] = "along_road"
    """What speed counts: wheels along the road, or satellites over the map."""
    centripetal: Literal["full", "plane"] = "full"
    """omega x v in full, or rate times speed as one number (method B alone)."""
    rate_time: NotNegative = 0.0
    """Method B alone: force draws the angles that the rate carries over it [s]; 0: force alone."""
    send: bool = False
    """Whether the specific force less motion is sent and reported (`IMUCALD_FreeAcceleration`)."""
    speed_noise: Positive = 0.03
    """Standard deviation of an averaged speed [m/s]."""
    speed_scale: Share = 0.02
    """Relative uncertainty of speed: tyre radius, slip."""
    creep_speed: NotNegative = 1.0
    """Below this a speed signal may still say zero [m/s]."""
    lever_uncertainty: NotNegative = 1.0
    """How well the lever arm is known, side-slip included [m]."""


class FilterSettings(Settings, frozen=True):
    """Method C: the nine-state filter."""

    heading: Literal["free", "signal", "magnetometer"] = "free"
    """Where heading comes from; free: relative to the start."""
    declination_deg: Angle = 0.0
    """Magnetic declination, east positive."""
    check: Positive = 30.0
    """Rest that the sensor check needs [s]."""
    check_level: bool = False
    """The check is made on level ground: the whole mean is the accelerometer's error."""
    start: Positive = 5.0
    """Rest that the start needs [s]; of motion, where the vehicle does not stand."""
    longest_step: Positive = 0.5
    """Gyroscope samples further apart than this are a gap [s]."""
    rest_update: bool = True
    """The gyroscope at rest shows its zero error (beyond the publication)."""
    rest_accel_spread: Positive = 0.25
    """Largest standard deviation of the accelerometer at rest [m/s^2]: an engine may run."""
    rest_gyro_spread_deg_s: Positive = 0.5
    """The same of the gyroscope."""
    gyro_resolution_deg_s: NotNegative | None = None
    """Step of the gyroscope's signals; default: the database's."""
    gyro_noise_deg_s: PerAxis = 0.01
    """Gyroscope noise density [deg/s/sqrt(Hz)]; of this and the next four `[x, y, z]` as well,
    vehicle axes."""
    gyro_start_deg_s: PerAxis = 0.5
    """Standard deviation of its zero error before any check."""
    gyro_random_deg_s: PerAxis = 0.01
    """Its random error: it walks by sqrt(2) of this in gyro_random_time."""
    gyro_random_time: Positive = 600.0
    """[s]"""
    gyro_gain: Share = 0.01
    """Standard deviation of its gain, the same in all turns: consumer parts have up to 3 %."""
    gyro_scale: Share = 0.003
    """Part of a turned angle that leaks into the other axes."""
    accel_noise: PerAxis = 0.02
    """Standard deviation of an interval's mean specific force [m/s^2]."""
    accel_random: PerAxis | None = None
    """Accelerometer error (Gauss-Markov), standard deviation [m/s^2]; default: calibration's."""
    accel_random_time: Positive = 1800.0
    """Its correlation time [s]."""
    unknown_motion: Positive = 1.0
    """Standard deviation of horizontal acceleration where speed is not known [m/s^2]."""
    heading_noise_deg: Positive = 2.0
    """Standard deviation of a heading signal."""
    magnetometer_noise_deg: Positive = 10.0
    """Standard deviation of a heading from the magnetometer: steel deflects it."""
    gate: Positive = 4.0
    """Innovations beyond so many standard deviations widen their own noise; a heading beyond them
    is not followed."""

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
    """Whether it is computed and sent; needs a gyroscope."""
    method: Literal["filter", "compensation"] = "filter"
    """Methods B and C together, or B alone: roll and pitch of each sample, unfiltered."""
    rate: Literal[1, 2, 5, 10] = 10
    """Attitude frames per second."""
    squat: float = 0.0
    """Nose-up pitch of the body per forward specific force [rad/(m/s^2)], for the grade."""
    grade_time: Positive = 1.0
    """Time constant of the road grade [s]: longer than the body swings."""
    compensation: MotionCompensationSettings = MotionCompensationSettings()
    filter: FilterSettings = FilterSettings()


class StepSettings(Settings, frozen=True):
    """Method D, step 1: step cycles."""

    shortest: Positive = 0.28
    """Shortest step cycle [s]: a run."""
    longest: Annotated[float, Meta(gt=0, le=5.0)] = 1.2
    """Longest [s]: slower is not walking."""
    threshold: Positive = 0.35
    """The vertical acceleration must swing so far either side of its mean [m/s^2]."""
    corner_hz: Positive = 3.0
    """Low-pass of the vertical acceleration: a brisk step passes, a heel's shock does not."""
    gravity_time: Positive = 1.5
    """Time constant of its mean [s]: longer than a stride."""


class ChoiceSettings(Settings, frozen=True):
    """Method D, steps 2 and 5: the choice between the two headings."""

    turn_deg: Positive = 60.0
    """The compass differs from the last cycle's by more: a turn."""
    tilt_on_turn_deg: NotNegative = 5.0
    """On a turn: tilt heading from this pitch or roll on."""
    differ_deg: NotNegative = 30.0
    """The two headings contradict each other from this difference on."""
    tilt_deg: NotNegative = 5.0
    """No turn, no contradiction: tilt heading from this pitch or roll on."""

    turn = Radians("turn_deg")
    tilt_on_turn = Radians("tilt_on_turn_deg")
    differ = Radians("differ_deg")
    tilt = Radians("tilt_deg")


class AlternativeSettings(Settings, frozen=True):
    """The alternative to method D."""

    gravity_time: Positive = 3.0
    """Time constant with which the accelerometer levels the attitude [s]."""
    compass_time: Positive = 20.0
    """Time constant with which a heading signal turns it [s]."""
    lead_deg: Angle = 120.0
    """By how much forward leads vertical acceleration at the step's frequency: a quarter period in
    the trunk, more in a hand. Only the sign depends on it."""
    memory_steps: Positive = 20.0
    """Steps after which the direction within the terminal is forgotten to 1/e."""
    carry_change_deg: Positive = 35.0
    """The vertical moved so far in the terminal: carried otherwise, start again."""

    lead = Radians("lead_deg")
    carry_change = Radians("carry_change_deg")


class TravelDirectionSettings(Settings, frozen=True):
    """Direction of travel of a carried terminal: method D, on samples in terminal axes."""

    enabled: bool = False
    """Whether it is computed and sent; needs a magnetometer or a heading."""
    method: Literal["alternative", "published"] = "alternative"
    """Whose heading is sent; without a gyroscope it is the published one's."""
    convention: AxisConvention = "force"
    """What the terminal's accelerometer at rest reads on the axis that points up: +g or -g."""
    compass: Literal["clockwise", "counter_clockwise"] = "clockwise"
    """Which way the heading signal counts; a magnetometer has a sign per axis."""
    declination_deg: Angle = 0.0
    """Magnetic declination, east positive."""
    steps: StepSettings = StepSettings()
    choice: ChoiceSettings = ChoiceSettings()
    alternative: AlternativeSettings = AlternativeSettings()

    declination = Radians("declination_deg")
