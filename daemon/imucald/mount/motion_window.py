"""The last ticks of force and motion, as one window for the frequency domain.

Each block pushes the oldest one out, so windows overlap (Welch, IEEE Trans. Audio Electroacoust.
15, 1967). Ticks that may not be learnt from are masked.
"""

from __future__ import annotations

import numpy as np

from imucald.core import compiled
from imucald.core.arrays import Array
from imucald.mount.evidence_spectra import (
    MEASURED,
    RATE,
    SPEED_RATE,
    WINDOW,
    Measured,
    Spectra,
    spectra,
)
from imucald.mount.gravity_observer import GravityObserver
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock

MIN_POWER = 1e-3
"""A window with less squared motion per tick [(m/s^2)^2] shows nothing."""
LEAST_TICKS = BLOCK_TICKS
"""Nor does one with fewer ticks to learn from."""
_TAKEN = [
    Measured.DVDT_2,
    Measured.LATERAL_2,
    Measured.YAW_2,
    Measured.DVDT_ABS,
    Measured.DVDT_LATERAL,
    Measured.DVDT_REMAINING,
    Measured.LATERAL_REMAINING,
]
"""Terms that are not taken off the force before the vertical follows it."""


class MotionWindow:
    """Columns of `Measured` for the last `WINDOW` ticks."""

    def __init__(self) -> None:
        self._values = np.zeros((WINDOW, MEASURED))
        self._mask = np.zeros(WINDOW, dtype=bool)

    def restart(self) -> None:
        """Time jumped."""
        self._values[:] = 0.0
        self._mask[:] = False

    def add(
        self, p: SignalBlock, lone: Array, turn: Array, yaw_rate: Array, vertical: GravityObserver
    ) -> None:
        """Take a block.

        lone: (N, 3) its force without gravity [m/s^2], sensor axes; turn: (N,) v r [m/s^2];
        yaw_rate: (N,) r [rad/s]; vertical: it has carried the vertical through the block.
        """
        w, m, new = self._values, self._mask, slice(-BLOCK_TICKS, None)
        learn = p.learn & p.ok_speed & (not vertical.seeking)
        if compiled.kernels is not None:
            flags = compiled.kernels.push_window(
                w, m, lone, p.accel, turn, yaw_rate, p.speed, p.rate, p.ok_rate, learn,
                vertical.use, vertical.pull, vertical.taken,
            )  # fmt: skip
            if flags:
                compiled.note(flags)
            return
        w[:-BLOCK_TICKS] = w[BLOCK_TICKS:].copy()
        m[:-BLOCK_TICKS] = m[BLOCK_TICKS:].copy()
        a, r, rate = p.accel, yaw_rate, p.rate * p.ok_rate[:, None]
        w[new, :3] = lone
        w[new, Measured.DVDT] = a
        w[new, Measured.LATERAL] = turn
        w[new, SPEED_RATE] = rate * p.speed[:, None]
        w[new, RATE] = rate
        terms = np.empty((BLOCK_TICKS, len(_TAKEN)))
        for k, term in enumerate((a * a, turn * turn, r * r, a * np.abs(a), a * turn, a, turn)):
            terms[:, k] = term
        w[new, _TAKEN] = vertical.remaining(terms)
        w[new, Measured.DVDT_YAW] = a * r
        w[new, Measured.LATERAL_YAW] = turn * r
        m[new] = learn

    def spectra(self, keep_mean: bool, needs_motion: bool) -> Spectra | None:
        """Spectra (BINS, MEASURED) of the window; None where it shows nothing.

        keep_mean: the means of the columns count as well. needs_motion: without motion by the
        speed it shows nothing.
        """
        if np.count_nonzero(self._mask) < LEAST_TICKS:
            return None
        s = spectra(self._values, self._mask, keep_mean=keep_mean)
        motion = s[:, 3:5]
        is_still = needs_motion and np.vdot(motion, motion).real < MIN_POWER * BLOCK_TICKS
        return None if is_still else s
