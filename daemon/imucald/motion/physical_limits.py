"""Physical limits of sensors and road vehicles, for mount, attitude and motion.

There are three kinds of limits. A value that no sensor of this kind can measure is *impossible*.
Impossible values are dropped before any use. A motion that no road vehicle makes is *implausible*.
The cause of an implausible motion may be a fall, a turntable or a wrong unit. A value at the end of
the sensor's range is *saturated*, because the true value lies beyond the range.
(`inputs.quantities` checks the range that a signal's database states.)
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import ACCEL, GYRO, SPEED, STEERING, TICK_S, YAW_RATE, TickRow

# impossible --------------------------------------------------------------------------------

MAX_SAMPLE: Mapping[str, float] = {
    "gyro": 100.0,
    "accel": 1000.0,
    "mag": 0.01,
    "speed": 500.0,
    "heading": 100.0,
    "reverse": 1.0,
}
"""Largest possible values of single samples by channel, SI: 5,700 deg/s, 100 g, a hundred times the
earth's field. The limits also hold for a terminal that a person carries and drops.
"""
MAX_TICK: tuple[tuple[int, slice, float], ...] = (
    (ACCEL.n, slice(ACCEL.x, ACCEL.z + 1), 400.0),
    (ACCEL.n, slice(ACCEL.age, ACCEL.age + 1), 1.01 * TICK_S),
    (GYRO.n, slice(GYRO.x, GYRO.z + 1), 60.0),
    (GYRO.n, slice(GYRO.age, GYRO.age + 1), 1.01 * TICK_S),
    (SPEED.n, slice(SPEED.mean, SPEED.mean + 1), 150.0),
    (SPEED.n, slice(SPEED.age, SPEED.age + 1), 1.01 * TICK_S),
    (STEERING.n, slice(STEERING.mean, STEERING.mean + 1), 100.0),
    (YAW_RATE.n, slice(YAW_RATE.mean, YAW_RATE.mean + 1), 20.0),
)
"""Largest possible means over a tick in a vehicle. These limits are lower than the limits of
samples, because a mean reduces shocks. Each entry has the column of the count, the columns of the
values, and the largest absolute value in SI (40 g, 3,400 deg/s, 540 km/h, 16 turns of the steering
wheel).
"""


def is_plausible(channel: str, values: Sequence[float]) -> bool:
    """Return whether every number of a sample is finite and of a possible size."""
    limit = MAX_SAMPLE[channel]
    return all(-limit <= value <= limit for value in values)


# implausible on a road ---------------------------------------------------------------------

ROAD_FORCE = (0.5 * GRAVITY, 1.7 * GRAVITY)
"""Range of the mean specific force of a tick [m/s^2] that the joint estimator uses. The range
contains gravity with up to 1 g of tyre grip across (a size of 1.41 g) and some effect of road
waves.
"""
ROAD_FORCE_WIDE = (0.3 * GRAVITY, 3.0 * GRAVITY)
"""Range of the mean specific force of a tick [m/s^2] that method A uses.

Method A reduces the weight of outliers. Forces from potholes and kerbs are therefore allowed. Only
forces that no drive causes are rejected.
"""
MAX_ROAD_RATE = 4.0
"""Largest turn rate of a road vehicle [rad/s]. A rollover exceeds this rate. A spin on ice does not
exceed this rate."""
MAX_ROAD_DVDT = 12.0
"""Largest change of speed of a road vehicle [m/s^2]: the grip of tyres is about 1 g."""

# saturated ---------------------------------------------------------------------------------

NEAR_FULL_SCALE = 0.98
"""Share of the full scale from which a value counts as clipped.

Gain errors of sensors are within 1 % to 2 % (data sheets of automotive accelerometers), so the end
of the range may be lower by the same percentage.
"""


def is_saturated(tick: TickRow, full_scale: float) -> bool:
    """Return whether any axis of the accelerometer came close to the full scale in a tick.

    full_scale: [m/s^2].
    """
    limit = NEAR_FULL_SCALE * full_scale
    if limit == math.inf:
        return False
    highest = max(tick[ACCEL.max_x], tick[ACCEL.max_y], tick[ACCEL.max_z])
    lowest = min(tick[ACCEL.min_x], tick[ACCEL.min_y], tick[ACCEL.min_z])
    return highest >= limit or lowest <= -limit


def saturated_axes(rows: Array, full_scale: float) -> Flags:
    """Return flags of the axes (..., 3) that came close to the full scale in ticks (..., COLUMNS).
    A rejected sample sets the flags of all axes.
    """
    high = rows[..., ACCEL.max_x : ACCEL.max_z + 1]
    low = rows[..., ACCEL.min_x : ACCEL.min_z + 1]
    clipped: Flags = np.maximum(high, -low) > NEAR_FULL_SCALE * full_scale
    return clipped | (rows[..., ACCEL.bad] > 0)[..., None]
