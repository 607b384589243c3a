"""Time-stamped physical samples: the common data format inside the package."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

GRAVITY = 9.80665
"""Standard gravity [m/s^2] (ISO 80000-3)."""


class Dimension(NamedTuple):
    """What all quantities of a dimension share.

    unit: SI unit; empty for a flag. largest: largest plausible magnitude [SI]; no sensor in a road
    vehicle measures a larger value. suffix: the unit at the end of a column's name in tables.
    """

    unit: str
    largest: float
    suffix: str


DIMENSIONS: Mapping[str, Dimension] = {
    "acceleration": Dimension("m/s^2", 200.0, "mps2"),
    "angular_rate": Dimension("rad/s", 70.0, "radps"),
    "angle": Dimension("rad", 30.0, "rad"),
    "speed": Dimension("m/s", 150.0, "mps"),
    "magnetic_field": Dimension("T", 0.01, "tesla"),
    "temperature": Dimension("degC", 1000.0, "degc"),
    "flag": Dimension("", math.inf, ""),
}
"""All dimensions. Their other units are in `inputs/units.py`."""


class Quantity(NamedTuple):
    """Meaning of a channel's samples.

    key: key in the section `signals` of the configuration. title: name in reports. width: number of
    values per sample. tick: the values that a tick stores (`motion.ticks`): "mean" (number of
    samples and their mean), "last" (the last value), or empty (no values, or special columns).
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
        return DIMENSIONS[self.dimension].unit

    @property
    def largest(self) -> float:
        """Largest plausible magnitude [SI]."""
        return DIMENSIONS[self.dimension].largest

    @property
    def suffix(self) -> str:
        """The unit at the end of a column's name in tables; empty for a flag."""
        return DIMENSIONS[self.dimension].suffix


ACCEL = Quantity("accel", "accelerometer", "acceleration", "accelerometer", 3)
"""Specific force in sensor axes. An axis that points up reads +9.81 m/s^2 at rest."""
GYRO = Quantity("gyro", "gyroscope", "angular_rate", "gyroscope", 3)
"""Angular rate in sensor axes, right-handed."""
MAG = Quantity("mag", "magnetometer", "magnetic_field", "magnetometer", 3)
SPEED = Quantity("speed", "speed", "speed", "speed")
"""Speed of the vehicle, not negative. `REVERSE` contains the direction."""
WHEEL_SPEEDS = Quantity("wheel_speeds", "wheel_speeds", "speed", "wheel speeds", 4)
"""Speeds of the wheels: front left, front right, rear left, rear right."""
STEERING = Quantity("steering", "steering_wheel_angle", "angle", "steering", tick="mean")
"""Steering-wheel angle. Like `YAW_RATE` and the accelerations of the vehicle, it is positive to the
left (forward for the longitudinal acceleration), as in ISO 8855."""
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
"""Reverse gear: 1 in reverse, else 0."""
BRAKE = Quantity("brake", "brake", "flag", "brake", tick="last")
"""Brake: 1 if it is applied, else 0."""
TEMPERATURE = Quantity("temperature", "temperature", "temperature", "temperature", tick="last")
"""Temperature of the sensor."""
HEADING = Quantity("heading", "heading", "angle", "heading", tick="last")
"""Heading of the vehicle, clockwise from north."""

QUANTITIES: Mapping[str, Quantity] = {
    row.channel: row
    for row in (
        ACCEL, GYRO, MAG, SPEED, WHEEL_SPEEDS, STEERING, YAW_RATE, LATERAL_ACCEL,
        LONGITUDINAL_ACCEL, REVERSE, BRAKE, TEMPERATURE, HEADING,
    )
}  # fmt: skip
"""All quantities, by channel, in the order of reports.

A sample is one number or `width` numbers in `unit`. Samples are stored in arrays (N,) or (N,
width). A quantity is read from the bus if `config/signals.py` has a setting for its `key`.
"""

INERTIAL = tuple(
    row.channel for row in QUANTITIES.values() if row.dimension in ("acceleration", "angular_rate")
)
"""Channels of accelerations and turn rates. Because of the sensor's noise, their values change from
sample to sample.
"""


TRIADS = tuple(row.channel for row in QUANTITIES.values() if row.width == 3)
VEHICLE_SIGNALS = tuple(row.channel for row in QUANTITIES.values() if row.tick == "mean")
"""Channels of vehicle signals with one number per sample, except the speed."""
FLAGS = tuple(row.channel for row in QUANTITIES.values() if row.dimension == "flag")


def width_of(channel: str) -> int:
    """Return the number of values in a sample of a channel. Parallel sensors have three values."""
    return QUANTITIES[channel].width if channel in QUANTITIES else 3


def speed_of_wheels(wheels: Sequence[float]) -> float:
    """Return the result of `speeds_of_wheels` for one sample."""
    return float(speeds_of_wheels(np.array([wheels]))[0])


def speeds_of_wheels(wheels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the speed of the vehicle (N,) from four wheel speeds (N, 4): the mean of the two
    middle sizes, so that one slipping or blocked wheel has no effect."""
    ordered = np.sort(np.abs(wheels), axis=1)
    return np.asarray(0.5 * (ordered[:, 1] + ordered[:, 2]))


class Series(Struct, frozen=True):
    """Samples of one channel, in time order.

    t: (N,) time [s], never decreasing. values: (N,) or (N, width), SI units, finite.
    """

    t: NDArray[np.float64]
    values: NDArray[np.float64]


def direction_at(reverse: Series | None, t: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return -1 in reverse and 1 otherwise at the times t (N,) [s], from the last sample of the
    reverse signal."""
    if reverse is None or not len(reverse.t):
        return np.ones(len(t))
    rows = np.maximum(np.searchsorted(reverse.t, t, side="right") - 1, 0)
    return np.asarray(1.0 - 2.0 * reverse.values[rows])


Samples = Mapping[str, Series]
"""The samples of each channel, by its name. A channel without samples has no entry."""
