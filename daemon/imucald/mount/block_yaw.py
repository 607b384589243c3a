"""By how much the force of one block answers turned from dv/dt and v r, and how sure that is.

Gravity is taken off as the gyroscope carries it (`gravity_observer`), so slopes are not in it, and
the speed's delay is taken out. What a lever arm may turn, or a slip of the tyres that acts like
one, is in the variance, and so is what the block leaves over of its own force: a gust, a bad road.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.motion.signal_health import slope
from imucald.motion.ticks import TICK_S
from imucald.mount.vertical_block import FORCE_NOISE

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

PRIOR_TICKS = 16.0
"""The noise of a block is taken as `FORCE_NOISE` with the weight of so many ticks."""
TOGETHER = 3.0
"""Ticks over which the noise hangs together: the body pitches and rolls at 1 to 2 Hz."""
ARM = 1.5
"""The sensor is so far from the point that rolls without slip, about the rear axle [m]."""
FLOOR = math.radians(0.5)
"""No block is surer [rad]: gains, squat."""
DELAY_STD = 0.02
"""The speed's delay is never known better [s]; it differs by so much with the engine's load."""
LEAST_MOTION = 1.0
"""A block with less squared motion says nothing [(m/s^2)^2 ticks]; its deviation is 6 deg there."""

FOLLOWED = 0.5
"""A force that answers by less than so much of the motion says nothing of its direction: the
gyroscope was turned by itself, or the speed was not the vehicle's."""


class BlockMotion(Struct, frozen=True):
    """What a block's force is held against.

    force: (N, 3) without gravity, in vehicle axes. accel, turn: (N,) dv/dt and v r, with their
    gains. turn_rate: (N,) r [rad/s]. delay, delay_std: of the speed against the force [s].
    """

    force: Array
    accel: Array
    turn: Array
    turn_rate: Array
    delay: float
    delay_std: float


def block_yaw(m: BlockMotion, use: Flags) -> tuple[float, float]:
    """Angle about z by which the sensor is turned from R [rad], and its information [1/rad^2]."""
    ticks = np.arange(len(use))
    accel = np.interp(ticks + m.delay / TICK_S, ticks, m.accel)
    each = np.empty((7, len(use)))
    each[:2] = m.force[:, :2].T
    each[2], each[3], each[4] = accel, m.turn, m.turn_rate * m.turn_rate
    each[5] = slope(m.turn_rate)
    each[6] = slope(accel)
    each = each[:, use]
    n = each.shape[1]
    each -= each.sum(axis=1, keepdims=True) / n
    # all sums of products at once
    sums = each @ each.T
    power = float(sums[2, 2] + sums[3, 3])
    if power < LEAST_MOTION:
        return 0.0, 0.0
    across, along = float(sums[3, 0] - sums[2, 1]), float(sums[2, 0] + sums[3, 1])
    shown = math.hypot(across, along)
    if shown < FOLLOWED * power:
        return 0.0, 0.0
    left = float(sums[0, 0] + sums[1, 1]) + power - 2.0 * shown  # by the motion, turned
    noise = (PRIOR_TICKS * FORCE_NOISE**2 + 0.5 * left) / (PRIOR_TICKS + n)
    ahead, aside = float(sums[3, 4] + sums[2, 5]), float(sums[3, 5] - sums[2, 4])
    late = (m.delay_std * m.delay_std + DELAY_STD**2) * float(sums[3, 6]) ** 2
    turned2 = (ARM * ARM * (ahead * ahead + aside * aside) + late) / (power * power)
    return math.atan2(across, along), 1.0 / (TOGETHER * noise / power + turned2 + FLOOR**2)
