"""Windows of even signals in the frequency domain, and their products band by band.

Windows of 25.6 s with a Hann taper, a quarter apart, go to the frequency domain. Kept of each are
the real cross products of all signals per band, after the signals' delays were taken out as
phases: what a least-squares fit of the force on dv/dt, v r and the small terms needs, whatever
the rotation, the gains and the noise of each band turn out to be.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import BLOCK_TICKS

Array = NDArray[np.float64]
Spectra = NDArray[np.complex128]

WINDOW = 256
"""Ticks per window; with BLOCK_TICKS = 64 a quarter of it."""
FIRST_BIN = 0
BAND_EDGES = (0, 1, 2, 3, 4, 6, 9, 13, 19, 28, 52)
"""Bins of 0.039 Hz; the last ends at 2 Hz, above which dv/dt says nothing."""
BINS = BAND_EDGES[-1] - FIRST_BIN
BANDS = len(BAND_EDGES) - 1

A, V = 3, 4
"""Columns: dv/dt and v r, after the force (0-2)."""
TURNED = slice(5, 8)
"""Speed times rate [m/s^2], sensor axes."""
RATE = slice(8, 11)
"""Rate [rad/s], sensor axes."""
A2, V2, R2, AR, VR, AA, AV = 11, 12, 13, 14, 15, 16, 17
"""Second-order terms: A^2, V^2, r^2, A r, V r, A |A|, A V."""
AH, VH = 18, 19
"""A and V less what the tracked vertical takes up of them; see `gravity_observer`."""
MEASURED = 20
"""Columns that come from time; two more are their quarter turns in frequency."""
AI, VI = 20, 21
"""A and V a quarter period ahead: lags, tyres and lever arms answer with these."""
SIGNALS = 22
_LATE = (A, A2, AR, AA, AV, AH)
"""Columns that come with the speed's delay."""

FX, FY, FZ, FA, FV, FQ, P, Q, R, FA2, FV2, FR2, FAR, FVR, FAI, FVI, FAA, FAV, FAH, FVH = range(20)
"""Order of signals after `in_vehicle_axes`: force (3), A, V, v q, rate (3), even terms."""

_TAPER = np.hanning(WINDOW + 1)[:WINDOW]
_TAPER_SCALE = float(np.sqrt(2.0 / WINDOW / ((_TAPER**2).sum() / BLOCK_TICKS)))
_HALF = math.sqrt(0.5)
_TAPER_COLUMN = (_TAPER_SCALE * _TAPER)[:, None]
_STARTS = np.array(BAND_EDGES[:-1]) - FIRST_BIN
BAND_WIDTH = np.diff(BAND_EDGES).astype(float)
"""Bins per band."""
OMEGA = 2.0 * np.pi * np.arange(FIRST_BIN, FIRST_BIN + BINS) / (WINDOW * TICK_S)
"""Angular frequency of the bins [rad/s]."""
BAND_OMEGA2 = np.add.reduceat(OMEGA**2, _STARTS) / BAND_WIDTH
"""Mean square angular frequency of the bands [(rad/s)^2]."""


def spectra(signals: Array, mask: NDArray[np.bool_], keep_mean: bool = False) -> Spectra:
    """Spectra (BINS, k) of signals (WINDOW, k), masked ticks taken out.

    Scaled so that overlapping windows add up: the sum over windows and bins of |x|^2 is the sum
    over ticks of x^2 (in band). keep_mean: the mean is a signal as well; else it is taken off.
    """
    if keep_mean:
        x = signals * mask[:, None]
    elif mask.all():
        x = signals - signals.mean(axis=0)
    else:
        n = max(float(mask.sum()), 1.0)
        x = np.where(mask[:, None], signals, 0.0)
        x -= x.sum(axis=0) / n
        x *= mask[:, None]
    x *= _TAPER_COLUMN
    s: Spectra = np.fft.rfft(x, axis=0)[FIRST_BIN : FIRST_BIN + BINS]
    s[0] *= _HALF  # the only bin without a mirror image
    return s


_ALONE = (
    (FA2, A2), (FV2, V2), (FR2, R2), (FAR, AR), (FVR, VR), (FAI, AI), (FVI, VI), (FAA, AA),
    (FAV, AV), (FAH, AH), (FVH, VH),
)  # fmt: skip


def _turning(R_vehicle_from_sensor: Matrix3, without_speed: bool) -> Array:
    """Matrix (20, SIGNALS) that takes the signals to vehicle axes.

    Without speed the force along the vehicle stands in for dv/dt: least squares on it turns the
    x axis into the principal axis of the horizontal force.
    """
    R_vs = R_vehicle_from_sensor
    turn = np.zeros((20, SIGNALS))
    turn[FX : FZ + 1, 0:3] = R_vs
    turn[FV, V] = 1.0
    if without_speed:
        turn[FA, 0:3] = turn[FAH, 0:3] = R_vs[0]
    else:
        turn[FA, A] = 1.0
    turn[FQ, TURNED] = R_vs[1]
    turn[P : R + 1, RATE] = R_vs
    for row, column in _ALONE:
        if not (without_speed and row == FAH):
            turn[row, column] = 1.0
    return turn


PAIRS = (
    (FX, FX), (FY, FY), (FZ, FZ), (FX, FA), (FX, FV), (FX, FR2), (FX, FV2),
    (FY, FV), (FY, FA), (FY, FR2), (FZ, FA), (FZ, FQ), (FZ, FA2), (FZ, FV), (FZ, FV2),
    (FA, FA), (FV, FV), (FA, FV), (FQ, FQ), (FQ, FA), (FQ, FA2), (FA, FR2), (FA, FV2),
    (FA, FA2), (FV, FR2), (FV, FV2), (FR2, FR2), (FR2, FV2), (FV2, FV2), (FA2, FA2),
    (P, P), (Q, Q), (R, R), (P, R), (Q, R), (P, FAR), (Q, FVR), (R, FAR), (R, FVR),
    (FAR, FAR), (FVR, FVR), (P, FV), (R, FV), (FAR, FV),
    (FX, FAI), (FY, FVI), (P, FVI), (Q, FAI), (FAI, FAI), (FVI, FVI), (FVI, FA), (FVI, FR2),
    (FAI, FV), (FAI, FR2), (FAI, FV2), (FVI, R), (FVI, FAR), (FVI, FV), (FAI, R), (FAI, FVR),
    (FY, FAV), (FAV, FAV), (FA, FAV), (FR2, FAV), (FV, FAV), (FVI, FAV),
    (FZ, FAA), (FAA, FAA), (FA, FAA), (FA2, FAA), (FQ, FAA),
    (FY, FAH), (FV, FAH), (FVI, FAH), (FAH, FAH), (FAH, FR2), (FAH, FAV), (FA, FAH),
    (FZ, FAH), (FQ, FAH), (FAH, FA2), (FAH, FAA), (FX, FVH), (FA, FVH), (FAI, FVH), (FVH, FVH),
    (FVH, FR2), (FVH, FV2), (FZ, FVH), (FV, FVH),
)  # fmt: skip
"""Products in vehicle axes that the fit needs."""
PAIR = {pair: i for i, pair in enumerate(PAIRS)} | {(j, i): k for k, (i, j) in enumerate(PAIRS)}
"""Place of a product in the last dimension of `in_vehicle_axes`."""


_LEFT_OF, _RIGHT_OF = np.array(PAIRS).T


def _needed() -> NDArray[np.int64]:
    """Products of signals (as row * SIGNALS + column) from which those in vehicle axes follow."""
    used = np.zeros((SIGNALS, SIGNALS), dtype=bool)
    for without_speed in (False, True):
        turn = _turning(np.ones((3, 3)), without_speed) != 0.0
        used |= (turn[_LEFT_OF].T.astype(int) @ turn[_RIGHT_OF].astype(int)) > 0
    return np.flatnonzero(used)


_NEEDED = _needed()
_NEEDED_LEFT, _NEEDED_RIGHT = _NEEDED // SIGNALS, _NEEDED % SIGNALS
PRODUCTS = len(_NEEDED)
_PLACE = {int(k): i for i, k in enumerate(_NEEDED)}


def _pair_map(R_vehicle_from_sensor: Matrix3, without_speed: bool) -> Array:
    """Matrix (len(PAIRS), PRODUCTS): products in vehicle axes from those of the signals."""
    turn = _turning(R_vehicle_from_sensor, without_speed)
    left = turn[:, _NEEDED_LEFT]
    right = turn[:, _NEEDED_RIGHT]
    out: Array = left[_LEFT_OF] * right[_RIGHT_OF]
    return out


def place(i: int, j: int) -> int:
    """Place of the product of two signals (sensor axes) in `band_products`."""
    return _PLACE[i * SIGNALS + j] if i * SIGNALS + j in _PLACE else _PLACE[j * SIGNALS + i]


def band_products(s: Spectra, tau_speed: float, tau_turn: float) -> Array:
    """Products (BANDS, PRODUCTS) of spectra (BINS, MEASURED), those that are needed.

    tau: lateness of the speed and of the yaw rate against the force [s].
    """
    x = np.empty((BINS, SIGNALS), dtype=np.complex128)
    x[:, :MEASURED] = s
    late = np.exp(1j * OMEGA * tau_speed)
    for column in _LATE:
        x[:, column] *= late
    if tau_turn:
        x[:, V] *= np.exp(1j * OMEGA * tau_turn)
    x[:, AI] = 1j * x[:, A]
    x[:, VI] = 1j * x[:, V]
    both = np.concatenate([x.real, x.imag], axis=1).reshape(BINS * 2, SIGNALS)
    out = np.empty((BANDS, PRODUCTS))
    for k in range(BANDS):
        part = both[2 * (BAND_EDGES[k] - FIRST_BIN) : 2 * (BAND_EDGES[k + 1] - FIRST_BIN)]
        out[k] = (part.T @ part).ravel()[_NEEDED]
    return out


def in_vehicle_axes(
    products: Array, R_vehicle_from_sensor: Matrix3, without_speed: bool = False
) -> Array:
    """Turn products (n, BANDS, PRODUCTS) into vehicle axes: (len(PAIRS), n, BANDS)."""
    matrix = _pair_map(R_vehicle_from_sensor, without_speed)
    n = len(products)
    out: Array = (matrix @ products.reshape(n * BANDS, PRODUCTS).T).reshape(-1, n, BANDS)
    return out
