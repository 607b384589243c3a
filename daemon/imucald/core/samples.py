"""Time-stamped physical samples: the common data format inside the package."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

GRAVITY = 9.80665
"""Standard gravity [m/s^2] (ISO 80000-3)."""

SI_UNITS: Mapping[str, str] = {
    "acceleration": "m/s^2",
    "angular_rate": "rad/s",
    "angle": "rad",
    "speed": "m/s",
    "magnetic_field": "T",
    "temperature": "degC",
    "flag": "",
}
"""Unit of each dimension."""


class Quantity(NamedTuple):
    """Meaning of a channel's samples.

    key: its key in the configuration's `signals`. title: its words in reports. width: numbers per
    sample. tick: what a tick holds of it (`motion.ticks`): "mean" (number of samples and their
    mean), "last" (the last value), or empty: nothing, or columns of its own.
    """

    channel: str
    key: str
    dimension: str
    title: str
    width: int = 1
    tick: Literal["", "mean", "last"] = ""

    @property
    def unit(self) -> str:
        """SI unit; empty for a flag."""
        return SI_UNITS[self.dimension]


ACCEL = Quantity("accel", "accelerometer", "acceleration", "accelerometer", 3)
"""Specific force in sensor axes: +9.81 on an axis up at rest."""
GYRO = Quantity("gyro", "gyroscope", "angular_rate", "gyroscope", 3)
"""Angular rate in sensor axes, right-handed."""
MAG = Quantity("mag", "magnetometer", "magnetic_field", "magnetometer", 3)
SPEED = Quantity("speed", "speed", "speed", "speed")
"""Not negative; the direction comes from `REVERSE`."""
WHEEL_SPEEDS = Quantity("wheel_speeds", "wheel_speeds", "speed", "wheel speeds", 4)
"""Front left, front right, rear left, rear right."""
STEERING = Quantity("steering", "steering_wheel_angle", "angle", "steering", tick="mean")
"""As `YAW_RATE` and the accelerations of the vehicle (ISO 8855): positive to the left, forward."""
YAW_RATE = Quantity("yaw_rate", "yaw_rate", "angular_rate", "vehicle yaw rate", tick="mean")
LATERAL_ACCEL = Quantity(
    "lateral_accel", "lateral_acceleration", "acceleration", "vehicle lateral acceleration",
    tick="mean",
)  # fmt: skip
LONGITUDINAL_ACCEL = Quantity(
    "longitudinal_accel", "longitudinal_acceleration", "acceleration",
    "vehicle longitudinal acceleration", tick="mean",
)  # fmt: skip
REVERSE = Quantity("reverse", "reverse", "flag", "reverse", tick="last")
"""1 in reverse gear, else 0."""
BRAKE = Quantity("brake", "brake", "flag", "brake", tick="last")
"""1 when it is applied, else 0."""
TEMPERATURE = Quantity("temperature", "temperature", "temperature", "temperature", tick="last")
"""Temperature of the sensor."""
HEADING = Quantity("heading", "heading", "angle", "heading", tick="last")
"""Clockwise from north."""

QUANTITIES: Mapping[str, Quantity] = {
    row.channel: row
    for row in (
        ACCEL, GYRO, MAG, SPEED, WHEEL_SPEEDS, STEERING, YAW_RATE, LATERAL_ACCEL,
        LONGITUDINAL_ACCEL, REVERSE, BRAKE, TEMPERATURE, HEADING,
    )
}  # fmt: skip
"""Every quantity, by channel, in the order for people.

A sample is one number or `width` numbers in `unit`: arrays (N,) or (N, width). Each quantity with a
setting of its `key` in `config/signals.py` is read from the bus.
"""

INERTIAL = tuple(
    row.channel for row in QUANTITIES.values() if row.dimension in ("acceleration", "angular_rate")
)
"""Channels of accelerations and rates: the noise of the sensor changes their values from sample to
sample.
"""


TRIADS = tuple(row.channel for row in QUANTITIES.values() if row.width == 3)
VEHICLE_SIGNALS = tuple(row.channel for row in QUANTITIES.values() if row.tick == "mean")
"""Channels of signals of the vehicle with one number each, but for the speed."""
FLAGS = tuple(row.channel for row in QUANTITIES.values() if row.dimension == "flag")


def width_of(channel: str) -> int:
    """Return the number of values in a sample; a channel of a parallel sensor has three."""
    return QUANTITIES[channel].width if channel in QUANTITIES else 3


class Series(Struct, frozen=True):
    """Samples of one channel, in time order.

    t: (N,) seconds, never decreasing. values: (N,) or (N, width), SI units, finite.
    """

    t: NDArray[np.float64]
    values: NDArray[np.float64]


Samples = Mapping[str, Series]
"""Channel name to its samples; a channel that a log lacks is absent."""
