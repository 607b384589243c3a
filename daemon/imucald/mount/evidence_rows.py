"""The regressions that the response evidence is made of; see `evidence_response`.

The tables give the weighted sums that the regressions need, for all rows and windows at once.

The tables define the products of signals and the gains in each sum. A fit then needs a
few large sums instead of some hundred small ones.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.core.arrays import Array
from imucald.mount.evidence_spectra import BAND_OMEGA2, BANDS, PAIR, Term

X_ROW, Y_ROW, PITCH_ROW, ROLL_ROW, P_ROW, Q_ROW = range(6)


class Row(Struct, frozen=True):
    """One regression: the dependent row and its regressors; the first regressor contains the angle.

    share, few: the variance is increased by this share, and by `few` divided by the number of road
    segments, because a few segments hide their own spread. Both were tuned on simulated drives so
    that errors are as large as stated from the second to the fortieth minute (`python -m
    benchmarks.mount_accuracy --only accuracy`; seeds of tuning: records/mount-accuracy.md).
    """

    name: str
    axis: int  # of e
    regressors: tuple[int, ...]
    prior_std: tuple[float, ...]  # of the nuisance coefficients
    share: float
    few: float
    bands: int = BANDS  # number of bands: above them the suspension resonates
    first: int = 0  # first band: below it the tracked vertical follows part of f_z


_T = Term
ROWS = (
    Row("yaw_turn", 2, (_T.LATERAL_REMAINING, _T.YAW_2, _T.LATERAL_2), (1.0, 0.006), 1.0, 1.0),
    Row("yaw_dvdt", 2, (_T.DVDT_REMAINING, _T.YAW_2, _T.DVDT_LATERAL), (0.5, 0.008), 1.0, 1.0),
    Row(
        "pitch_dvdt",
        1,
        (_T.DVDT_REMAINING, _T.DVDT, _T.DVDT_2, _T.DVDT_ABS),
        (0.005, 0.005, 0.0008),
        share=0.3,
        few=1.0,
        bands=8,
        first=1,
    ),
    Row(
        "roll_turn",
        0,
        (_T.LATERAL_REMAINING, _T.LATERAL, _T.LATERAL_2),
        (0.005, 0.01),
        share=1.6,
        few=12.0,
        bands=8,
        first=1,
    ),
    Row("pitch_axis", 1, (_T.YAW_RATE, _T.DVDT_YAW, _T.LATERAL), (0.015, 0.0015), 2.2, 8.0, 7),
    Row("roll_axis", 0, (_T.YAW_RATE, _T.LATERAL_YAW), (0.01,), 1.6, 12.0, 7),
)
"""Rows in the order of X_ROW .. Q_ROW."""
SAME_NOISE = ("roll_turn", "roll_axis")
"""Sources that both contain the pitch rate of the road, for example from its lean in bends.

Only the better source counts.
"""
WITHOUT_SPEED = (Y_ROW, P_ROW, Q_ROW)
"""Rows that can be fitted without speed: the principal axis, and the axis of rotation."""
TARGETS = (Term.FORCE_X, Term.FORCE_Y, Term.FORCE_Z, Term.FORCE_Z, Term.ROLL_RATE, Term.PITCH_RATE)
GX, GY, GQ, GX_QUARTER, GY_QUARTER, GP_QUARTER, GQ_QUARTER = range(7)
GAINS = (
    (X_ROW, Term.FORCE_X, Term.DVDT, 1.0, 0.02, 1.6),
    (Y_ROW, Term.FORCE_Y, Term.LATERAL, 1.0, 0.02, 1.6),
    (PITCH_ROW, Term.FORCE_Z, Term.SPEED_PITCH, 0.0, -1.3, 0.3),
    (X_ROW, Term.FORCE_X, Term.DVDT_QUARTER, 0.0, -0.7, 0.7),
    (Y_ROW, Term.FORCE_Y, Term.LATERAL_QUARTER, 0.0, -0.7, 0.7),
    (P_ROW, Term.ROLL_RATE, Term.LATERAL_QUARTER, 0.0, -0.2, 0.2),
    (Q_ROW, Term.PITCH_RATE, Term.DVDT_QUARTER, 0.0, -0.2, 0.2),
)
"""Gains per band: row, target, signal, expected value, smallest, largest."""
MAX_REGRESSORS = 4


Index = NDArray[np.int64]

KNOWN = (
    ((Term.DVDT, GX), (Term.DVDT_QUARTER, GX_QUARTER)),
    ((Term.LATERAL, GY), (Term.LATERAL_QUARTER, GY_QUARTER)),
    ((Term.SPEED_PITCH, GQ),),
    (),
    ((Term.LATERAL_QUARTER, GP_QUARTER),),
    ((Term.DVDT_QUARTER, GQ_QUARTER),),
)
"""For each row, the signals and gains whose response is subtracted from its target."""

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
_LEFT_FACTOR = np.array(
    [0 if k < 0 else 1 + k + (0 if square >= 0 else len(GAINS)) for _, _, k, square in _LEFT]
)
_ONE = np.ones((1, BANDS))
_LEFT_START = np.searchsorted([row for row, _, _, _ in _LEFT], np.arange(len(TARGETS)))

_PLACES = [(row, a) for row, spec in enumerate(ROWS) for a in range(len(spec.regressors))]
_PLACES.sort(key=lambda place: -len(KNOWN[place[0]]))  # those with most terms come first
_SCORE_ROW, _SCORE_A = np.array(_PLACES).T


def _terms(places: Sequence[tuple[int, int]], rank: int) -> tuple[Index, Index]:
    """Return, for each place with more than `rank` terms, the pair of that term and the place of
    its sign.
    """
    signals = [((TARGETS[row], -1), *KNOWN[row]) for row, _ in places]
    found = [
        (PAIR[terms[rank][0], ROWS[row].regressors[a]], 1 + terms[rank][1])
        for (row, a), terms in zip(places, signals, strict=True)
        if len(terms) > rank
    ]
    pair, sign = np.array(found).T
    return pair, sign


_TERMS = tuple(_terms(_PLACES, rank) for rank in range(1 + max(map(len, KNOWN))))

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
    """Return the power per window and band after subtracting each row's known response (6, n,
    BANDS).

    P: products in vehicle axes (pairs, n, BANDS); gains: (gains, BANDS).
    """
    factor = np.concatenate([_ONE, gains**2, -2.0 * gains])[_LEFT_FACTOR]
    terms = P.take(_LEFT_PAIR, axis=0)
    terms *= factor[:, None, :]
    out: Array = np.add.reduceat(terms, _LEFT_START, axis=0)
    return np.maximum(out, 0.0, out=out)


_ANGLE = [
    (row, PAIR[signal, spec.regressors[0]], gain)
    for row, spec in enumerate(ROWS)
    for signal, gain in ((TARGETS[row], -1), *KNOWN[row])
]
_ANGLE_PAIR = np.array([pair for _, pair, _ in _ANGLE])
_ANGLE_SIGN = np.array([1 + gain for *_, gain in _ANGLE])
_ANGLE_START = np.searchsorted([row for row, _, _ in _ANGLE], np.arange(len(ROWS)))
_ANGLE_POWER = np.array([PAIR[spec.regressors[0], spec.regressors[0]] for spec in ROWS])
_ANGLE_AXIS = np.array([spec.axis for spec in ROWS])


def less_angle(left: Array, P: Array, gains: Array, angle: Array) -> Array:
    """Return the residual power (6, n, BANDS) after subtracting each window's own angle (n, 3)
    [rad].
    """
    factor = factors(gains)[:, 0]
    sign = np.concatenate([_ONE, -gains])[_ANGLE_SIGN]
    target = np.add.reduceat(P[_ANGLE_PAIR] * sign[:, None, :], _ANGLE_START, axis=0)
    answer = factor[:, None, :] * angle.T[_ANGLE_AXIS][:, :, None]
    out: Array = np.maximum(left + answer * (answer * P[_ANGLE_POWER] - 2.0 * target), 0.0)
    return out


_GAIN_ROW = np.array([row for row, *_ in GAINS])
_GAIN_POWER = np.array([PAIR[signal, signal] for _, _, signal, *_ in GAINS])
_GAIN_CROSS = np.array([PAIR[target, signal] for _, target, signal, *_ in GAINS])
_EXPECTED, _LOW, _HIGH = (np.array([[gain[k]] for gain in GAINS]) for k in (3, 4, 5))
_SCALE = np.where(_GAIN_ROW < P_ROW, 4.0, 400.0)[:, None]


def renewed_gains(P: Array, weight: Array) -> Array:
    """Return gains per band (gains, BANDS).

    The gains are free, because squat, body roll and noise in dv/dt change them.
    """
    w = weight[_GAIN_ROW]
    power = (w * P[_GAIN_POWER]).sum(axis=1) + _SCALE
    cross = (w * P[_GAIN_CROSS]).sum(axis=1) + _SCALE * _EXPECTED
    out: Array = np.clip(cross / power, _LOW, _HIGH)
    return out


def factors(gains: Array) -> Array:
    """Return the factors of each row's regressors, band by band (rows, most, BANDS)."""
    gx, gy = gains[GX], gains[GY]
    out = np.ones((len(ROWS), MAX_REGRESSORS, BANDS))
    out[0, 0] = gy
    out[1, 0] = -gx
    out[2, 0], out[2, 1] = gx, gx * BAND_OMEGA2
    out[3, 0], out[3, 1] = -gy, gy * BAND_OMEGA2
    out[4, 0], out[4, 2] = -1.0, BAND_OMEGA2
    return out


def put_scores(
    P: Array, weight: Array, gains: Array, score: Array, normal: Array, first: int
) -> None:
    """Write the scores of windows into (rows, N, most) from place `first` on.

    The normal matrices go into (rows, N, most, most).

    P: (pairs, n, BANDS) in vehicle axes; weight: (rows, n, BANDS).
    """
    factor = factors(gains)
    n = P.shape[1]
    weight = weight * _USED
    signs = np.concatenate([_ONE, -gains])
    target, known, *more = (P.take(pair, axis=0) * signs[sign][:, None] for pair, sign in _TERMS)
    for terms in more:
        known[: len(terms)] += terms
    target[: len(known)] += known
    target *= weight[_SCORE_ROW]
    target *= factor[_SCORE_ROW, _SCORE_A][:, None]
    use = slice(first, first + n)
    score[:, use], normal[:, use] = 0.0, 0.0
    own_score, own_normal = score[:, use], normal[:, use]
    own_score[_SCORE_ROW, :, _SCORE_A] = target.sum(axis=2)
    both = factor[_ENTRY_ROW, _ENTRY_A] * factor[_ENTRY_ROW, _ENTRY_B]
    entries = P[_ENTRY_PAIR] * weight[_ENTRY_ROW]
    entries *= both[:, None]
    values = entries.sum(axis=2)
    own_normal[_ENTRY_ROW, :, _ENTRY_A, _ENTRY_B] = values
    own_normal[_ENTRY_ROW, :, _ENTRY_B, _ENTRY_A] = values
