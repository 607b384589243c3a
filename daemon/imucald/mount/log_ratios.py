"""Two hypotheses of a sign, by the log of their likelihood ratio, counted block by block.

Of a block it counts how much energy both leave over, E_k and E_0:

    log L_0 - log L_k = (n / 2) log(E_k / E_0),

the likelihood ratio of normal variables whose spread is not known (profile likelihood; Davison,
Statistical Models, 2003, ch. 4.5), n being how many of the block's values are independent. No block
counts for more than `MOST`, so that one odd block decides nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.mount.block_sums import pair_sums
from imucald.mount.signal_blocks import BLOCK_TICKS

Flags = NDArray[np.bool_]

TO_BE_GOOD = -math.log(1e-2)
"""One installation in a hundred may have some sign wrong, and there are 16 ways: after a ratio of a
hundred against each the odds of any are below one in ten thousand."""
TO_BE_FINE = -math.log(1e-4)
TO_ACCUSE = -2.0 * math.log(1e-4)
"""An accusation needs more evidence, as neighbouring blocks are not quite independent."""
MOST, HELD = 3.0, 40.0
"""Limits of one block and of a sum: later blocks can still change what earlier ones showed."""
INDEPENDENT = 5.0
"""Independent values of a signal in a block: slopes and motion hang together for a second."""
LEAST_TICKS = 60
"""A block with fewer ticks that may be learnt from is not counted."""
ENOUGH = 60
"""After so many blocks (6 min of driving) that spoke neither way they are not waited for."""


def is_seen(ratio: float, blocks: int, least: float) -> bool:
    """Whether a log ratio rules an alternative out, or long was not found to speak for it."""
    return ratio > least or (blocks > ENOUGH and ratio > -TO_BE_GOOD)


def share_seen(ratio: float, blocks: int, least: float) -> float:
    """How much of what `is_seen` asks for is there, 0 to 1."""
    if is_seen(ratio, blocks, least):
        return 1.0
    waited = blocks / (ENOUGH + 1) if ratio > -TO_BE_GOOD else 0.0
    return min(max(ratio / least, waited, 0.0), 1.0)


class Mirrored:
    """Two signals that show the same motion, against the same with opposite signs."""

    def __init__(self, floor: float, independent: float = INDEPENDENT) -> None:
        self._floor = BLOCK_TICKS * floor * floor
        self._independent = independent
        self.sum = 0.0
        self.blocks = 0

    def forget(self) -> None:
        """Begin again."""
        self.sum, self.blocks = 0.0, 0

    def add(self, x: Array, y: Array, use: Flags) -> None:
        """Take a block's signals (N,)."""
        if np.count_nonzero(use) < LEAST_TICKS:
            return
        _, xx, xy, yy = pair_sums(x, y, use, centred=True)
        both, cross = xx + yy + self._floor, 2.0 * xy
        ratio = 0.5 * self._independent * math.log((both + cross) / (both - cross))
        self.sum = min(max(self.sum + min(max(ratio, -MOST), MOST), -HELD), HELD)
        self.blocks += 1

    def is_seen(self, least: float) -> bool:
        """Whether the hypothesis holds: the opposite is excluded, or long was not found."""
        return is_seen(self.sum, self.blocks, least)

    def share(self, least: float) -> float:
        """How much of what `is_seen` asks for is there, 0 to 1."""
        return share_seen(self.sum, self.blocks, least)

    @property
    def is_opposite(self) -> bool:
        """Whether the opposite is much the better one."""
        return self.sum < -TO_BE_GOOD
