"""Compute the vertical in body axes. The vertical is integrated from the gyroscope's rates and
corrected slowly towards the accelerometer.

    du/dt = -w x u + (p - u) / T      p: (force minus motion) / g

u: vertical. w: rate of the gyroscope. T: time constant of the correction. In axes that do not
rotate with the body, this equation is a first-order low-pass filter. A whole block is therefore
computed at once. A prefix product gives the rotations, and a cumulative sum gives the output of the
filter.
"""

from __future__ import annotations

import numpy as np

from imucald.core.arrays import Array, Flags
from imucald.core.rotations import rows_from_quaternion
from imucald.motion.ticks import TICK_S

PULL_S = 30.0
"""Time constant of the correction towards the accelerometer [s]."""
FIRST_PULL_S = 3.0
"""Time constant of the correction at the start [s].

After the start, the time constant grows with the duration of the integration.
"""
VERTICAL_WALK = 1e-3
"""Random walk of a vertical that is integrated from a gyroscope [rad/sqrt(s)]. The value includes
the noise and the gain error of the gyroscope.
"""
FIRST_TICKS = 64
"""Number of ticks for the first vertical. The first vertical is the mean of the accelerometer over
these ticks.
"""


class CarriedVertical:
    """Integrates the vertical from block to block.

    up: (3,) present vertical; None before any block. pull_s: time constant of the correction
    towards the accelerometer [s]. The object also keeps the sensitivity of the vertical to
    cross-talk of the gyroscope (3, 3), and the time since the start.
    """

    def __init__(self, pull_s: float = PULL_S) -> None:
        self._pull_s = pull_s
        self.restart()

    def restart(self) -> None:
        """Forget the vertical, because time jumped or the rotation was not known."""
        self.up: Array | None = None
        self._tilts = np.zeros((3, 3))
        self._ticks = 0

    def block(self, rate: Array, pull: Array, use: Flags) -> tuple[Array, Array]:
        """Return the vertical (N, 3) and its sensitivities (N, 3, 3) over one block.

        rate: (N, 3) [rad/s]. pull: (N, 3) (force minus motion) / g. `rate` and `pull` are in body
        axes. use: (N,) flags of the ticks whose `pull` is used. The sensitivities are d u / d
        (e_xz, e_yz, g_z). e_xz and e_yz are the cross-talk of the rate from z to x and to y. g_z is
        a rotation of the gyroscope about z relative to the accelerometer [rad].
        """
        n = len(rate)
        if self.up is None:
            first = pull[:FIRST_TICKS][use[:FIRST_TICKS]]
            self.up = first.mean(axis=0) if len(first) else np.array([0.0, 0.0, 1.0])
        turns = _matrices(_prefix_products(_small_turns(-rate * TICK_S)))  # block's start -> now
        age = (self._ticks + np.arange(n)) * TICK_S
        gain = use * TICK_S / np.minimum(self._pull_s, FIRST_PULL_S + age)
        kept = np.cumprod(1.0 - gain)
        back = turns.transpose(0, 2, 1)
        pulled = (back @ pull[:, :, None])[:, :, 0]
        drawn = np.cumsum((gain / kept)[:, None] * pulled, axis=0)
        fixed = kept[:, None] * (self.up + drawn)
        up = (turns @ fixed[:, :, None])[:, :, 0]
        tilting = -TICK_S * _wrong_turns(rate, up)
        turned_back = tilting @ turns  # rows: back @ tilting
        grown = np.cumsum(turned_back / kept[:, None, None], axis=0)
        tilts = (kept[:, None, None] * (self._tilts + grown)) @ back
        self.up, self._tilts = up[-1], tilts[-1]
        self._ticks += n
        return up, tilts


def _wrong_turns(rate: Array, up: Array) -> Array:
    """Return the rate of change of the vertical by three errors of the rate (N, 3 sensitivities, 3
    axes).

    The errors are (r, 0, 0), (0, r, 0) and (-q, p, 0).
    """
    (p, q, r), (x, y, z) = rate.T, up.T
    zero = np.zeros(len(rate))
    made = np.stack(
        [zero, -r * z, r * y, r * z, zero, -r * x, p * z, q * z, -q * y - p * x], axis=1
    )
    return made.reshape(-1, 3, 3)


def _small_turns(vectors: Array) -> Array:
    """Return the quaternions (4, N) of rotation vectors (N, 3)."""
    angle = np.sqrt((vectors * vectors).sum(axis=1))
    half = np.sinc(angle / (2.0 * np.pi)) / 2.0  # sin(a/2) / a
    return np.concatenate([np.cos(angle / 2.0)[None], half * vectors.T])


def _matrices(quaternions: Array) -> Array:
    """Return the rotation matrices (N, 3, 3) of quaternions (4, N)."""
    w, x, y, z = quaternions
    return np.stack(rows_from_quaternion((w, x, y, z)), axis=1).reshape(-1, 3, 3)


def _prefix_products(turns: Array) -> Array:
    """Return turns[k] * ... * turns[0] for every k (4, N), in log2(N) steps."""
    made = turns.copy()
    step = 1
    while step < made.shape[1]:
        (a, b, c, d), (w, x, y, z) = made[:, step:], made[:, :-step]
        made[:, step:] = np.stack(
            [
                a * w - b * x - c * y - d * z,
                a * x + b * w + c * z - d * y,
                a * y - b * z + c * w + d * x,
                a * z + b * y - c * x + d * w,
            ]
        )
        step *= 2
    return made
