"""Decide whether the sensor was turned or a zero of its accelerometer stepped.

The axis of turning decides. Both events change the direction of gravity. A sensor that is turned
also turns its gyroscope: the axis about which the vehicle turns in bends moves with gravity in
sensor axes. A step of a zero moves gravity alone. After each change of the tilt, the axes before
and after it are therefore compared. In sensor axes, about the earlier mean gravity u, let c be the
change of gravity's direction (tangent plane of u) and x the part of the axis' change along c:

    sensor turned: x = |c|,    zero stepped: x = 0,

This is a test of two simple hypotheses (Neyman and Pearson, Phil. Trans. R. Soc. A 231, 1933).
Neither is accepted until its likelihood is large enough. A rotation that the gyroscope measured
while gravity moved is evidence for the first hypothesis. The absence of a measured rotation is weak
evidence, because the gyroscope may have been off. A straight grade moves gravity and shows no axis.
A zero is therefore accepted only if gravity is off in bends too.

The axis is found as follows: in a block the vehicle turns by the vector w. The part of w along u is
the turn. The rest is the difference of slope and lean of road and body between the block's
beginning and end, which does not grow with the turn. The axis is therefore a regression of the rest
on the turn.
"""

from __future__ import annotations

import enum
import math

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.motion.ticks import TICK_S
from imucald.mount.block_sums import BlockSums, masked_sums
from imucald.mount.carried_force import CarriedForce
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.evidence_gravity import share_of_one_place
from imucald.mount.large_change import LEAST_TICKS
from imucald.mount.signal_blocks import BLOCK_S, SignalBlock

REMEMBERED = 240
"""Blocks that are remembered (26 min)."""
LEAST_TILT = 0.04
"""Smallest change of gravity that is examined [rad]: 40 mg, the zero error once the sensor is
soldered (BMI160 data sheet). A smaller change is within the deviation.
"""
MOST_TILT = 0.35
"""Largest change of gravity that is examined [rad], 20 deg: no zero is 350 mg off, and no earlier
rotation is kept.
"""
FEWEST = 2
"""Smallest number of blocks since a change from which gravity is known."""
TILTED, TILTED_BLOCKS = 0.03, 8.0
"""Change of slope and lean over a block [rad], and the weight of this prior in blocks: two
independent slopes of `SLOPE_STD`.
"""
STAYS = math.sqrt(2.0) * 0.007
"""Difference of the axis of turning between two roads [rad]."""
BELIEVED = math.log(20.0)
"""Log of the ratio of likelihoods at which at most one in twenty is wrong, if both are equally
probable.
"""
FELT_BLOCKS = 3
"""Number of blocks, up to the first block after a change, in which the gyroscope may have measured
the rotation.
"""
FELT_PART = 0.5
"""Fraction of all rotations of a sensor that happen while the bus is awake: one half
(assumption)."""
STANDING_METRES = 0.3
"""Road [m] for which a block of standing counts: it sees one place."""

AXIS_PRIOR = 0.07
"""Distance of the axis of turning from gravity before any bend [rad], 4 deg: in a measured van it
is 3 to 4 deg from the result of its INS.
"""
NO_PRIOR = 1e-6
NO_ROWS: Array = np.zeros((0, 8))
"""Columns of each block: force without motion (3,) [m/s^2], turn (3,) [rad], sensor axes; road [m];
time of its beginning [s].
"""


class GravityMoved(enum.Enum):
    """Cause of a change of gravity."""

    NOTHING = "nothing that is asked about"
    UNKNOWN = "not known yet"
    TURNED = "the sensor was turned"
    STEPPED = "a zero of the accelerometer has jumped"


class SeenOver(Struct, frozen=True):
    """Result over some blocks: distance of gravity and of the axis of turning from a vertical, as
    tangent vectors (3,) [rad].

    Each has the variance of a component.
    """

    gravity: Array
    gravity_variance: float
    axis: Array
    axis_variance: float


class ZeroStep:
    """Finds the cause of each change of the tilt.

    cause: cause of the last change that was examined.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._slope = settings.slope_std * max(settings.unevenness)
        self._length = settings.slope_length
        self._rows = NO_ROWS
        self._before: Array | None = None
        self._felt = np.zeros(3)
        self.cause = GravityMoved.NOTHING

    def restart(self) -> None:
        """Restart: later blocks are unrelated to the last ones. An open question stays open."""
        self._rows = NO_ROWS

    def ask(self, since: float) -> None:
        """Ask for the cause, because gravity has moved.

        since: beginning of the first block that is wholly after the change [s].
        """
        began = self._rows[:, 7]
        lately = (began > since - (FELT_BLOCKS + 0.5) * BLOCK_S) & (began < since - 0.5 * BLOCK_S)
        if self._before is None:
            self._felt = self._rows[lately, 3:6].sum(axis=0)
            self._before = self._rows[began < since - 1.5 * BLOCK_S]
        self._rows = self._rows[began > since - 0.5 * BLOCK_S]
        self.cause = GravityMoved.UNKNOWN
        self._judge()

    def add(self, p: SignalBlock, sums: BlockSums, carried: CarriedForce) -> None:
        """Take a block. sums: sums over the ticks that count.

        carried: has a rotation, and has already taken the block.
        """
        assert carried.R is not None
        n = sums.n
        if n < LEAST_TICKS:
            return
        gains = carried.gains
        ahead, aside = gains[0] * sums.accel / n, gains[1] * sums.turn / n
        axes = zip(sums.force, *carried.R[:2].tolist(), strict=True)
        row = [force / n - (ahead * x + aside * y) for force, x, y in axes]
        _, *turned = masked_sums(p.rate, p.ok_rate)
        row += [rate * TICK_S for rate in turned]
        row += [sums.speed * TICK_S + STANDING_METRES, p.t.item(0)]
        self._rows = np.concatenate([self._rows[1 - REMEMBERED :], [row]])
        self._judge()

    def _judge(self) -> None:
        rows = self._before
        if rows is None:
            return
        if len(rows) < FEWEST:  # nothing to compare with
            self._before, self.cause = None, GravityMoved.NOTHING
            return
        if len(self._rows) < FEWEST:
            return
        mean = rows[:, 6] @ rows[:, :3]
        up = mean / np.linalg.norm(mean)
        before = self._seen(rows, up, TILTED * TILTED / (AXIS_PRIOR * AXIS_PRIOR))
        after = self._seen(self._rows, up, NO_PRIOR)
        change = after.gravity - before.gravity
        size = float(np.linalg.norm(change))
        variance = before.gravity_variance + after.gravity_variance
        if size > MOST_TILT:
            self._before, self.cause = None, GravityMoved.TURNED
            return
        reach = 2.0 * math.sqrt(variance)
        if size < LEAST_TILT:
            self.cause = GravityMoved.NOTHING
            if size + reach < LEAST_TILT:
                self._before = None
            return
        along = float((after.axis - before.axis) @ change) / size
        still = before.axis_variance + after.axis_variance + STAYS * STAYS
        turned = still + variance
        left = along - size
        ratio = 0.5 * (along * along / still - left * left / turned + math.log(still / turned))
        ratio += self._felt_ratio(up, change / size, size, before)
        if ratio > BELIEVED:
            self._before, self.cause = None, GravityMoved.TURNED
        else:
            is_stepped = (
                ratio < -BELIEVED
                and size - reach > LEAST_TILT
                and self._is_off_in_bends(up, before, change)
            )
            self.cause = GravityMoved.STEPPED if is_stepped else GravityMoved.UNKNOWN

    def _is_off_in_bends(self, up: Array, before: SeenOver, change: Array) -> bool:
        """True if gravity was off where the axis was visible, by more than half of the change.

        Half is the middle between a zero that stepped and a straight grade behind the vehicle.
        """
        square = (self._rows[:, 3:6] @ up) ** 2
        mean = square @ self._rows[:, :3]
        there = mean / max(float(mean @ up), 1e-9) - up - before.gravity
        return bool(there @ change > 0.5 * change @ change)

    def _felt_ratio(self, up: Array, along: Array, size: float, before: SeenOver) -> float:
        """Return the contribution of a measured rotation to the log of the ratio.

        The change of gravity has a size [rad] along a direction (3,). A sensor with this change
        turns about along x up.
        """
        left = self._felt - float(self._felt @ up) * (up + before.axis)
        felt = float(left @ np.cross(along, up))
        more = size * (2.0 * felt - size) / (2.0 * TILTED * TILTED)
        return math.log(1.0 - FELT_PART + FELT_PART * math.exp(min(more, 50.0)))

    def _seen(self, rows: Array, up: Array, prior: float) -> SeenOver:
        """Return the result about a vertical (3,).

        prior: turning [rad^2] that has shown the axis to be there.
        """
        force, turn, metres = rows[:, :3], rows[:, 3:6], rows[:, 6]
        mean = metres @ force / float(metres.sum())
        part = share_of_one_place(float(metres.sum()), self._length)
        about = turn @ up
        across = turn - about[:, None] * up
        square = about * about
        known = float(square.sum())
        axis = about @ across / (known + prior)
        left = across - about[:, None] * axis
        blocks = known * known / max(float((square * square).sum()), 1e-12)
        spread = 0.5 * float(square @ (left * left).sum(axis=1)) / max(known, 1e-12)
        noise = (TILTED_BLOCKS * TILTED**2 + blocks * spread) / (TILTED_BLOCKS + blocks)
        gravity = mean / float(mean @ up) - up
        return SeenOver(gravity, self._slope**2 * part, axis, noise / (known + prior))
