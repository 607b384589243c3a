"""Log likelihood ratio of two hypotheses about a sign, summed block by block.

For each block, the residual energies of both hypotheses are compared, E_k and E_0:

    log L_0 - log L_k = (n / 2) log(E_k / E_0),

This is the likelihood ratio of normal variables with unknown spread (profile likelihood; Davison,
Statistical Models, 2003, ch. 4.5). n is the number of independent values in the block. One block
counts for at most `MOST`, so that a single unusual block decides nothing.
"""

from __future__ import annotations

import math

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.mount.block_sums import pair_sums
from imucald.mount.signal_blocks import BLOCK_TICKS

TO_BE_GOOD = -math.log(1e-2)
"""One installation in a hundred may have some wrong sign, and there are 16 kinds of wrong sign.

After a ratio of a hundred against each, the odds of any are below one in ten thousand.
"""
TO_BE_FINE = -math.log(1e-4)
TO_ACCUSE = -2.0 * math.log(1e-4)
"""An accusation needs more evidence, as neighbouring blocks are not quite independent."""
MOST, HELD = 3.0, 40.0
"""Limits of one block and of a sum: later blocks can still reverse the result of earlier blocks."""
INDEPENDENT = 5.0
"""Independent values of a signal in a block: slopes and motion are correlated for a second."""
LEAST_TICKS = 60
"""A block with fewer usable ticks does not count."""
ENOUGH = 60
"""Blocks (6 min of driving) after which the mount no longer waits for a clear result of an
alternative.
"""


def is_seen(ratio: float, blocks: int, least: float) -> bool:
    """True if a log ratio excludes an alternative, or a long search found no evidence for it."""
    return ratio > least or (blocks > ENOUGH and ratio > -TO_BE_GOOD)


def share_seen(ratio: float, blocks: int, least: float) -> float:
    """Return the share (0 to 1) of the evidence for `is_seen` that has come."""
    if is_seen(ratio, blocks, least):
        return 1.0
    waited = blocks / (ENOUGH + 1) if ratio > -TO_BE_GOOD else 0.0
    return min(max(ratio / least, waited, 0.0), 1.0)


class Mirrored:
    """Test of whether two signals of the same motion have equal or opposite signs."""

    def __init__(self, floor: float, independent: float = INDEPENDENT) -> None:
        self._floor = BLOCK_TICKS * floor * floor
        self._independent = independent
        self.sum = 0.0
        self.blocks = 0

    def forget(self) -> None:
        """Begin again."""
        self.sum, self.blocks = 0.0, 0

    def add_signals(self, x: Array, y: Array, use: Flags) -> None:
        """Take a block's signals (N,)."""
        if np.count_nonzero(use) < LEAST_TICKS:
            return
        _, xx, xy, yy = pair_sums(x, y, use, centred=True)
        both, cross = xx + yy + self._floor, 2.0 * xy
        ratio = 0.5 * self._independent * math.log((both + cross) / (both - cross))
        self.sum = min(max(self.sum + min(max(ratio, -MOST), MOST), -HELD), HELD)
        self.blocks += 1

    def is_seen(self, least: float) -> bool:
        """True if the hypothesis holds: the opposite is excluded, or a long search found nothing
        for it.
        """
        return is_seen(self.sum, self.blocks, least)

    def share(self, least: float) -> float:
        """Return the share (0 to 1) of the evidence for `is_seen` that has come."""
        return share_seen(self.sum, self.blocks, least)

    @property
    def is_opposite(self) -> bool:
        """True if the opposite sign is much more likely."""
        return self.sum < -TO_BE_GOOD
