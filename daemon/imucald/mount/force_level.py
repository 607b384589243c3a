"""Did the accelerometer's zero or gain change in mid-drive? Gravity's size against its own past.

The mean force of a block along the vertical is g, whatever the road and the driving: what is
horizontal does not show in it, and a vehicle has the same height on average. So its level moves by
the sensor's own errors only. Temperature moves a zero by 1 mg/K and a gain by 0.03 %/K (BMI160
data sheet): slowly. A change from one minute to the next is a fault of the sensor.

That holds while the force holds the vertical. Where no speed says how much of the force is motion,
the gyroscope carries it alone: one that is off by 0.4 deg/s tilts it by 18 deg in 45 s, along which
g is 9.3. Such blocks are left out (`GravityObserver.is_held`).

For each of the last blocks as the time of a change the mean before is held against the mean after,
as in `large_change`. A sensor that is turned shows another mixture of the zeros of its axes, so a
change has to be larger than what that can make of it.

What lies across the vertical shows as a tilt and not here.
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
"""Blocks (384 s): the last 4 to 9 are those since the change, the 51 to 56 others what was before.
Older ones are not held against it, whether or not there were samples since."""
LEAST_BEFORE = 10
"""Blocks that a change is held against (64 s)."""
AFTER = range(4, 10)
"""Blocks since the change that are tried (26 to 58 s)."""
LEAST = 0.3
"""A change is at least that large [m/s^2], 30 mg: 1 mg/K over 30 K, within five minutes."""
ZEROS = 0.5
"""Zeros of two axes differ by up to so much [m/s^2]: 50 mg (BMI160: 40 mg once soldered)."""
NOISE, NOISE_BLOCKS = 0.05, 10.0
"""Level of a block and the drive's own spread [m/s^2], and its weight: 0.3 m/s of height that is
gained or lost from its beginning to its end, as over the crest of a hill."""
DEVIATIONS = 6.0
"""The spread comes from 20 blocks at least, `NOISE_BLOCKS` among them: 1e-5 by Student's t, and
more as blocks next to one another are not independent."""
AGREEING = 0.5
"""Every block since a change shows at least that share of it; the level is back where it was once
no block of the last ones does."""

NO_ROWS: Array = np.zeros((0, 5))
"""Of each block: level, mean force (3,) in sensor axes [m/s^2], time [s]."""


class LevelChange(Struct, frozen=True):
    """A change of the force along the vertical: levels before and after it [m/s^2], blocks ago."""

    before: float
    after: float
    blocks: int


class ForceLevel:
    """The level of the force along the vertical, block by block.

    change: what stands, until the level is back; None while it is what it was.
    """

    def __init__(self) -> None:
        self._rows = NO_ROWS
        self.change: LevelChange | None = None

    def gap(self) -> None:
        """Time jumped by an unknown step: blocks before it are not compared with those after it.

        A change that was found before stays, as a gap does not end it.
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
        """The chord by which the mean force's direction differs from row k on."""
        sums = self._rows[:k, 1:4].sum(axis=0), self._rows[k:, 1:4].sum(axis=0)
        before, after = (x / max(math.sqrt(float(x @ x)), 1e-9) for x in sums)
        return math.sqrt(float((after - before) @ (after - before)))
