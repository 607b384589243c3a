"""Log likelihood ratios of hypotheses about signs, summed block by block.

For each block, the residual energies E_k and E_0 of the two hypotheses are compared:

    log L_0 - log L_k = (n / 2) log(E_k / E_0),

This logarithm is the log likelihood ratio of normal variables with unknown spread (profile
likelihood; Davison, Statistical Models, 2003, ch. 4.5). n is the number of independent values in
the block. The ratio of one block is limited to `MOST`, so that a single unusual block cannot decide
the test.

The axes and signs of a gyroscope are compared with those of the accelerometer. With a known mount
R, the rates (p, q, r) predict the changes of the level components t = f / g of the vertical:
dt_x = -q + r t_y and dt_y = p - r t_x. The motion is subtracted from f, and v r (speed times yaw
rate) in the motion also depends on r. If a sign is wrong, or two axes of a sensor are exchanged,
the rates S w fit instead of the measured rates w, with a signed permutation S. On any road, slopes
show the right S within one or two minutes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
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
MOST_OF_LATE = TO_ACCUSE / 3.0
"""Largest evidence of one block for a fault that begins in the middle of a drive.

Four blocks are needed, because three blocks reach the limit but do not exceed it.
"""
INDEPENDENT = 5.0
"""Number of independent values of a signal in a block: slopes and motion are correlated for about a
second."""
LEAST_TICKS = 60
"""Smallest number of usable ticks of a block that counts."""
ENOUGH = 60
"""Number of blocks (6 min of driving) after which the mount no longer waits for a clear result of
the test.
"""
TILT_FLOOR = 0.003
"""Smallest assumed noise of the level components t [rad]."""
AROUND = 5
"""Number of ticks before and after a tick over which the means are taken: a second in total."""


def _signed_permutations() -> Array:
    """Return the identity, and then all matrices that exchange two axes, invert one sign, or invert
    all signs of one of these matrices (14, 3, 3).
    """
    eye = np.eye(3)
    some = [eye[[1, 0, 2]], eye[[0, 2, 1]], eye[[2, 1, 0]]]
    some += [eye - 2.0 * np.outer(axis, axis) for axis in eye]
    return np.array([eye, *some, *(-S for S in some), -eye])


TRIED = _signed_permutations()
HALF = len(TRIED) // 2
"""Half of the number of alternatives. The second half of `TRIED` is the first half with all signs
inverted. The last matrix of `TRIED` is the inverted identity.
"""


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


class LogRatios:
    """Log ratios of the configuration against each of several alternatives, summed over blocks.

    Before a fault that begins in the middle of a drive, all evidence is for the configuration. A
    second sum therefore restarts at zero whenever it favours the configuration (Page's test;
    Basseville and Nikiforov, Detection of Abrupt Changes, 1993, ch. 2.2). With a threshold h and
    independent blocks, a false alarm occurs once in e^h blocks.
    """

    def __init__(self, alternatives: int = 1) -> None:
        self._sums, self._late = np.zeros((2, alternatives))
        self.blocks = 0

    @property
    def sum(self) -> float:
        """Smallest of the sums: the sum of the alternative that fits best."""
        return float(self._sums.min())

    def forget(self) -> None:
        """Begin again."""
        self._sums[:] = self._late[:] = 0.0
        self.blocks = 0

    def add_ratios(self, ratios: Array) -> None:
        """Add the log ratios (k,) of a block."""
        self._sums = _held(self._sums + _held(ratios, -MOST, MOST), -HELD, HELD)
        late = _held(ratios, -MOST_OF_LATE, MOST_OF_LATE)
        self._late = _held(self._late + late, -HELD, 0.0)
        self.blocks += 1

    def is_seen(self, least: float) -> bool:
        """True if all alternatives are ruled out, or if a long test found no evidence for any of
        them.
        """
        return self.sum > least or (self.blocks > ENOUGH and self.sum > -TO_BE_GOOD)

    def share(self, least: float) -> float:
        """Return the collected share (0 to 1) of the evidence that `is_seen` needs."""
        waited = self.blocks / (ENOUGH + 1) if self.sum > -TO_BE_GOOD else 0.0
        return min(max(self.sum / least, waited, 0.0), 1.0)

    @property
    def is_accused(self) -> bool:
        """True if an alternative fits much better than the configuration, now or in the whole
        drive.
        """
        return float(np.minimum(self._sums, self._late).min()) < -TO_ACCUSE


class Mirrored(LogRatios):
    """Test whether two signals of the same motion have equal or opposite signs.

    floor: smallest assumed noise of the signals. independent: number of independent values of a
    block.
    """

    def __init__(self, floor: float, independent: float = INDEPENDENT) -> None:
        super().__init__()
        self._floor = BLOCK_TICKS * floor * floor
        self._independent = independent

    def add_signals(self, x: Array, y: Array, use: Flags) -> None:
        """Process the two signals (N,) of a block."""
        if np.count_nonzero(use) < LEAST_TICKS:
            return
        sums = pair_sums(x, y, use).centred()
        both, cross = sums.xx + sums.yy + self._floor, 2.0 * sums.xy
        self.add_ratios(0.5 * self._independent * np.log([(both + cross) / (both - cross)]))


def ratios_of(left: Array) -> Array:
    """Return the log likelihood ratios (13,) of the configured axes against each alternative, from
    the residual energies (14, 2)."""
    ratios: Array = (0.5 * INDEPENDENT * np.log(left[1:] / left[0])).sum(axis=1)
    return ratios


def gyro_energies(
    ahead: Array, across: Array, rate: Array, speed: Array, R: Matrix3, gain: float = 1.0
) -> Array:
    """Return the residual energies (14, 2) of the level components of the vertical for each
    alternative [rad^2].

    ahead, across: level components of the force divided by g (N,); dv/dt is subtracted, v r (speed
    times yaw rate) is not. rate: (N, 3) in sensor axes [rad/s]. speed: (N,) [m/s]. gain: gain of
    v r.

    Inverting the signs of all rates inverts the predicted changes. The changes are therefore
    computed for one half of the alternatives only.
    """
    turned = np.matmul(R, TRIED[:HALF])  # exact: each is a permutation
    x, y, z = rate.T
    rates = turned[:, :, 0, None] * x + turned[:, :, 1, None] * y  # (7, 3, N)
    rates += turned[:, :, 2, None] * z
    turning = rates[:, 2]
    aside = (gain / GRAVITY) * speed * turning
    smooth = _smoothed(np.array([ahead, across - aside[0]]))
    change = np.empty((HALF, 2, len(ahead)))
    np.subtract(turning * smooth[1], rates[:, 1], out=change[:, 0])
    np.subtract(rates[:, 0], turning * smooth[0], out=change[:, 1])
    moved = np.add.accumulate(change, axis=2)
    moved *= TICK_S
    left = np.empty((2 * HALF, 2, len(ahead)))
    np.subtract(ahead, moved[:, 0], out=left[:HALF, 0])
    np.subtract(across - aside, moved[:, 1], out=left[:HALF, 1])
    opposite = left[HALF:]
    opposite[:-1], opposite[-1] = moved[1:], moved[0]
    opposite[:, 0] += ahead
    opposite[:-1, 1] += across + aside[1:]
    opposite[-1, 1] += across + aside[0]
    left -= left.sum(axis=2, keepdims=True) / len(ahead)
    left *= left
    out: Array = left.sum(axis=2) + BLOCK_TICKS * TILT_FLOOR**2
    return out


def _smoothed(x: Array) -> Array:
    """Return the means of (k, N) over a second, with the end values extended."""
    longer = np.concatenate([x[:, :1]] * AROUND + [x] + [x[:, -1:]] * AROUND, axis=1)
    n = x.shape[1]
    out = longer[:, :n].copy()
    for k in range(1, 2 * AROUND + 1):
        out += longer[:, k : k + n]
    return out / (2 * AROUND + 1)


def _held(x: Array, low: float, high: float) -> Array:
    """Limit values to the range from low to high. `numpy.clip` takes three times as long for so few
    values."""
    return np.asarray(np.minimum(np.maximum(x, low), high))
