"""Settings of methods B and C; the defaults are those of the configuration. SI units, radians."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from imucald.core.rotations import Vector

_DEG = math.pi / 180.0

HeadingSource = Literal["free", "signal", "magnetometer"]


@dataclass(frozen=True)
class CompensationSettings:
    """Method B: how motion is taken out of the accelerometer.

    Lever arm: from the middle of the axle that does not steer to the sensor, vehicle axes [m].
    """

    average: float = 0.2
    """Time over which speed is averaged [s]: v_avg of the text."""
    interval: float = 1.0
    """Shortest time between two averages that are differenced [s]: coarse speed, quietly."""
    timeout: float = 3.0
    """Speed older than this is not known [s]; OBD-II answers come once a second."""
    delay: float = 0.0
    """How late the speed is against the accelerometer [s]; negative: it leads."""
    lever_arm: Vector = (0.0, 0.0, 0.0)
    speed_is: Literal["along_road", "horizontal"] = "along_road"
    """What the speed counts: wheels along the road, or satellites over the map."""
    centripetal: Literal["full", "plane"] = "full"
    """omega x v in full, or rate times speed as one number along the lateral axis."""
    rate_time: float = 0.0
    """Method B alone: time over which the corrected acceleration draws the angles that the
    corrected rate carries [s]; 0: the acceleration alone, each sample for itself."""
    send: bool = False
    """Make the specific force less motion, each instant, for the bus."""
    speed_noise: float = 0.03
    """Standard deviation of an averaged speed [m/s]."""
    speed_scale: float = 0.02
    """Relative uncertainty of speed, and of a_fwd with it (tyre radius, slip)."""
    creep_speed: float = 1.0
    """Below this a speed signal may still say zero [m/s]."""
    lever_uncertainty: float = 1.0
    """How well the lever arm is known [m]: side-slip of the body is a lever arm too."""


@dataclass(frozen=True)
class FilterSettings:
    """Method C: rates, noises, start and check."""

    heading: HeadingSource = "free"
    check: float = 30.0
    """Rest that the sensor check needs [s]."""
    check_level: bool = False
    """The check is made on level ground: the whole rest mean is bias, not only its length."""
    start: float = 5.0
    """Rest that the start needs [s]; of motion, where the vehicle does not stand."""
    longest_step: float = 0.5
    """Gyroscope samples further apart than this are a gap [s]."""
    rest_update: bool = True
    """The gyroscope at rest tells its zero error (beyond the text)."""
    rest_accel_spread: float = 0.25
    """Largest standard deviation of the accelerometer at rest [m/s^2]: an engine may run."""
    rest_gyro_spread: float = 0.5 * _DEG
    """The same of the gyroscope [rad/s]."""
    gyro_noise: float = 0.01 * _DEG
    """Gyroscope noise density [rad/s/sqrt(Hz)]."""
    gyro_start: float = 0.5 * _DEG
    """Zero error before any check [rad/s], standard deviation."""
    gyro_random: float = 0.01 * _DEG
    """Random gyroscope error [rad/s]: by sqrt(2) of this it walks in `gyro_random_time`."""
    gyro_random_time: float = 600.0
    """[s]"""
    gyro_scale: float = 0.003
    """Relative error of a turned angle that leaks into the other axes (scale, cross-axis)."""
    accel_noise: float = 0.02
    """Standard deviation of an interval's mean specific force [m/s^2]."""
    accel_random: float = 0.098
    """Random accelerometer error [m/s^2], standard deviation of a Gauss-Markov process."""
    accel_random_time: float = 1800.0
    """Its correlation time [s]."""
    unknown_motion: float = 1.0
    """Standard deviation of the horizontal acceleration where speed is not known [m/s^2]."""
    heading_noise: float = 2.0 * _DEG
    """Standard deviation of a heading signal [rad]."""
    magnetometer_noise: float = 10.0 * _DEG
    """The same of a heading from the magnetometer: steel deflects it."""
    declination: float = 0.0
    """Magnetic declination, east positive [rad]."""
    gate: float = 4.0
    """Innovations beyond so many standard deviations widen their own noise."""


@dataclass(frozen=True)
class AttitudeSettings:
    """All of it."""

    compensation: CompensationSettings = CompensationSettings()
    filter: FilterSettings = FilterSettings()
    squat: float = 0.0
    """Pitch of the body per forward specific force [rad/(m/s^2)], nose up when accelerating."""
    grade_time: float = 1.0
    """Time constant of the road grade [s]: longer than the body swings."""
