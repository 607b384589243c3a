"""Weighted sums that the regressions of `evidence_rows` need, all rows and windows at once.

Which products of signals, with which gains, go into which sum is written down once in tables;
a fit then is a few large sums instead of some hundred small ones.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from imucald.mount.evidence_rows import (
    GAINS,
    GP_QUARTER,
    GQ,
    GQ_QUARTER,
    GX,
    GX_QUARTER,
    GY,
    GY_QUARTER,
    MAX_REGRESSORS,
    P_ROW,
    ROWS,
    TARGETS,
)
from imucald.mount.evidence_spectra import BAND_OMEGA2, BANDS, PAIR, Term

Array = NDArray[np.float64]

KNOWN = (
    ((Term.DVDT, GX), (Term.DVDT_QUARTER, GX_QUARTER)),
    ((Term.LATERAL, GY), (Term.LATERAL_QUARTER, GY_QUARTER)),
    ((Term.SPEED_PITCH, GQ),),
    (),
    ((Term.LATERAL_QUARTER, GP_QUARTER),),
    ((Term.DVDT_QUARTER, GQ_QUARTER),),
)
"""Per row: signals and gains that its target is freed from."""

_LEFT = [
    (row, PAIR[target, target], -1, -1) for row, target in enumerate(TARGETS)
] + [
    (row, pair, gain, square)
    for row, target in enumerate(TARGETS)
    for signal, gain in KNOWN[row]
    for pair, square in ((PAIR[signal, signal], gain), (PAIR[target, signal], -1))
]  # fmt: skip
_LEFT.sort(key=lambda term: term[0])
_LEFT_PAIR = np.array([pair for _, pair, _, _ in _LEFT])
_LEFT_FACTOR = [
    0 if gain < 0 else 1 + gain + (0 if square >= 0 else len(GAINS)) for _, _, gain, square in _LEFT
]
_ONE = np.ones((1, BANDS))
_LEFT_START = np.searchsorted([row for row, _, _, _ in _LEFT], np.arange(len(TARGETS)))

_PLACES = [(row, a) for row, spec in enumerate(ROWS) for a in range(len(spec.regressors))]
_TERMS = [
    (k, row, a, PAIR[signal, ROWS[row].regressors[a]], gain)
    for k, (row, a) in enumerate(_PLACES)
    for signal, gain in ((TARGETS[row], -1), *KNOWN[row])
]
_TERM_PAIR = np.array([pair for _, _, _, pair, _ in _TERMS])
_TERM_ROW = np.array([row for _, row, _, _, _ in _TERMS])
_TERM_SIGN = [1 + gain for *_, gain in _TERMS]
_TERM_START = np.searchsorted([k for k, _, _, _, _ in _TERMS], np.arange(len(_PLACES)))
_SCORE_ROW = np.array([row for row, _ in _PLACES])
_SCORE_A = np.array([a for _, a in _PLACES])

_ENTRIES = [
    (row, a, b, PAIR[spec.regressors[a], spec.regressors[b]])
    for row, spec in enumerate(ROWS)
    for a in range(len(spec.regressors))
    for b in range(a, len(spec.regressors))
]
_ENTRY_ROW, _ENTRY_A, _ENTRY_B, _ENTRY_PAIR = np.array(_ENTRIES).T

_USED = np.zeros((len(ROWS), 1, BANDS))
for _i, _row in enumerate(ROWS):
    _USED[_i, 0, _row.first : _row.bands] = 1.0


def left_over(P: Array, gains: Array) -> Array:
    """Power per window and band that each row's known response leaves (6, n, BANDS).

    P: products in vehicle axes (pairs, n, BANDS); gains: (gains, BANDS).
    """
    factor = np.concatenate([_ONE, gains**2, -2.0 * gains])[_LEFT_FACTOR]
    terms = P[_LEFT_PAIR] * factor[:, None, :]
    out: Array = np.add.reduceat(terms, _LEFT_START, axis=0)
    return np.maximum(out, 0.0, out=out)


_ANGLE = [term for term in _TERMS if _PLACES[term[0]][1] == 0]
_ANGLE_PAIR = np.array([pair for _, _, _, pair, _ in _ANGLE])
_ANGLE_SIGN = [1 + gain for *_, gain in _ANGLE]
_ANGLE_START = np.searchsorted([row for _, row, _, _, _ in _ANGLE], np.arange(len(ROWS)))
_ANGLE_POWER = np.array([PAIR[spec.regressors[0], spec.regressors[0]] for spec in ROWS])
_ANGLE_AXIS = np.array([spec.axis for spec in ROWS])


def less_angle(left: Array, P: Array, gains: Array, angle: Array) -> Array:
    """What is left over (6, n, BANDS) once each window's own angle (n, 3) [rad] is taken off."""
    sign = np.concatenate([_ONE, -gains])[_ANGLE_SIGN]
    target = np.add.reduceat(P[_ANGLE_PAIR] * sign[:, None, :], _ANGLE_START, axis=0)
    answer = factors(gains)[:, 0][:, None, :] * angle.T[_ANGLE_AXIS][:, :, None]
    out: Array = np.maximum(left + answer * (answer * P[_ANGLE_POWER] - 2.0 * target), 0.0)
    return out


_GAIN_ROW = np.array([row for row, *_ in GAINS])
_GAIN_POWER = np.array([PAIR[signal, signal] for _, _, signal, *_ in GAINS])
_GAIN_CROSS = np.array([PAIR[target, signal] for _, target, signal, *_ in GAINS])
_EXPECTED, _LOW, _HIGH = (np.array([[gain[k]] for gain in GAINS]) for k in (3, 4, 5))
_SCALE = np.where(_GAIN_ROW < P_ROW, 4.0, 400.0)[:, None]


def renewed_gains(P: Array, weight: Array) -> Array:
    """Gains per band (gains, BANDS): free, as squat, body roll and noise in dv/dt change them."""
    w = weight[_GAIN_ROW]
    power = (w * P[_GAIN_POWER]).sum(axis=1) + _SCALE
    cross = (w * P[_GAIN_CROSS]).sum(axis=1) + _SCALE * _EXPECTED
    out: Array = np.clip(cross / power, _LOW, _HIGH)
    return out


def factors(gains: Array) -> Array:
    """What the regressors of each row are multiplied with, band by band (rows, most, BANDS)."""
    gx, gy = gains[GX], gains[GY]
    out = np.ones((len(ROWS), MAX_REGRESSORS, BANDS))
    out[0, 0] = gy
    out[1, 0] = -gx
    out[2, 0], out[2, 1] = gx, gx * BAND_OMEGA2
    out[3, 0], out[3, 1] = -gy, gy * BAND_OMEGA2
    out[4, 0], out[4, 2] = -1.0, BAND_OMEGA2
    return out


def scores(P: Array, weight: Array, gains: Array) -> tuple[Array, Array]:
    """Scores (rows, n, most) and normal matrices (rows, n, most, most) of windows.

    P: (pairs, n, BANDS) in vehicle axes; weight: (rows, n, BANDS).
    """
    n = P.shape[1]
    weight = weight * _USED
    factor = factors(gains)
    sign = np.concatenate([_ONE, -gains])[_TERM_SIGN]
    target = np.add.reduceat(P[_TERM_PAIR] * sign[:, None, :], _TERM_START, axis=0)
    mine = factor[_SCORE_ROW, _SCORE_A]
    score = np.zeros((len(ROWS), n, MAX_REGRESSORS))
    target *= weight[_SCORE_ROW]
    score[_SCORE_ROW, :, _SCORE_A] = np.matmul(target, mine[:, :, None])[:, :, 0]
    both = factor[_ENTRY_ROW, _ENTRY_A] * factor[_ENTRY_ROW, _ENTRY_B]
    entries = P[_ENTRY_PAIR] * weight[_ENTRY_ROW]
    values = np.matmul(entries, both[:, :, None])[:, :, 0]
    normal = np.zeros((len(ROWS), n, MAX_REGRESSORS, MAX_REGRESSORS))
    normal[_ENTRY_ROW, :, _ENTRY_A, _ENTRY_B] = values
    normal[_ENTRY_ROW, :, _ENTRY_B, _ENTRY_A] = values
    return score, normal
