"""Detect a change of the accelerometer's zero or gain during a drive.

The size of gravity is compared with its own past.

The mean force of a block along the vertical is g on any road and in any driving: horizontal forces
do not show in it, and a vehicle keeps its height on average. Only errors of the sensor itself
change this level. Temperature moves a zero by 1 mg/K and a gain by 0.03 %/K (BMI160 data sheet):
slowly. A change within a minute is therefore a fault of the sensor.

This argument needs a vertical that the force corrects. Where no speed shows which part of the force
is motion, only the gyroscope carries the vertical. A gyroscope that is off by 0.4 deg/s tilts the
vertical by 18 deg in 45 s; the force along it is then 9.3. Such blocks are skipped
(`GravityObserver.is_held`).

Each of the last blocks is tried as the time of a change: the mean before is compared with the mean
after, as in `large_change`. A rotated sensor shows another mixture of the zeros of its axes, so a
change must exceed the effect of such a rotation.

A change across the vertical shows as a tilt, and not in this test.
"""

from __future__ import annotations

import math

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.mount.block_sums import masked_sums
from imucald.mount.large_change import LEAST_TICKS
from imucald.mount.signal_blocks import BLOCK_S, SignalBlock

REMEMBERED = 60
"""Blocks that are remembered (384 s): the last 4 to 9 are those since the change, the other 51 to
56 are those before. Older blocks are not compared, whether or not samples came since.
"""
LEAST_BEFORE = 10
"""Smallest number of blocks before a change (64 s)."""
AFTER = range(4, 10)
"""Numbers of blocks after a change that are tested (26 to 58 s)."""
LEAST = 0.3
"""Smallest change [m/s^2], 30 mg: 1 mg/K over 30 K, within five minutes."""
ZEROS = 0.5
"""Largest difference between the zeros of two axes [m/s^2]: 50 mg (BMI160: 40 mg once soldered)."""
NOISE, NOISE_BLOCKS = 0.05, 10.0
"""Prior noise of a block's level [m/s^2], and its weight in blocks.

The noise corresponds to 0.3 m/s of vertical speed gained or lost over a block, as over the crest of
a hill.
"""
DEVIATIONS = 6.0
"""Limit of a change in deviations.

The spread comes from at least 20 blocks including `NOISE_BLOCKS`: 1e-5 by Student's t, and more
because neighbouring blocks are not independent.
"""
AGREEING = 0.5
"""Every block since a change must show at least this share of it.

The change ends once none of the last blocks shows this share.
"""

NO_ROWS: Array = np.zeros((0, 5))
"""Columns of each block: level, mean force (3,) in sensor axes [m/s^2], time [s]."""


class LevelChange(Struct, frozen=True):
    """A change of the force along the vertical: levels before and after it [m/s^2], blocks ago."""

    before: float
    after: float
    blocks: int


class ForceLevel:
    """The level of the force along the vertical, block by block.

    change: the present change, until the level has returned; None without a change.
    """

    def __init__(self) -> None:
        self._rows = NO_ROWS
        self.change: LevelChange | None = None

    def gap(self) -> None:
        """Note a jump of time by an unknown step: blocks before it are not compared with those
        after it.

        A change that was found before stays, because a gap does not end it.
        """
        self._rows = NO_ROWS

    def add(self, p: SignalBlock, up: Array | None) -> None:
        """Take a block; up: the vertical (3,) in sensor axes, of any length; None: not known."""
        if up is None:
            return
        n, *sums = masked_sums(p.force, p.learn & p.ok_force)
        if n < LEAST_TICKS:
            return
        force, direction = [x / n for x in sums], up.tolist()
        along = math.fsum(x * y for x, y in zip(force, direction, strict=True))
        level = along / max(math.sqrt(math.fsum(x * x for x in direction)), 1e-9)
        t = float(p.t[0])
        first = int(self._rows[:, 4].searchsorted(t - (REMEMBERED - 0.5) * BLOCK_S, side="right"))
        self._rows = np.concatenate([self._rows[first:], [[level, *force, t]]])
        if self.change is None:
            self.change = self._found()
        elif self._is_back(self.change):
            self._rows, self.change = self._rows[-AFTER.start :], None

    def _is_back(self, change: LevelChange) -> bool:
        size = change.after - change.before
        shown = (self._rows[-AFTER.start :, 0] - change.before) / size
        if len(shown) < AFTER.start:
            return False
        return float(np.abs(shown).max()) < 1.0 - AGREEING

    def _found(self) -> LevelChange | None:
        level, best = self._rows[:, 0], None
        if level.max() - level.min() < LEAST:  # two means lie no further apart
            return None
        most = DEVIATIONS
        for after in AFTER:
            k = len(level) - after
            if k < LEAST_BEFORE:
                break
            before = float(level[:k].sum()) / k
            since = level[k:] - before
            size = float(since.sum()) / after
            if abs(size) < LEAST or float((since / size).min()) < AGREEING:
                continue
            left = level[:k] - before
            variance = (NOISE_BLOCKS * NOISE**2 + float(left @ left)) / (NOISE_BLOCKS + k)
            deviations = abs(size) / math.sqrt(variance * (1.0 / after + 1.0 / k))
            if deviations > most and abs(size) > LEAST + ZEROS * self._turned(k):
                best, most = LevelChange(before, before + size, after), deviations
        return best

    def _turned(self, k: int) -> float:
        """Return the chord by which the mean force's direction differs from row k on."""
        sums = self._rows[:k, 1:4].sum(axis=0), self._rows[k:, 1:4].sum(axis=0)
        before, after = (x / max(math.sqrt(float(x @ x)), 1e-9) for x in sums)
        return math.sqrt(float((after - before) @ (after - before)))
