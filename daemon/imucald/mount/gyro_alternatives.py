"""The gyroscope's axes and signs against the accelerometer's.

With the mount R known the vertical's level parts t = f / g, motion taken off, follow from the
rates, dt_x = -q + r t_y and dt_y = p - r t_x; the motion holds r too. If a sign or two axes of
either sensor are wrong the rates that fit are S w, with S a signed permutation: so the slopes of
any road show it within a minute or two.
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
"""Least noise of the level parts [rad]: smaller values count as noise."""
LEAST_ENERGY = BLOCK_TICKS * TILT_FLOOR**2
AROUND = 5
"""Means are over so many ticks to both sides: a second."""
WEIGHT = 1.0 / (2 * AROUND + 1)


def _signed_permutations() -> Array:
    """The identity, then all ways to exchange two axes, to turn one sign, or all (14, 3, 3)."""
    eye = np.eye(3)
    some = [eye[[1, 0, 2]], eye[[0, 2, 1]], eye[[2, 1, 0]]]
    some += [eye - 2.0 * np.outer(axis, axis) for axis in eye]
    return np.array([eye, *some, *(-S for S in some), -eye])


TRIED = _signed_permutations()
HALF = len(TRIED) // 2
"""The second half are the first with all signs turned: the identity's is the last."""

MOST_OF_LATE = TO_ACCUSE / 3.0
"""No block counts for more of what begins in mid-drive: four have to say so, as three come
to the limit and not beyond it."""
LEAST_TURN = 0.02
"""A block in which no axis has turned by so much [rad] says nothing of signs."""


class GyroAlternatives:
    """The evidence against each signed permutation of the gyroscope's axes, summed over blocks.

    What begins in mid-drive has all evidence before it against it. So a second sum begins again
    wherever it speaks for the axes as they are (Page's test; Basseville and Nikiforov, Detection of
    Abrupt Changes, 1993, ch. 2.2: e^h blocks to a false alarm, if blocks are independent).
    """

    def __init__(self) -> None:
        self._sums = np.zeros(len(TRIED) - 1)
        self._late = np.zeros(len(TRIED) - 1)
        self.blocks = 0

    def forget(self) -> None:
        """Begin again."""
        self._sums[:] = self._late[:] = 0.0
        self.blocks = 0

    def add(self, ratios: Array) -> None:
        """Take the log ratios (13,) of a block (`gyro_ratios`)."""
        self._sums = _held(self._sums + _held(ratios, -MOST, MOST), -HELD, HELD)
        self.blocks += 1

    def add_late(self, ratios: Array) -> None:
        """Take the log ratios of a block for faults that begin in mid-drive."""
        held = _held(ratios, -MOST_OF_LATE, MOST_OF_LATE)
        self._late = _held(self._late + held, -HELD, 0.0)

    def is_seen(self, least: float) -> bool:
        """Whether all are ruled out so far, or were looked for long enough in vain."""
        return is_seen(float(self._sums.min()), self.blocks, least)

    def share(self, least: float) -> float:
        """How much of what `is_seen` asks for is there, 0 to 1."""
        return share_seen(float(self._sums.min()), self.blocks, least)

    @property
    def is_accused(self) -> bool:
        """Whether one of them is much the better one."""
        return float(np.minimum(self._sums, self._late).min()) < -TO_ACCUSE


def gyro_ratios(
    ahead: Array, across: Array, rate: Array, speed: Array, R: Matrix3, gain: float = 1.0
) -> Array:
    """Log likelihood ratios (13,) of a block against each alternative.

    ahead, across: level parts of the force over g (N,), dv/dt taken off, v r still in it; rate:
    (N, 3) [rad/s] sensor axes; speed: (N,) [m/s]; gain: of v r.
    """
    return ratios_of(gyro_energies(ahead, across, rate, speed, R, gain))


def ratios_of(left: Array) -> Array:
    """Log likelihood ratios (13,) from the energies (14, 2) that are left over."""
    ratios: Array = (0.5 * INDEPENDENT * np.log(left[1:] / left[0])).sum(axis=1)
    return ratios


def gyro_energies(
    ahead: Array, across: Array, rate: Array, speed: Array, R: Matrix3, gain: float = 1.0
) -> Array:
    """Energies (14, 2) that each alternative leaves of the level parts of the vertical [rad^2].

    Rates with all signs turned make the opposite changes, so those of one half are enough.
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
    """Means over a second of (k, N), the ends carried on."""
    longer = np.concatenate([x[:, :1]] * AROUND + [x] + [x[:, -1:]] * AROUND, axis=1)
    n = x.shape[1]
    out = longer[:, :n].copy()
    for k in range(1, 2 * AROUND + 1):
        out += longer[:, k : k + n]
    out *= WEIGHT
    return out


def _held(x: Array, low: float, high: float) -> Array:
    """As numpy.clip, which takes three times as long for so few."""
    out: Array = np.minimum(np.maximum(x, low), high)
    return out
