"""Windows of even signals in the frequency domain, and their products band by band.

Windows of 25.6 s with a Hann taper, a quarter apart, go to the frequency domain. Kept of each are
the real cross products of all signals per band, after the signals' delays were taken out as
phases: what a least-squares fit of the force on dv/dt, v r and the small terms needs, whatever
the rotation, the gains and the noise of each band turn out to be.
"""

from __future__ import annotations

import enum
import math
from collections import defaultdict
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3
from imucald.motion.ticks import TICK_S
from imucald.mount.signal_blocks import BLOCK_TICKS

Array = NDArray[np.float64]
Spectra = NDArray[np.complex128]
Index = NDArray[np.int64]

WINDOW = 256
"""Ticks per window; with BLOCK_TICKS = 64 a quarter of it."""
FIRST_BIN = 0
BAND_EDGES = (0, 1, 2, 3, 4, 6, 9, 13, 19, 28, 52)
"""Bins of 0.039 Hz; the last ends at 2 Hz, above which dv/dt says nothing."""
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
"""Columns that come from time; the two more are their quarter turns in frequency."""
SIGNALS = len(Measured)
SPEED_RATE = slice(Measured.SPEED_RATE_X, Measured.SPEED_RATE_Z + 1)
RATE = slice(Measured.RATE_X, Measured.RATE_Z + 1)
_LATE = (
    Measured.DVDT, Measured.DVDT_2, Measured.DVDT_YAW, Measured.DVDT_ABS, Measured.DVDT_LATERAL,
    Measured.DVDT_REMAINING,
)  # fmt: skip
"""Columns that come with the speed's delay."""


class Term(enum.IntEnum):
    """Signals in vehicle axes, of which the regressions are made; names as in `Measured`."""

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


_ALONE = tuple((term, Measured[term.name]) for term in Term if term >= Term.DVDT_2)
"""Terms that are signals as they come."""


def _turning(R_vehicle_from_sensor: Matrix3, without_speed: bool) -> Array:
    """Matrix (len(Term), SIGNALS) that takes the signals to vehicle axes.

    Without speed the force along the vehicle stands in for dv/dt: least squares on it turns the
    x axis into the principal axis of the horizontal force.
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


def _coefficients(R_vehicle_from_sensor: Matrix3, without_speed: bool) -> Array:
    """Matrix (len(PAIRS), PRODUCTS): products in vehicle axes from those of the signals."""
    turn = _turning(R_vehicle_from_sensor, without_speed)
    left = turn.take(_NEEDED_LEFT, axis=1)
    right = turn.take(_NEEDED_RIGHT, axis=1)
    out: Array = left.take(_LEFT_OF, axis=0)
    out *= right.take(_RIGHT_OF, axis=0)
    return out


@cache
def _groups(without_speed: bool) -> tuple[tuple[Index, Index], ...]:
    """Rows (g, r) of the coefficients and their columns (g, c): all that are not 0, which are 2 %.

    Rows with the same columns are a group, and groups of one size are stacked. A group with fewer
    rows than others repeats its last one.
    """
    is_used = _coefficients(np.ones((3, 3)), without_speed) != 0.0
    rows_of: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for row, used in enumerate(is_used):
        rows_of[tuple(np.flatnonzero(used).tolist())].append(row)
    sizes: dict[int, list[tuple[list[int], tuple[int, ...]]]] = defaultdict(list)
    for columns, rows in rows_of.items():
        sizes[len(columns)].append((rows, columns))
    made = []
    for stack in sizes.values():
        most = max(len(rows) for rows, _ in stack)
        padded = [rows + rows[-1:] * (most - len(rows)) for rows, _ in stack]
        made.append((np.array(padded), np.array([columns for _, columns in stack])))
    return tuple(made)


def place(i: int, j: int) -> int:
    """Place of the product of two signals (sensor axes) in `band_products`."""
    return _PLACE[i * SIGNALS + j] if i * SIGNALS + j in _PLACE else _PLACE[j * SIGNALS + i]


@lru_cache(maxsize=8)
def _shifted(tau: float) -> Spectra:
    """What a delay [s] takes from the spectrum of a signal (BINS,); it changes seldom."""
    return np.asarray(np.exp(1j * OMEGA * tau))


def band_products(s: Spectra, tau_speed: float, tau_turn: float) -> Array:
    """Products (PRODUCTS, BANDS) of spectra (BINS, MEASURED), those that are needed.

    tau: delay of the speed and of the yaw rate against the force [s].
    """
    x = np.empty((BINS, SIGNALS), dtype=np.complex128)
    x[:, :MEASURED] = s
    late = _shifted(tau_speed)
    for column in _LATE:
        x[:, column] *= late
    if tau_turn:
        x[:, Measured.LATERAL] *= _shifted(tau_turn)
    x[:, Measured.DVDT_QUARTER] = 1j * x[:, Measured.DVDT]
    x[:, Measured.LATERAL_QUARTER] = 1j * x[:, Measured.LATERAL]
    both = np.concatenate([x.real, x.imag], axis=1).reshape(BINS * 2, SIGNALS)
    every = np.empty((BANDS, SIGNALS, SIGNALS))
    for k in range(BANDS):
        part = both[2 * (BAND_EDGES[k] - FIRST_BIN) : 2 * (BAND_EDGES[k + 1] - FIRST_BIN)]
        np.matmul(part.T, part, out=every[k])
    return every.reshape(BANDS, -1).take(_NEEDED, axis=1).T


def in_vehicle_axes(
    products: Array, R_vehicle_from_sensor: Matrix3, without_speed: bool = False
) -> Array:
    """Turn products (PRODUCTS, n, BANDS) into vehicle axes: (len(PAIRS), n, BANDS)."""
    coefficients = _coefficients(R_vehicle_from_sensor, without_speed)
    _, n, bands = products.shape
    out = np.empty((len(PAIRS), n * bands))
    for rows, columns in _groups(without_speed):
        some = products.take(columns, axis=0).reshape(*columns.shape, n * bands)
        if columns.shape[1] == 1:
            out[rows] = some  # as they come
        else:
            out[rows] = coefficients[rows[:, :, None], columns[:, None, :]] @ some
    return out.reshape(-1, n, bands)
