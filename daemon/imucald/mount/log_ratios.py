"""Log likelihood ratio of two hypotheses about a sign, summed block by block.

For each block, the residual energies E_k and E_0 of the two hypotheses are compared:

    log L_0 - log L_k = (n / 2) log(E_k / E_0),

This logarithm is the log likelihood ratio of normal variables with unknown spread (profile
likelihood; Davison, Statistical Models, 2003, ch. 4.5). n is the number of independent values in
the block. The ratio of one block is limited to `MOST`, so that a single unusual block cannot decide
the test.
"""

from __future__ import annotations

import math

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.mount.block_sums import pair_sums
from imucald.mount.signal_blocks import BLOCK_TICKS

TO_BE_GOOD = -math.log(1e-2)
"""Log ratio that rules out a wrong sign for a *good* mount.

One installation in a hundred may have some wrong sign, and there are 16 kinds of wrong sign. After
a ratio of 100 against each kind, the odds of any wrong sign are below 1 in 10,000.
"""
TO_BE_FINE = -math.log(1e-4)
TO_ACCUSE = -2.0 * math.log(1e-4)
"""Log ratio at which a wrong sign is reported. It is larger than `TO_BE_FINE`, because neighbouring
blocks are not fully independent."""
MOST, HELD = 3.0, 40.0
"""Limits of the log ratio of one block and of a sum. With these limits, later blocks can still
reverse an earlier result."""
INDEPENDENT = 5.0
"""Number of independent values of a signal in a block: slopes and motion are correlated for about a
second."""
LEAST_TICKS = 60
"""Smallest number of usable ticks of a block that counts."""
ENOUGH = 60
"""Number of blocks (6 min of driving) after which the mount no longer waits for a clear result of
the test.
"""


def is_seen(ratio: float, blocks: int, least: float) -> bool:
    """True if a log ratio rules out an alternative, or if a long test found no evidence for it."""
    return ratio > least or (blocks > ENOUGH and ratio > -TO_BE_GOOD)


def share_seen(ratio: float, blocks: int, least: float) -> float:
    """Return the collected share (0 to 1) of the evidence that `is_seen` needs."""
    if is_seen(ratio, blocks, least):
        return 1.0
    waited = blocks / (ENOUGH + 1) if ratio > -TO_BE_GOOD else 0.0
    return min(max(ratio / least, waited, 0.0), 1.0)


class Mirrored:
    """Test whether two signals of the same motion have equal or opposite signs."""

    def __init__(self, floor: float, independent: float = INDEPENDENT) -> None:
        self._floor = BLOCK_TICKS * floor * floor
        self._independent = independent
        self.sum = 0.0
        self.blocks = 0

    def forget(self) -> None:
        """Begin again."""
        self.sum, self.blocks = 0.0, 0

    def add_signals(self, x: Array, y: Array, use: Flags) -> None:
        """Process the two signals (N,) of a block."""
        if np.count_nonzero(use) < LEAST_TICKS:
            return
        sums = pair_sums(x, y, use).centred()
        both, cross = sums.xx + sums.yy + self._floor, 2.0 * sums.xy
        ratio = 0.5 * self._independent * math.log((both + cross) / (both - cross))
        self.sum = min(max(self.sum + min(max(ratio, -MOST), MOST), -HELD), HELD)
        self.blocks += 1

    def is_seen(self, least: float) -> bool:
        """True if the signs are equal: the opposite sign is ruled out, or a long test found no
        evidence for it.
        """
        return is_seen(self.sum, self.blocks, least)

    def share(self, least: float) -> float:
        """Return the collected share (0 to 1) of the evidence that `is_seen` needs."""
        return share_seen(self.sum, self.blocks, least)

    @property
    def is_opposite(self) -> bool:
        """True if the opposite sign is much more likely."""
        return self.sum < -TO_BE_GOOD
