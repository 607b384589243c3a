"""Sums over the ticks of a block, in one order of summation.

By how much the force of one block answers turned from dv/dt and v r, and how sure that is.

Gravity is taken off as the gyroscope carries it (`gravity_observer`), so slopes are not in it, and
the speed's delay is taken out. What a lever arm may turn, or a slip of the tyres that acts like
one, is in the variance, and so is what the block leaves over of its own force: a gust, a bad road.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.motion.signal_health import slope
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import SignalBlock
from imucald.mount.vertical_block import FORCE_NOISE

Flags = NDArray[np.bool_]


class BlockSums(NamedTuple):
    """Over n ticks: force (3,) in sensor axes, dv/dt, v r [m/s^2], the speed's size [m/s].

    fastest: the largest of the latter.
    """

    n: int
    force: tuple[float, float, float]
    accel: float
    turn: float
    speed: float
    fastest: float


def driven(p: SignalBlock) -> Flags:
    """Ticks (N,) that may be learnt from, and of which it is known how fast the vehicle drives."""
    return p.learn & (p.ok_speed | p.rest)


def block_sums(p: SignalBlock, turn_rate: Array, use: Flags) -> BlockSums:
    """Of the ticks (N,) in use; turn_rate: (N,) r [rad/s]."""
    out = np.empty(8)
    size = np.abs(p.speed) * use
    out[0] = np.count_nonzero(use)
    (p.force * use[:, None]).sum(axis=0, out=out[1:4])
    out[4] = (p.accel * use).sum()
    out[5] = (p.speed * turn_rate * use).sum()
    out[6], out[7] = size.sum(), size.max()
    n, x, y, z, accel, turn, speed, fastest = out.tolist()
    return BlockSums(int(n), (x, y, z), accel, turn, speed, fastest)


def pair_sums(
    x: Array, y: Array, use: Flags, centred: bool = False
) -> tuple[int, float, float, float]:
    """How many ticks (N,) are in use, and of those the sums of x x, x y, y y.

    centred: about the means.
    """
    count = int(np.count_nonzero(use))
    if not count:
        return 0, 0.0, 0.0, 0.0
    if count < len(use):
        x, y = x[use], y[use]
    if centred:
        x, y = x - x.sum() / count, y - y.sum() / count
    xx, xy, yy = (float(one.sum()) for one in (x * x, x * y, y * y))
    return count, xx, xy, yy


def masked_sums(values: Array, use: Flags) -> tuple[int, float, float, float]:
    """How many ticks (N,) are in use, and the sums of their vectors (N, 3)."""
    out = np.empty(4)
    out[0] = np.count_nonzero(use)
    (values * use[:, None]).sum(axis=0, out=out[1:])
    n, x, y, z = out.tolist()
    return int(n), x, y, z


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
    n, s00, s11, s20, s21, s22, s24, s25, s30, s31, s33, s34, s35, s36 = _sums(m, use)
    power = s22 + s33
    if power < LEAST_MOTION:
        return 0.0, 0.0
    across, along = s30 - s21, s20 + s31
    shown = math.hypot(across, along)
    if shown < FOLLOWED * power:
        return 0.0, 0.0
    left = s00 + s11 + power - 2.0 * shown  # by the motion, turned
    noise = (PRIOR_TICKS * FORCE_NOISE**2 + 0.5 * left) / (PRIOR_TICKS + n)
    ahead, aside = s34 + s25, s35 - s24
    late = (m.delay_std * m.delay_std + DELAY_STD**2) * s36**2
    turned2 = (ARM * ARM * (ahead * ahead + aside * aside) + late) / (power * power)
    return math.atan2(across, along), 1.0 / (TOGETHER * noise / power + turned2 + FLOOR**2)


_PAIRS = np.array(
    [
        (0, 0), (1, 1), (2, 0), (2, 1), (2, 2), (2, 4), (2, 5), (3, 0), (3, 1), (3, 3), (3, 4),
        (3, 5), (3, 6),
    ]
)  # fmt: skip
"""Products of force ahead and across, dv/dt, v r, r^2, and the slopes of r and of dv/dt."""


def _sums(m: BlockMotion, use: Flags) -> list[float]:
    """How many ticks are in use, and sums of products about their means, see `_PAIRS`."""
    late = m.delay / TICK_S
    n = len(use)
    at = np.minimum(np.maximum(np.arange(n) + late, 0.0), n - 1.0)
    before = np.minimum(at.astype(np.int64), n - 2)
    low = m.accel[before]
    accel = (m.accel[before + 1] - low) * (at - before) + low
    each = np.array(
        [
            m.force[:, 0], m.force[:, 1], accel, m.turn, m.turn_rate * m.turn_rate,
            slope(m.turn_rate), slope(accel),
        ]
    ).compress(use, axis=1)  # fmt: skip
    count = each.shape[1]
    if count:
        each -= each.sum(axis=1, keepdims=True) / count
    sums = (each.take(_PAIRS[:, 0], axis=0) * each.take(_PAIRS[:, 1], axis=0)).sum(axis=1)
    return [float(count), *sums.tolist()]
