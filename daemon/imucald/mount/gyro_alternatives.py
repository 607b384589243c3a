"""Compare the axes and signs of the gyroscope with those of the accelerometer.

With the mount R known, the rates predict the level parts t = f / g of the vertical, without the
motion: dt_x = -q + r t_y and dt_y = p - r t_x. The motion contains r too. If a sign is wrong, or
two axes of either sensor are exchanged, the rates that fit are S w, with S a signed permutation.
The slopes of any road show this within a minute or two.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.log_ratios import (
    HELD,
    INDEPENDENT,
    MOST,
    TO_ACCUSE,
    is_seen,
    share_seen,
)
from imucald.mount.signal_blocks import BLOCK_TICKS

TILT_FLOOR = 0.003
"""Smallest assumed noise of the level parts [rad]."""
LEAST_ENERGY = BLOCK_TICKS * TILT_FLOOR**2
AROUND = 5
"""Means cover this many ticks on both sides: a second."""
WEIGHT = 1.0 / (2 * AROUND + 1)


def _signed_permutations() -> Array:
    """Return the identity, then all ways to exchange two axes, to turn one sign, or to turn all
    signs (14, 3, 3).
    """
    eye = np.eye(3)
    some = [eye[[1, 0, 2]], eye[[0, 2, 1]], eye[[2, 1, 0]]]
    some += [eye - 2.0 * np.outer(axis, axis) for axis in eye]
    return np.array([eye, *some, *(-S for S in some), -eye])


TRIED = _signed_permutations()
HALF = len(TRIED) // 2
"""The second half of `TRIED` is the first half with all signs turned: the last one belongs to the
identity.
"""

MOST_OF_LATE = TO_ACCUSE / 3.0
"""Largest evidence of one block for a fault that begins in mid-drive.

Four blocks are needed, because three reach the limit but do not exceed it.
"""
LEAST_TURN = 0.02
"""A block in which no axis has turned by this angle [rad] is not used for signs."""


class GyroAlternatives:
    """The evidence against each signed permutation of the gyroscope's axes, summed over blocks.

    All earlier evidence speaks against a fault that begins in mid-drive. A second sum therefore
    restarts at zero whenever it favours the configured axes (Page's test; Basseville and Nikiforov,
    Detection of Abrupt Changes, 1993, ch. 2.2: e^h blocks to a false alarm, if blocks are
    independent).
    """

    def __init__(self) -> None:
        self._sums = np.zeros(len(TRIED) - 1)
        self._late = np.zeros(len(TRIED) - 1)
        self.blocks = 0

    def forget(self) -> None:
        """Begin again."""
        self._sums[:] = self._late[:] = 0.0
        self.blocks = 0

    def add_ratios(self, ratios: Array) -> None:
        """Take the log ratios (13,) of a block (`gyro_ratios`)."""
        self._sums = _held(self._sums + _held(ratios, -MOST, MOST), -HELD, HELD)
        self.blocks += 1

    def add_late(self, ratios: Array) -> None:
        """Take the log ratios of a block for faults that begin in mid-drive."""
        held = _held(ratios, -MOST_OF_LATE, MOST_OF_LATE)
        self._late = _held(self._late + held, -HELD, 0.0)

    def is_seen(self, least: float) -> bool:
        """True if all alternatives are ruled out so far, or were searched long enough without
        result.
        """
        return is_seen(float(self._sums.min()), self.blocks, least)

    def share(self, least: float) -> float:
        """Return the share (0 to 1) of the evidence for `is_seen` that has come."""
        return share_seen(float(self._sums.min()), self.blocks, least)

    @property
    def is_accused(self) -> bool:
        """True if one of the alternatives fits much better."""
        return float(np.minimum(self._sums, self._late).min()) < -TO_ACCUSE


def gyro_ratios(
    ahead: Array, across: Array, rate: Array, speed: Array, R: Matrix3, gain: float = 1.0
) -> Array:
    """Log likelihood ratios (13,) of a block against each alternative.

    ahead, across: level parts of the force over g (N,), without dv/dt but with v r. rate: (N, 3)
    [rad/s] sensor axes. speed: (N,) [m/s]. gain: gain of v r.
    """
    return ratios_of(gyro_energies(ahead, across, rate, speed, R, gain))


def ratios_of(left: Array) -> Array:
    """Return log likelihood ratios (13,) from the residual energies (14, 2)."""
    ratios: Array = (0.5 * INDEPENDENT * np.log(left[1:] / left[0])).sum(axis=1)
    return ratios


def gyro_energies(
    ahead: Array, across: Array, rate: Array, speed: Array, R: Matrix3, gain: float = 1.0
) -> Array:
    """Return the residual energies (14, 2) of the vertical's level parts for each alternative
    [rad^2].

    Rates with all signs turned give the opposite changes, so one half of the alternatives is
    enough.
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
    out: Array = left.sum(axis=2) + LEAST_ENERGY
    return out


def _smoothed(x: Array) -> Array:
    """Return means over a second of (k, N), with the end values extended."""
    longer = np.concatenate([x[:, :1]] * AROUND + [x] + [x[:, -1:]] * AROUND, axis=1)
    n = x.shape[1]
    out = longer[:, :n].copy()
    for k in range(1, 2 * AROUND + 1):
        out += longer[:, k : k + n]
    out *= WEIGHT
    return out


def _held(x: Array, low: float, high: float) -> Array:
    """Limit values as numpy.clip does, which takes three times as long for so few."""
    out: Array = np.minimum(np.maximum(x, low), high)
    return out
