"""What methods B and C say: the attitude, its uncertainty, its state."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from imucald.core.rotations import Vector

SETTLED_STD = math.radians(1.5)
"""Tilt is published as settled below this [rad]."""
STALE_S = 1.0
"""Without gyroscope or accelerometer for so long the attitude is not available [s]."""
UNKNOWN: Vector = (math.nan, math.nan, math.nan)
"""A vector of which nothing is known."""


class AttitudeState(enum.IntEnum):
    """State of the attitude; the numbers are those on the bus."""

    NOT_AVAILABLE = 0
    STARTING = 1
    SETTLING = 2
    RELATIVE_HEADING = 3
    FULL = 4
    UNFILTERED = 5


@dataclass(frozen=True)
class AttitudeEstimate:
    """The attitude at the newest gyroscope sample; vehicle axes, radians; NaN where not known.

    roll (left side up), pitch (nose down), heading (clockwise from north, or from the start where
    `state` says so); std of the three; rate: (x, y, z) free of bias [rad/s], rate_std likewise;
    grade: slope of the road, tangent, positive uphill; bias: found so far [rad/s];
    free_acceleration: specific force less that of motion, gravity and error (method B) [m/s^2],
    where it is asked for.
    """

    state: AttitudeState
    t: float
    roll: float
    pitch: float
    heading: float
    std: Vector
    rate: Vector
    rate_std: Vector
    grade: float
    grade_std: float
    bias: Vector
    free_acceleration: Vector = UNKNOWN
