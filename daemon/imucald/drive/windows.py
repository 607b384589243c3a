"""Divide a drive into windows, and compute a Gram matrix for each window and frequency band.

A window consists of four blocks of signals on an even time grid. The columns of a window are the
force minus gravity, and the quantities in the equations that predict this force. All columns are in
body axes. Each column is multiplied by the same taper. The mean and the slope of the column are
removed. Then the column is Fourier transformed. The products of all columns are stored for each
frequency band. Every fit uses only these products.

    y     = f - g u + (0, 0, v q)           u: the integrated vertical
    y_i   = h_i1 dv/dt + h_i2 v r + nuisances
    p, q  = axis of turning times r + nuisances
"""

from __future__ import annotations

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, Flags
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S

Complex = NDArray[np.complex128]

WINDOW = 256
"""Number of ticks of a window: 25.6 s."""
BLOCK = 64
"""Number of ticks between the starts of two windows.

Windows overlap, so each tick counts `OVERLAP` times in a frequency band.
"""
OVERLAP = 1.925
APART = 4
"""Distance of the ticks whose differences give a second derivative: 0.4 s."""
EDGES: Final = (1, 2, 3, 4, 6, 9, 13, 19, 26)
"""Edges of the frequency bands, from 0.04 to 1 Hz. The unit is the width of a Fourier bin, 0.039
Hz.
"""
BANDS = len(EDGES) - 1
BINS = np.arange(EDGES[0], EDGES[-1])
BAND = np.repeat(np.arange(BANDS), np.diff(EDGES))
OMEGA = 2.0 * np.pi * BINS / (WINDOW * TICK_S)
"""Angular frequency of each Fourier bin [rad/s]."""

MAIN = ("dv/dt", "v r")
EXTRA = (
    "-v q", "jerk", "d(v r)/dt", "dp/dt", "dq/dt", "dr/dt", "r^2", "v", "tilted x", "tilted y",
    "dv/dt v r", "(v r)^2", "d(v dv/dt)/dt",
)  # fmt: skip
TURNING = ("p", "q", "r", "v r^2", "d2(v r)/dt2")
TURNED = ("turned x", "turned y")
NAMES = ("y x", "y y", "y z", *MAIN, *EXTRA, *TURNING, *TURNED)
FIRST_X = 3
X = slice(FIRST_X, FIRST_X + len(MAIN) + len(EXTRA))
RATES = slice(X.stop, X.stop + 2)
TURN_COLUMNS = tuple(
    NAMES.index(name) for name in ("r", "d(v r)/dt", "jerk", "dr/dt", "v r^2", "d2(v r)/dt2")
)

_TAPER = np.hanning(WINDOW + 1)[:WINDOW]
_RAMP = np.linspace(-1.0, 1.0, WINDOW)
_PHASE = np.outer(BINS, np.arange(WINDOW)) * (2.0 * np.pi / WINDOW)
_SUMS = np.concatenate([np.ones((1, WINDOW)), _RAMP[None], np.cos(_PHASE), -np.sin(_PHASE)])
"""Matrix that computes linear functions of a window: the sum, the sum of the products with the
ramp, and the Fourier bins that are used.
"""


def columns(
    force: Array, rate: Array, speed: Array, accel: Array, up: Array, tilts: Array
) -> Array:
    """Return the columns (N, len(NAMES)) of the ticks of whole blocks, in body axes.

    force: (N, 3) [m/s^2]. rate: (N, 3) [rad/s]. speed: (N,) [m/s]. accel: (N,) [m/s^2]. up, tilts:
    results of `CarriedVertical.block`.
    """
    p, q, r = rate.T
    lateral = speed * r
    bend = speed * q
    y = force - GRAVITY * up
    y[:, 2] += bend
    return np.column_stack(
        [
            y, accel, lateral, -bend, _slope(accel), _slope(lateral), _slope(p), _slope(q),
            _slope(r), r * r, speed, GRAVITY * tilts[:, 0, 0], GRAVITY * tilts[:, 0, 1],
            accel * lateral, lateral * lateral, _slope(speed * accel), p, q, r, lateral * r,
            _slope_of_slope(lateral),
            GRAVITY * tilts[:, 2, 0], GRAVITY * tilts[:, 2, 1],
        ]
    )  # fmt: skip


def _slope(x: Array) -> Array:
    """Return the slope of each column within each block."""
    x = x.reshape(-1, BLOCK)
    made = np.empty_like(x)
    made[:, 1:-1] = (x[:, 2:] - x[:, :-2]) * (0.5 / TICK_S)
    made[:, 0] = (x[:, 1] - x[:, 0]) / TICK_S
    made[:, -1] = (x[:, -1] - x[:, -2]) / TICK_S
    return made.ravel()


def _slope_of_slope(x: Array) -> Array:
    """Return the second derivative of each column within each block, as a mean over `APART` ticks.

    Differences of neighbouring ticks would be mostly noise. A mean over 0.8 s follows a body, whose
    roll frequency is below 2 Hz.
    """
    x = x.reshape(-1, BLOCK)
    made = np.empty_like(x)
    made[:, APART:-APART] = x[:, 2 * APART :] - 2.0 * x[:, APART:-APART] + x[:, : -2 * APART]
    made[:, :APART], made[:, -APART:] = made[:, APART, None], made[:, -APART - 1, None]
    made /= (APART * TICK_S) ** 2
    return made.ravel()


def mean_by_power(values: Array, window: Array) -> Array:
    """Return the means (...,) of values (..., WINDOW) of ticks, weighted by the power of dv/dt.
    window: (..., WINDOW, columns).
    """
    power = np.square(_TAPER * window[..., NAMES.index("dv/dt")])
    return np.asarray((power * values).sum(axis=-1) / np.maximum(power.sum(axis=-1), 1e-12))


def spectra(window: Array, use: Flags) -> Complex:
    """Return the spectra (..., bins, columns) of windows (..., WINDOW, columns).

    Unusable ticks have weight zero. The same linear map is applied to all columns, so the equations
    between the columns are also valid for the spectra.
    """
    weight = _TAPER * use
    ramp = np.broadcast_to(_RAMP[:, None], (*use.shape, 1))
    both = np.concatenate([window, np.ones_like(ramp), ramp], axis=-1)
    sums = _SUMS @ (weight[..., None] * both)
    level, sloped, left = sums[..., 0, :], sums[..., 1, :], sums[..., 2:, :]
    total = level[..., -2, None]
    centre = sloped[..., -2, None] / total
    tilt = (sloped - centre * level) / (sloped[..., -1, None] - centre * sloped[..., -2, None])
    left = left - left[..., -2, None] * (level / total)[..., None, :]
    left = left[..., :-2] - left[..., -1, None] * tilt[..., None, :-2]
    half = len(BINS)
    made: Complex = left[..., :half, :] + 1j * left[..., half:, :]
    return made


def products(spectrum: Complex) -> Array:
    """Return the products of all columns for each band (..., BANDS, columns, columns)."""
    *before, _, columns = spectrum.shape
    made = np.empty((*before, BANDS, columns, columns))
    for band, (first, stop) in enumerate(pairwise(EDGES)):
        part = spectrum[..., first - EDGES[0] : stop - EDGES[0], :]
        both = np.concatenate([part.real, part.imag], axis=-2)
        made[..., band, :, :] = both.swapaxes(-1, -2) @ both
    return made
