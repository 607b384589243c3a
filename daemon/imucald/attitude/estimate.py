"""Result of methods B and C: the attitude, its uncertainty, its state."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from imucald.core.rotations import Vector

SETTLED_STD = math.radians(1.5)
"""Deviation of the tilt below which it is published as settled [rad]."""
STALE_S = 1.0
"""Without gyroscope or accelerometer for this long, the attitude is not available [s]."""
UNKNOWN: Vector = (math.nan, math.nan, math.nan)
"""An unknown vector."""


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
    """The attitude at the newest gyroscope sample; vehicle axes, radians; NaN if not known.

    roll (left side up), pitch (nose down), heading (clockwise from north, or from the start where
    `state` says so), and std of the three. rate: (x, y, z) without bias [rad/s], with rate_std.
    grade: slope of the road, tangent, positive uphill. bias: found so far [rad/s].
    free_acceleration: specific force less that of motion, gravity and error (method B) [m/s^2], if
    requested.
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
