"""Time-stamped physical samples: what every part inside the edges speaks.

Channels and their units (SI; shapes for N samples):

=================  ======  =============================================================
channel            shape   meaning
=================  ======  =============================================================
``accel``          (N, 3)  specific force in sensor axes [m/s^2] (+9.81 on an axis up at rest)
``gyro``           (N, 3)  angular rate in sensor axes [rad/s], right-handed
``mag``            (N, 3)  magnetic field in sensor axes [T]
``speed``          (N,)    vehicle speed [m/s], not negative; direction comes from ``reverse``
``wheel_speeds``   (N, 4)  front left, front right, rear left, rear right [m/s]
``steering``       (N,)    steering-wheel angle [rad], positive to the left
``yaw_rate``       (N,)    vehicle yaw rate [rad/s], positive to the left (ISO 8855)
``lateral_accel``  (N,)    vehicle lateral acceleration [m/s^2], positive to the left
``longitudinal_accel`` (N,) vehicle longitudinal acceleration [m/s^2], positive forward
``reverse``        (N,)    1 when the vehicle is in reverse gear, else 0
``brake``          (N,)    1 when the brake is applied, else 0
``heading``        (N,)    heading, clockwise from north [rad]
``temperature``    (N,)    sensor temperature [degC]
=================  ======  =============================================================
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

GRAVITY = 9.80665
"""Standard gravity [m/s^2] (ISO 80000-3)."""

CHANNEL_WIDTH: Mapping[str, int] = {
    "accel": 3,
    "gyro": 3,
    "mag": 3,
    "speed": 1,
    "wheel_speeds": 4,
    "steering": 1,
    "yaw_rate": 1,
    "lateral_accel": 1,
    "longitudinal_accel": 1,
    "reverse": 1,
    "brake": 1,
    "heading": 1,
    "temperature": 1,
}
"""How many numbers a sample of each channel has."""


class Series(Struct, frozen=True):
    """Samples of one channel, in time order.

    t: (N,) seconds, never decreasing. values: (N,) or (N, width), SI units, finite.
    """

    t: NDArray[np.float64]
    values: NDArray[np.float64]


Samples = Mapping[str, Series]
"""Channel name to its samples; a channel that a log lacks is absent."""
