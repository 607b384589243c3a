"""Methods B, C and D: attitude of the vehicle, direction of travel of a carried terminal."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta

from imucald.attitude.settings import AttitudeSettings
from imucald.config.base import Angle, Model, NotNegative, Positive, Share
from imucald.travel_direction.settings import TravelSettings

_ATTITUDE = AttitudeSettings()
_B, _C = _ATTITUDE.compensation, _ATTITUDE.filter
_TRAVEL = TravelSettings()


def _deg(radians: float) -> float:
    return round(math.degrees(radians), 6)


class Compensation(Model, frozen=True):
    """Method B: how motion is taken out of the accelerometer."""

    average: Positive = _B.average
    """Time over which speed is averaged [s]."""
    interval: Annotated[float, Meta(gt=0, le=4.0)] = _B.interval
    """Shortest time between two averages that are differenced [s]."""
    timeout: Annotated[float, Meta(gt=0, le=4.0)] = _B.timeout
    """Speed older than this is not known [s]."""
    delay: Annotated[float, Meta(ge=-0.5, le=1.2)] | None = None
    """How late speed is against the accelerometer [s]; default: calibration.speed_delay, or 0."""
    lever_arm: tuple[float, float, float] = _B.lever_arm
    """Sensor from the middle of the axle that does not steer: forward, left, up [m]."""
    speed_is: Literal["along_road", "horizontal"] = _B.speed_is
    """What speed counts: wheels along the road, or satellites over the map."""
    centripetal: Literal["full", "plane"] = _B.centripetal
    """omega x v in full, or rate times speed as one number (method B alone)."""
    rate_time: NotNegative = _B.rate_time
    """Method B alone: force draws the angles that the rate carries over it [s]; 0: force alone."""
    send: bool = _B.send
    """Whether the specific force less motion is sent and told (`IMUCALD_FreeAcceleration`)."""
    speed_noise: Positive = _B.speed_noise
    """Standard deviation of an averaged speed [m/s]."""
    speed_scale: Share = _B.speed_scale
    """Relative uncertainty of speed."""
    creep_speed: NotNegative = _B.creep_speed
    """Below this a speed signal may still say zero [m/s]."""
    lever_uncertainty: NotNegative = _B.lever_uncertainty
    """How well the lever arm is known, side-slip included [m]."""


class Filter(Model, frozen=True):
    """Method C: the nine-state filter."""

    heading: Literal["free", "signal", "magnetometer"] = _C.heading
    """Where heading comes from; free: relative to the start."""
    declination_deg: Angle = _deg(_C.declination)
    """Magnetic declination, east positive."""
    check: Positive = _C.check
    """Rest that the sensor check needs [s]."""
    check_level: bool = _C.check_level
    """The check is made on level ground: the whole mean is the accelerometer's error."""
    start: Positive = _C.start
    """Rest that the start needs [s]."""
    longest_step: Positive = _C.longest_step
    """Gyroscope samples further apart than this are a gap [s]."""
    rest_update: bool = _C.rest_update
    """The gyroscope at rest tells its zero error (beyond the publication)."""
    rest_accel_spread: Positive = _C.rest_accel_spread
    """Largest standard deviation of the accelerometer at rest [m/s^2]."""
    rest_gyro_spread_deg_s: Positive = _deg(_C.rest_gyro_spread)
    """The same of the gyroscope."""
    gyro_noise_deg_s: Positive = _deg(_C.gyro_noise)
    """Gyroscope noise density [deg/s/sqrt(Hz)]."""
    gyro_start_deg_s: Positive = _deg(_C.gyro_start)
    """Standard deviation of its zero error before any check."""
    gyro_random_deg_s: Positive = _deg(_C.gyro_random)
    """Its random error: it walks by sqrt(2) of this in gyro_random_time."""
    gyro_random_time: Positive = _C.gyro_random_time
    """[s]"""
    gyro_scale: Share = _C.gyro_scale
    """Part of a turned angle that leaks into the other axes."""
    accel_noise: Positive = _C.accel_noise
    """Standard deviation of an interval's mean specific force [m/s^2]."""
    accel_random: Positive | None = None
    """Accelerometer error (Gauss-Markov), standard deviation [m/s^2]; default: calibration's."""
    accel_random_time: Positive = _C.accel_random_time
    """Its correlation time [s]."""
    unknown_motion: Positive = _C.unknown_motion
    """Standard deviation of horizontal acceleration where speed is not known [m/s^2]."""
    heading_noise_deg: Positive = _deg(_C.heading_noise)
    """Standard deviation of a heading signal."""
    magnetometer_noise_deg: Positive = _deg(_C.magnetometer_noise)
    """Standard deviation of a heading from the magnetometer."""
    gate: Positive = _C.gate
    """Innovations beyond so many standard deviations widen their own noise."""


class Attitude(Model, frozen=True):
    """Attitude of the vehicle: methods B and C on the corrected samples."""

    enabled: bool = False
    """Whether it is computed and sent; needs a gyroscope."""
    method: Literal["filter", "compensation"] = "filter"
    """Methods B and C together, or B alone: roll and pitch of each sample, unfiltered."""
    rate: Literal[1, 2, 5, 10] = 10
    """Attitude frames per second."""
    squat: float = _ATTITUDE.squat
    """Nose-up pitch of the body per forward specific force [rad/(m/s^2)], for the grade."""
    grade_time: Positive = _ATTITUDE.grade_time
    """Time constant of the road grade [s]."""
    compensation: Compensation = Compensation()
    filter: Filter = Filter()


class Steps(Model, frozen=True):
    """Method D, step 1: step cycles."""

    shortest: Positive = _TRAVEL.step.shortest
    """Shortest step cycle [s]."""
    longest: Annotated[float, Meta(gt=0, le=5.0)] = _TRAVEL.step.longest
    """Longest [s]."""
    threshold: Positive = _TRAVEL.step.threshold
    """The vertical acceleration must swing so far either side of its mean [m/s^2]."""
    corner_hz: Positive = _TRAVEL.step.corner_hz
    """Low-pass of the vertical acceleration."""
    gravity_time: Positive = _TRAVEL.step.gravity_time
    """Time constant of its mean [s]."""


class Choice(Model, frozen=True):
    """Method D, steps 2 and 5: the presets of the choice."""

    turn_deg: Positive = _deg(_TRAVEL.choice.turn)
    """The compass differs from the last cycle's by more: a turn."""
    tilt_on_turn_deg: NotNegative = _deg(_TRAVEL.choice.tilt_on_turn)
    """On a turn: tilt heading from this pitch or roll on."""
    differ_deg: NotNegative = _deg(_TRAVEL.choice.differ)
    """The two headings contradict each other from this difference on."""
    tilt_deg: NotNegative = _deg(_TRAVEL.choice.tilt)
    """No turn, no contradiction: tilt heading from this pitch or roll on."""


class Alternative(Model, frozen=True):
    """The alternative beside method D."""

    gravity_time: Positive = _TRAVEL.modern.gravity_time
    """Time constant with which the accelerometer levels the attitude [s]."""
    compass_time: Positive = _TRAVEL.modern.compass_time
    """Time constant with which a heading signal turns it [s]."""
    lead_deg: Angle = _deg(_TRAVEL.modern.lead)
    """By how much forward leads vertical acceleration at the step's frequency."""
    memory_steps: Positive = _TRAVEL.modern.memory_steps
    """Steps after which the direction within the terminal is forgotten to 1/e."""
    carry_change_deg: Positive = _deg(_TRAVEL.modern.carry_change)
    """The vertical moved so far in the terminal: carried otherwise, begin anew."""


class TravelDirection(Model, frozen=True):
    """Direction of travel of a carried terminal: method D, on samples in terminal axes."""

    enabled: bool = False
    """Whether it is computed and sent; needs a magnetometer or a heading."""
    method: Literal["alternative", "published"] = "alternative"
    """Whose heading is sent; without a gyroscope it is the published one's."""
    convention: Literal["force", "gravity"] = _TRAVEL.convention
    """What the terminal's accelerometer at rest reads on the axis that points up: +g or -g."""
    compass: Literal["clockwise", "counter_clockwise"] = _TRAVEL.compass
    """Which way the heading signal counts; a magnetometer has a sign per axis."""
    declination_deg: Angle = _deg(_TRAVEL.declination)
    """Magnetic declination, east positive."""
    steps: Steps = Steps()
    choice: Choice = Choice()
    alternative: Alternative = Alternative()
