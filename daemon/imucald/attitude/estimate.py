"""Result of methods B and C: the attitude, its uncertainty, and its state."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from imucald.core.rotations import Vector

SETTLED_STD = math.radians(1.5)
"""Deviation of the tilt below which the attitude is settled [rad]."""
STALE_S = 1.0
"""Time without gyroscope or accelerometer after which the attitude is not available [s]."""
UNKNOWN: Vector = (math.nan, math.nan, math.nan)
"""A vector that is not known."""


class AttitudeState(enum.IntEnum):
    """State of the attitude. The numbers are also sent on the bus."""

    NOT_AVAILABLE = 0
    STARTING = 1
    SETTLING = 2
    RELATIVE_HEADING = 3
    FULL = 4
    UNFILTERED = 5


@dataclass(frozen=True)
class AttitudeEstimate:
    """The attitude at the newest gyroscope sample, in vehicle axes [rad]; NaN if not known.

    roll: left side up. pitch: nose down. heading: clockwise, from north, or from the start of the
    drive with the state RELATIVE_HEADING. std: deviations of roll, pitch and heading. rate: (x, y,
    z) without bias [rad/s]; rate_std: its deviations. grade: slope of the road, tangent, positive
    uphill. bias: estimated bias of the gyroscope [rad/s]. free_acceleration: specific force without
    the effect of motion (method B) [m/s^2], if requested.
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
