"""Sums over the ticks of a block, and the yaw angle that a single block shows.

`block_yaw` returns the angle by which the force of one block is turned against dv/dt and v r (speed
times yaw rate), and its information.

The direction of gravity is integrated with the gyroscope (`gravity_observer`) and gravity is
subtracted, so the force contains no slopes. The delay of the speed is corrected. Where the speed is
known at some times only, means between these times are compared (`drive.speed_knots`). The variance
includes three errors: a lever arm, a tyre slip that acts like a lever arm, and the residual force
of the block, for example from a gust or a bad road.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array, Flags
from imucald.drive.speed_knots import means_between
from imucald.motion.signal_health import slope
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import SignalBlock


class BlockSums(NamedTuple):
    """Sums over n ticks: force (3,) in sensor axes, dv/dt, v r (speed times yaw rate) [m/s^2],
    absolute speed [m/s].

    fastest: largest absolute speed [m/s].
    """

    n: int
    force: tuple[float, float, float]
    accel: float
    turn: float
    speed: float
    fastest: float


def driven(p: SignalBlock) -> Flags:
    """Return flags (N,) of the usable ticks whose speed is known or zero."""
    return p.learn & (p.ok_speed | p.rest)


def block_sums(p: SignalBlock, turn_rate: Array, use: Flags) -> BlockSums:
    """Return the sums over the ticks that `use` (N,) selects. turn_rate: (N,) r [rad/s]."""
    out = np.empty(8)
    size = np.abs(p.speed) * use
    out[0] = np.count_nonzero(use)
    (p.force * use[:, None]).sum(axis=0, out=out[1:4])
    out[4] = (p.accel * use).sum()
    out[5] = (p.speed * turn_rate * use).sum()
    out[6], out[7] = size.sum(), size.max()
    n, x, y, z, accel, turn, speed, fastest = out.tolist()
    return BlockSums(int(n), (x, y, z), accel, turn, speed, fastest)


class PairSums(NamedTuple):
    """Sums over ticks of two signals x and y: number of ticks, x x, x y, y y, x, y."""

    ticks: float = 0.0
    xx: float = 0.0
    xy: float = 0.0
    yy: float = 0.0
    x: float = 0.0
    y: float = 0.0

    def centred(self) -> PairSums:
        """Return the sums after the means of x and y were subtracted."""
        n, xx, xy, yy, x, y = self
        n = max(n, 1.0)
        return PairSums(n, xx - x * x / n, xy - x * y / n, yy - y * y / n)


def pair_sums(x: Array, y: Array, use: Flags) -> PairSums:
    """Return the sums of two signals (N,) over the ticks that `use` (N,) selects."""
    count = int(np.count_nonzero(use))
    if not count:
        return PairSums()
    if count < len(use):
        x, y = x[use], y[use]
    return PairSums(count, *(float(one.sum()) for one in (x * x, x * y, y * y, x, y)))


def masked_sums(values: Array, use: Flags) -> tuple[int, float, float, float]:
    """Return the number of ticks that `use` (N,) selects, and the sums of their vectors (N, 3)."""
    out = np.empty(4)
    out[0] = np.count_nonzero(use)
    (values * use[:, None]).sum(axis=0, out=out[1:])
    n, x, y, z = out.tolist()
    return int(n), x, y, z


FORCE_NOISE = 0.06
"""Noise of the force in one tick without a disturbance [m/s^2], rms."""
PRIOR_TICKS = 16.0
"""Weight of the prior `FORCE_NOISE` in the noise of a block, as a number of ticks."""
TOGETHER = 3.0
"""Correlation length of the noise in ticks: the vehicle body oscillates in pitch and roll at 1 to 2
Hz."""
ARM = 1.5
"""Assumed distance of the sensor from the point that rolls without slip, near the rear axle [m]."""
FLOOR = math.radians(0.5)
"""Smallest deviation of the yaw angle from one block [rad], because of gain errors and squat."""
DELAY_STD = 0.02
"""Smallest deviation of the speed's delay [s]: the delay varies by this much with the engine
load."""
LEAST_MOTION = 1.0
"""Smallest sum of squared motion of a usable block [(m/s^2)^2 ticks].

With this sum, the deviation of the yaw angle is 6 deg.
"""

FOLLOWED = 0.5
"""Smallest ratio of force to motion for which a block shows a direction. With a smaller ratio, only
the gyroscope was turned, or the speed was not the speed of the vehicle.
"""


class BlockMotion(Struct, frozen=True):
    """The force of a block and the motion with which the force is compared.

    force: (N, 3) without gravity, in vehicle axes. accel, turn: (N,) dv/dt and v r (speed times yaw
    rate), multiplied by their gains. turn_rate: (N,) r [rad/s]. delay, delay_std: delay of the
    speed against the force and its deviation [s]. knots: (K,) times at which the vehicle's speed
    was known [ticks since the block began]; None: the speed was known in each tick.
    """

    force: Array
    accel: Array
    turn: Array
    turn_rate: Array
    delay: float
    delay_std: float
    knots: Array | None = None


def block_yaw(m: BlockMotion, use: Flags) -> tuple[float, float]:
    """Return an angle about z [rad] and its information [1/rad^2]: the angle by which the sensor is
    turned relative to the axes of the force.
    """
    together, fitted = TOGETHER, 0.0
    if m.knots is not None:
        if len(m.knots) < 2:
            return 0.0, 0.0
        first, last = m.knots[0], m.knots[-1]  # outside, no mean of dv/dt is known
        middles = np.arange(len(use)) + 0.5
        use = use & (first < middles) & (middles < last)
        together = max(TOGETHER, (last - first) / (len(m.knots) - 1.0))
        fitted = 2.0 * together  # of few means, the mean and the yaw itself take up two
    n, s00, s11, s20, s21, s22, s24, s25, s30, s31, s33, s34, s35, s36 = _sums(m, use)
    power = s22 + s33
    if power < LEAST_MOTION:
        return 0.0, 0.0
    across, along = s30 - s21, s20 + s31
    shown = math.hypot(across, along)
    if shown < FOLLOWED * power:
        return 0.0, 0.0
    left = s00 + s11 + power - 2.0 * shown  # by the motion, turned
    noise = (PRIOR_TICKS * FORCE_NOISE**2 + 0.5 * left) / (PRIOR_TICKS + max(n - fitted, 0.0))
    ahead, aside = s34 + s25, s35 - s24
    late = (m.delay_std * m.delay_std + DELAY_STD**2) * s36**2
    turned2 = (ARM * ARM * (ahead * ahead + aside * aside) + late) / (power * power)
    return math.atan2(across, along), 1.0 / (together * noise / power + turned2 + FLOOR**2)


_PAIRS = np.array(
    [
        (0, 0), (1, 1), (2, 0), (2, 1), (2, 2), (2, 4), (2, 5), (3, 0), (3, 1), (3, 3), (3, 4),
        (3, 5), (3, 6),
    ]
)  # fmt: skip
"""Pairs of factors of the products. The factors are, in this order: force ahead, force to the left,
dv/dt, v r (speed times yaw rate), r^2, derivative of r, derivative of dv/dt.
"""


def _sums(m: BlockMotion, use: Flags) -> list[float]:
    """Return the number of ticks in use and the sums of the products in `_PAIRS`. The mean of each
    signal is subtracted first."""
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
    )  # fmt: skip
    if m.knots is not None:
        each = means_between(each.T, m.knots, use).T
    each = each.compress(use, axis=1)
    count = each.shape[1]
    if count:
        each -= each.sum(axis=1, keepdims=True) / count
    sums = (each.take(_PAIRS[:, 0], axis=0) * each.take(_PAIRS[:, 1], axis=0)).sum(axis=1)
    return [float(count), *sums.tolist()]
