"""Windows of even signals in the frequency domain, and their products band by band.

Windows of 25.6 s with a Hann taper, a quarter apart, go to the frequency domain. For each window,
the real cross products of all signals per band are kept, after the delays of the signals were
removed as phases. A least-squares fit of the force on dv/dt, v r and the small terms needs only
these products, for any rotation, gains and noise of the bands.
"""

from __future__ import annotations

import enum
import math
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import BLOCK_TICKS

Spectra = NDArray[np.complex128]
Index = NDArray[np.int64]

WINDOW = 256
"""Ticks per window; with BLOCK_TICKS = 64 a quarter of it."""
FIRST_BIN = 0
BAND_EDGES = (0, 1, 2, 3, 4, 6, 9, 13, 19, 28, 52)
"""Band limits in bins of 0.039 Hz. The last band ends at 2 Hz; above it dv/dt says nothing."""
BINS = BAND_EDGES[-1] - FIRST_BIN
BANDS = len(BAND_EDGES) - 1


class Measured(enum.IntEnum):
    """Columns of a window: signals in time, force and rates in sensor axes.

    DVDT is dv/dt and LATERAL is v r, r the yaw rate; the name of a product has both its factors.
    """

    FORCE_X = 0
    FORCE_Y = 1
    FORCE_Z = 2
    DVDT = 3
    LATERAL = 4
    SPEED_RATE_X = 5  # speed times rate [m/s^2]
    SPEED_RATE_Y = 6
    SPEED_RATE_Z = 7
    RATE_X = 8
    RATE_Y = 9
    RATE_Z = 10
    DVDT_2 = 11
    LATERAL_2 = 12
    YAW_2 = 13
    DVDT_YAW = 14
    LATERAL_YAW = 15
    DVDT_ABS = 16  # dv/dt |dv/dt|
    DVDT_LATERAL = 17
    DVDT_REMAINING = 18  # less what the carried vertical takes up of it; see `gravity_observer`
    LATERAL_REMAINING = 19
    DVDT_QUARTER = 20  # a quarter period ahead: lags, tyres and lever arms answer with these
    LATERAL_QUARTER = 21


MEASURED = 20
"""Number of columns computed in time; the two others are their quarter-period shifts in
frequency.
"""
SIGNALS = len(Measured)
SPEED_RATE = slice(Measured.SPEED_RATE_X, Measured.SPEED_RATE_Z + 1)
RATE = slice(Measured.RATE_X, Measured.RATE_Z + 1)
_LATE = (
    Measured.DVDT, Measured.DVDT_2, Measured.DVDT_YAW, Measured.DVDT_ABS, Measured.DVDT_LATERAL,
    Measured.DVDT_REMAINING,
)  # fmt: skip
"""Columns that have the speed's delay."""
_LATE_COLUMNS, _LATERAL_COLUMN = np.array(_LATE), np.array([Measured.LATERAL])
_QUARTERS = (
    (Measured.DVDT_QUARTER, Measured.DVDT),
    (Measured.LATERAL_QUARTER, Measured.LATERAL),
)


class Term(enum.IntEnum):
    """Signals in vehicle axes for the regressions; names as in `Measured`."""

    FORCE_X = 0
    FORCE_Y = 1
    FORCE_Z = 2
    DVDT = 3
    LATERAL = 4
    SPEED_PITCH = 5  # speed times pitch rate
    ROLL_RATE = 6
    PITCH_RATE = 7
    YAW_RATE = 8
    DVDT_2 = 9
    LATERAL_2 = 10
    YAW_2 = 11
    DVDT_YAW = 12
    LATERAL_YAW = 13
    DVDT_QUARTER = 14
    LATERAL_QUARTER = 15
    DVDT_ABS = 16
    DVDT_LATERAL = 17
    DVDT_REMAINING = 18
    LATERAL_REMAINING = 19


_TAPER = np.hanning(WINDOW + 1)[:WINDOW]
_TAPER_SCALE = float(np.sqrt(2.0 / WINDOW / ((_TAPER**2).sum() / BLOCK_TICKS)))
_HALF = math.sqrt(0.5)
_TAPER_COLUMN = (_TAPER_SCALE * _TAPER)[:, None]
_EDGES = np.array(BAND_EDGES) - FIRST_BIN
_STARTS = _EDGES[:-1]
_BAND_ROWS = list(zip((2 * _EDGES[:-1]).tolist(), (2 * _EDGES[1:]).tolist(), strict=True))
BAND_WIDTH = np.diff(BAND_EDGES).astype(float)
"""Bins per band."""
OMEGA = 2.0 * np.pi * np.arange(FIRST_BIN, FIRST_BIN + BINS) / (WINDOW * TICK_S)
"""Angular frequency of the bins [rad/s]."""
BAND_OMEGA2 = np.add.reduceat(OMEGA**2, _STARTS) / BAND_WIDTH
"""Mean square angular frequency of the bands [(rad/s)^2]."""


def spectra(signals: Array, mask: NDArray[np.bool_], keep_mean: bool = False) -> Spectra:
    """Return spectra (BINS, k) of signals (WINDOW, k) without the masked ticks.

    The scale makes overlapping windows add up: the sum over windows and bins of |x|^2 is the sum
    over ticks of x^2 (in band). keep_mean: the mean counts as signal; otherwise it is subtracted.
    """
    x = np.empty_like(signals)
    np.multiply(signals, mask[:, None], out=x)
    if not keep_mean:
        x -= x.sum(axis=0) / max(float(mask.sum()), 1.0)
        x *= mask[:, None]
    x *= _TAPER_COLUMN
    s: Spectra = np.fft.rfft(x, axis=0)[FIRST_BIN : FIRST_BIN + BINS]
    s[0] *= _HALF  # the only bin without a mirror image
    return s


_ALONE = tuple((term, Measured[term.name]) for term in Term if term >= Term.DVDT_2)
"""Terms that are measured signals themselves."""


def _turning(R_vehicle_from_sensor: Matrix3, without_speed: bool) -> Array:
    """Return the matrix (len(Term), SIGNALS) that takes the signals to vehicle axes.

    Without speed, the force along the vehicle replaces dv/dt: least squares on it turns the x axis
    into the principal axis of the horizontal force.
    """
    R_vs = R_vehicle_from_sensor
    turn = np.zeros((len(Term), SIGNALS))
    turn[Term.FORCE_X : Term.FORCE_Z + 1, 0:3] = R_vs
    turn[Term.LATERAL, Measured.LATERAL] = 1.0
    if without_speed:
        turn[Term.DVDT, 0:3] = turn[Term.DVDT_REMAINING, 0:3] = R_vs[0]
    else:
        turn[Term.DVDT, Measured.DVDT] = 1.0
    turn[Term.SPEED_PITCH, SPEED_RATE] = R_vs[1]
    turn[Term.ROLL_RATE : Term.YAW_RATE + 1, RATE] = R_vs
    for row, column in _ALONE:
        if not (without_speed and row is Term.DVDT_REMAINING):
            turn[row, column] = 1.0
    return turn


_T = Term
PAIRS: tuple[tuple[int, int], ...] = (
    (_T.FORCE_X, _T.FORCE_X), (_T.FORCE_Y, _T.FORCE_Y), (_T.FORCE_Z, _T.FORCE_Z),
    (_T.FORCE_X, _T.DVDT), (_T.FORCE_X, _T.LATERAL), (_T.FORCE_X, _T.YAW_2),
    (_T.FORCE_X, _T.LATERAL_2), (_T.FORCE_Y, _T.LATERAL), (_T.FORCE_Y, _T.DVDT),
    (_T.FORCE_Y, _T.YAW_2), (_T.FORCE_Z, _T.DVDT), (_T.FORCE_Z, _T.SPEED_PITCH),
    (_T.FORCE_Z, _T.DVDT_2), (_T.FORCE_Z, _T.LATERAL), (_T.FORCE_Z, _T.LATERAL_2),
    (_T.DVDT, _T.DVDT), (_T.LATERAL, _T.LATERAL), (_T.DVDT, _T.LATERAL),
    (_T.SPEED_PITCH, _T.SPEED_PITCH), (_T.SPEED_PITCH, _T.DVDT), (_T.SPEED_PITCH, _T.DVDT_2),
    (_T.DVDT, _T.YAW_2), (_T.DVDT, _T.LATERAL_2), (_T.DVDT, _T.DVDT_2), (_T.LATERAL, _T.YAW_2),
    (_T.LATERAL, _T.LATERAL_2), (_T.YAW_2, _T.YAW_2), (_T.YAW_2, _T.LATERAL_2),
    (_T.LATERAL_2, _T.LATERAL_2), (_T.DVDT_2, _T.DVDT_2), (_T.ROLL_RATE, _T.ROLL_RATE),
    (_T.PITCH_RATE, _T.PITCH_RATE), (_T.YAW_RATE, _T.YAW_RATE), (_T.ROLL_RATE, _T.YAW_RATE),
    (_T.PITCH_RATE, _T.YAW_RATE), (_T.ROLL_RATE, _T.DVDT_YAW), (_T.PITCH_RATE, _T.LATERAL_YAW),
    (_T.YAW_RATE, _T.DVDT_YAW), (_T.YAW_RATE, _T.LATERAL_YAW), (_T.DVDT_YAW, _T.DVDT_YAW),
    (_T.LATERAL_YAW, _T.LATERAL_YAW), (_T.ROLL_RATE, _T.LATERAL), (_T.YAW_RATE, _T.LATERAL),
    (_T.DVDT_YAW, _T.LATERAL), (_T.FORCE_X, _T.DVDT_QUARTER), (_T.FORCE_Y, _T.LATERAL_QUARTER),
    (_T.ROLL_RATE, _T.LATERAL_QUARTER), (_T.PITCH_RATE, _T.DVDT_QUARTER),
    (_T.DVDT_QUARTER, _T.DVDT_QUARTER), (_T.LATERAL_QUARTER, _T.LATERAL_QUARTER),
    (_T.LATERAL_QUARTER, _T.DVDT), (_T.LATERAL_QUARTER, _T.YAW_2), (_T.DVDT_QUARTER, _T.LATERAL),
    (_T.DVDT_QUARTER, _T.YAW_2), (_T.DVDT_QUARTER, _T.LATERAL_2), (_T.LATERAL_QUARTER, _T.YAW_RATE),
    (_T.LATERAL_QUARTER, _T.DVDT_YAW), (_T.LATERAL_QUARTER, _T.LATERAL),
    (_T.DVDT_QUARTER, _T.YAW_RATE), (_T.DVDT_QUARTER, _T.LATERAL_YAW),
    (_T.FORCE_Y, _T.DVDT_LATERAL), (_T.DVDT_LATERAL, _T.DVDT_LATERAL), (_T.DVDT, _T.DVDT_LATERAL),
    (_T.YAW_2, _T.DVDT_LATERAL), (_T.LATERAL, _T.DVDT_LATERAL),
    (_T.LATERAL_QUARTER, _T.DVDT_LATERAL), (_T.FORCE_Z, _T.DVDT_ABS), (_T.DVDT_ABS, _T.DVDT_ABS),
    (_T.DVDT, _T.DVDT_ABS), (_T.DVDT_2, _T.DVDT_ABS), (_T.SPEED_PITCH, _T.DVDT_ABS),
    (_T.FORCE_Y, _T.DVDT_REMAINING), (_T.LATERAL, _T.DVDT_REMAINING),
    (_T.LATERAL_QUARTER, _T.DVDT_REMAINING), (_T.DVDT_REMAINING, _T.DVDT_REMAINING),
    (_T.DVDT_REMAINING, _T.YAW_2), (_T.DVDT_REMAINING, _T.DVDT_LATERAL),
    (_T.DVDT, _T.DVDT_REMAINING), (_T.FORCE_Z, _T.DVDT_REMAINING),
    (_T.SPEED_PITCH, _T.DVDT_REMAINING), (_T.DVDT_REMAINING, _T.DVDT_2),
    (_T.DVDT_REMAINING, _T.DVDT_ABS), (_T.FORCE_X, _T.LATERAL_REMAINING),
    (_T.DVDT, _T.LATERAL_REMAINING), (_T.DVDT_QUARTER, _T.LATERAL_REMAINING),
    (_T.LATERAL_REMAINING, _T.LATERAL_REMAINING), (_T.LATERAL_REMAINING, _T.YAW_2),
    (_T.LATERAL_REMAINING, _T.LATERAL_2), (_T.FORCE_Z, _T.LATERAL_REMAINING),
    (_T.LATERAL, _T.LATERAL_REMAINING),
)  # fmt: skip
"""Products in vehicle axes that the fit needs."""
PAIR = {pair: i for i, pair in enumerate(PAIRS)} | {(j, i): k for k, (i, j) in enumerate(PAIRS)}
"""Place of a product in the last dimension of `in_vehicle_axes`."""


_LEFT_OF, _RIGHT_OF = np.array(PAIRS).T


def _needed() -> NDArray[np.int64]:
    """Return the products of signals (as row * SIGNALS + column) that the products in vehicle axes
    need.
    """
    used = np.zeros((SIGNALS, SIGNALS), dtype=bool)
    for without_speed in (False, True):
        turn = _turning(np.ones((3, 3)), without_speed) != 0.0
        used |= (turn[_LEFT_OF].T.astype(int) @ turn[_RIGHT_OF].astype(int)) > 0
    return np.flatnonzero(used)


_NEEDED = _needed()
_NEEDED_LEFT, _NEEDED_RIGHT = _NEEDED // SIGNALS, _NEEDED % SIGNALS
PRODUCTS = len(_NEEDED)
_PLACE = {int(k): i for i, k in enumerate(_NEEDED)}


_Parts = tuple[tuple[Index, Index, Index, Index], ...]
"""Products of signals that make up each product in vehicle axes (2 % of all).

The parts are listed by their place within a pair. For each place: the pairs with so many parts, the
columns of the products, and the two places in `_turning` whose product is the factor.
"""


@cache
def _parts(without_speed: bool) -> _Parts:
    turn = _turning(np.ones((3, 3)), without_speed) != 0.0
    used = turn[_LEFT_OF][:, _NEEDED_LEFT] & turn[_RIGHT_OF][:, _NEEDED_RIGHT]
    pair, column = np.nonzero(used)
    left = _LEFT_OF[pair] * SIGNALS + _NEEDED_LEFT[column]
    right = _RIGHT_OF[pair] * SIGNALS + _NEEDED_RIGHT[column]
    rank = np.arange(len(pair)) - np.searchsorted(pair, np.arange(len(PAIRS)))[pair]
    return tuple(
        (pair[of], column[of], left[of], right[of])
        for of in (rank == k for k in range(int(rank.max()) + 1))
    )


def place(i: int, j: int) -> int:
    """Place of the product of two signals (sensor axes) in `band_products`."""
    return _PLACE[i * SIGNALS + j] if i * SIGNALS + j in _PLACE else _PLACE[j * SIGNALS + i]


@lru_cache(maxsize=8)
def _phases(tau_speed: float, tau_turn: float) -> Spectra:
    """Return the phases that remove delays [s] from the spectra of signals (2, BINS); they change
    seldom.
    """
    return np.asarray(np.exp(1j * np.outer([tau_speed, tau_turn], OMEGA)))


def band_products(s: Spectra, tau_speed: float, tau_turn: float) -> Array:
    """Return the needed products (PRODUCTS, BANDS) of spectra (BINS, MEASURED).

    tau: delay of the speed and of the yaw rate against the force [s].
    """
    out = np.empty((PRODUCTS, 1, BANDS))
    put_products(out, 0, s, tau_speed, tau_turn)
    return out[:, 0]


def put_products(products: Array, k: int, s: Spectra, tau_speed: float, tau_turn: float) -> None:
    """Write the products of a window's spectra to place k of products (PRODUCTS, n, BANDS)."""
    phases = _phases(tau_speed, tau_turn)
    both = np.empty((BINS, 2, SIGNALS))  # real and imaginary parts
    both[:, 0, :MEASURED], both[:, 1, :MEASURED] = s.real, s.imag
    for columns, phase in ((_LATE_COLUMNS, phases[0]), (_LATERAL_COLUMN, phases[1])):
        x, y = both[:, 0, columns], both[:, 1, columns]
        c, sine = phase.real[:, None], phase.imag[:, None]
        both[:, 0, columns], both[:, 1, columns] = x * c - y * sine, x * sine + y * c
    for quarter, column in _QUARTERS:
        both[:, 0, quarter], both[:, 1, quarter] = -both[:, 1, column], both[:, 0, column]
    rows = both.reshape(2 * BINS, SIGNALS)
    every = rows.take(_NEEDED_LEFT, axis=1)
    every *= rows.take(_NEEDED_RIGHT, axis=1)
    for band, (first, stop) in enumerate(_BAND_ROWS):
        products[:, k, band] = every[first:stop].sum(axis=0)


def in_vehicle_axes(
    products: Array,
    R_vehicle_from_sensor: Matrix3,
    without_speed: bool = False,
    first: int = 0,
    stop: int | None = None,
) -> Array:
    """Turn products (PRODUCTS, N, BANDS) of windows first .. stop-1 into vehicle axes.

    Returns (len(PAIRS), n, BANDS).
    """
    turn, parts = _turning(R_vehicle_from_sensor, without_speed), _parts(without_speed)
    products, turn = products[:, first:stop], turn.ravel()
    out = np.empty((len(PAIRS), *products.shape[1:]))
    for rank, (pair, column, left, right) in enumerate(parts):
        part = (turn[left] * turn[right])[:, None, None] * products[column]
        if rank:
            out[pair] += part
        else:  # every pair has one
            out[pair] = part
    return out
