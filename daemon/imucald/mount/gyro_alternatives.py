"""Compare the axes and signs of the gyroscope with those of the accelerometer.

With a known mount R, the rates (p, q, r) predict the changes of the level components t = f / g of
the vertical: dt_x = -q + r t_y and dt_y = p - r t_x. The motion is subtracted from f, and v r
(speed times yaw rate) in the motion also depends on r. If a sign is wrong, or two axes of a sensor
are exchanged, the rates S w fit instead of the measured rates w, with a signed permutation S. On
any road, slopes show the right S within one or two minutes.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.log_ratios import INDEPENDENT
from imucald.mount.signal_blocks import BLOCK_TICKS

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
