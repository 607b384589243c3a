"""Weighted least squares on the windows of a drive: response of the force to dv/dt and v r (speed
times yaw rate).

The noise of each frequency band is estimated for the drive. A noise factor is estimated for each
window. Windows with much noise get less weight, and windows with little noise get more weight. The
deviations of the coefficients come from the spread between road segments, for two lengths of the
segments (sandwich estimator; White, Econometrica 48, 1980).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, inverse
from imucald.drive.windows import BAND, BANDS, OVERLAP

SEGMENTS: Final = (4, 16)
"""Number of windows of a road segment, for both lengths: 26 s and 102 s."""
FREEDOM = 8.0
"""Degrees of freedom (Student's t distribution) of the ratio between a window's noise and the noise
of the drive.

The residuals of four simulated drives, two drives of second_world and three measured drives were
each fitted with this distribution. The results are 1 to 12 degrees of freedom, because roads and
driving styles differ. A fit of few windows needs a number near the upper end of this range. These
drives are therefore not used to judge results.
"""
PASSES, MORE_PASSES = 4, 2
"""Number of iterations of a first fit, and number of iterations of a fit that starts from the
previous solution.
"""
NOISE_WINDOWS = 3.0
"""Weight of the expected noise against the noise of the drive, in windows."""
PRIOR_RATIO, PRIOR_SEGMENTS = 2.0, 5.0
"""Expected ratio between the variance from the spread of road segments and the variance of the
model, and weight of this prior in road segments.

The values were chosen on the drives that are listed in `state.Priors`.
"""
_BINS = np.bincount(BAND, minlength=BANDS).astype(float)


class Packing:
    """Stores the upper triangle of a symmetric matrix as one row."""

    def __init__(self, columns: int) -> None:
        self.columns = columns
        self._i, self._j = np.triu_indices(columns)
        self.size = len(self._i)
        self._twice = np.where(self._i == self._j, 1.0, 2.0)
        self._places = np.zeros((columns, columns), dtype=int)
        self._places[self._i, self._j] = self._places[self._j, self._i] = np.arange(self.size)

    def packed(self, products: Array, columns: tuple[int, ...]) -> Array:
        """Return rows (..., size) for these columns of symmetric matrices."""
        pick, all_of = np.array(columns), products.shape[-1]
        flat = products.reshape(*products.shape[:-2], all_of**2)
        return np.asarray(flat.take(pick[self._i] * all_of + pick[self._j], axis=-1))

    def matrices(self, rows: Array) -> Array:
        """Return the matrices (..., columns, columns) of rows (..., size)."""
        return np.asarray(rows[..., self._places])

    def form(self, v: Array) -> Array:
        """Return the factors (..., size) of the quadratic form v' G v for vectors v (..., columns).
        The sum of the factors times a row of G is the value of the form.
        """
        return np.asarray(v[..., self._i] * v[..., self._j] * self._twice)

    def trace(self, C: Array) -> Array:
        """Return the factors (..., size) of the trace of C G for matrices C (..., columns,
        columns).
        """
        return np.asarray(C[..., self._i, self._j] * self._twice)


class Responses(NamedTuple):
    """Results of F fits.

    value: (F, keep) coefficients. covariance: (F, keep, keep) covariance of the coefficients.
    segments: (F, keep) effective number of road segments. vector: (F, 1 + p) factors that compute
    the residual from the columns of a window. power: (F, size) factors that compute the expected
    power of the noise from a packed window, see `left_of`. noise: (F, BANDS) noise of each
    frequency band, infinite in unused bands. trust: (F, n) weight of each window, computed from
    this power. model: (F, p) variances of all coefficients by the model alone.
    """

    value: Array
    covariance: Array
    segments: Array
    vector: Array
    power: Array
    noise: Array
    trust: Array
    model: Array


def trust_in(left: Array, noise: Array) -> Array:
    """Return the weights (F, n) of windows. left: (F, n, BANDS) power, see `left_of`. noise: (F,
    BANDS).

    The weight is the expected inverse of the window's noise factor (Lange, Little and Taylor, JASA
    84, 1989).
    """
    power = (2.0 / OVERLAP) * (left / noise[:, None]).sum(axis=2)
    return np.asarray((FREEDOM + _values(np.isfinite(noise[0]))) / (FREEDOM + power))


def _values(bands: NDArray[np.bool_]) -> float:
    """Return the number of independent values of a window in these frequency bands."""
    return float(2.0 * _BINS[bands].sum() / OVERLAP)


def left_of(rows: Array, power: Array, packing: Packing) -> Array:
    """Return the expected noise power of each fit in each window and frequency band (F, n, BANDS).

    rows: (F, n, BANDS, size) packed windows. power: (F, size) factors of each fit. The power is
    the sum of two parts: the power of the residual, and the expected effect of the errors of the
    coefficients. A window with much influence on the fit has a small residual, but its noise need
    not be small.
    """
    flat = rows.reshape(len(rows), -1, packing.size)
    made = (flat @ power[:, :, None]).reshape(rows.shape[:3])
    return np.asarray(np.maximum(made, 1e-12 * rows[..., 0] + 1e-15))


def segments_of(old: int, rows: int, to_last: bool = False) -> NDArray[np.int_]:
    """Return the index of the road segment (rows,) of each row. The first `old` rows are whole
    segments, and the other rows are windows.

    to_last: True: the last segment ends with the last row. False: the first new segment begins with
    the first window.
    """
    length, single = SEGMENTS[0], np.arange(rows - old)
    shift = -(rows - old) % length if to_last else 0
    return np.concatenate([np.arange(old), old + (single + shift) // length])


def grown(ratio: Array, segments: Array | int) -> Array:
    """Return the factor by which a variance is multiplied. ratio: measured ratio of variances.
    segments: number of segments from which the ratio was measured.
    """
    return np.asarray(
        (PRIOR_SEGMENTS * PRIOR_RATIO + segments * ratio) / (PRIOR_SEGMENTS + segments)
    )


def respond(
    rows: Array,
    old: int,
    packing: Packing,
    usual: Array,
    spread: Array,
    keep: int,
    bands: NDArray[np.bool_],
    noise: Array | None = None,
    trust: Array | None = None,
) -> Responses:
    """Fit column 0 as a linear combination of the other columns, in F fits at once.

    rows: (F, n, BANDS, size) packed products. The first `old` rows are road segments, and the other
    rows are windows. usual: (F, BANDS) expected noise. spread: (F, p) prior deviations of the
    coefficients. keep: number of coefficients to return. bands: (BANDS,) flags of the used bands.
    noise, trust: results of the previous fit, if the previous fit used most of these windows.
    """
    fits, p = len(rows), packing.columns - 1
    bins = np.where(bands, _BINS, 0.0)
    usual = np.where(bands, usual, np.inf)
    flat = rows.reshape(fits, -1, packing.size)
    prior = np.eye(p) / np.square(spread)[:, None]
    passes = PASSES if trust is None else MORE_PASSES
    trust = np.ones(rows.shape[:2]) if trust is None else trust.copy()
    noise = usual if noise is None else np.where(bands & np.isfinite(noise), noise, usual)
    made = old * SEGMENTS[0] + rows.shape[1] - old
    one, errors = np.ones((fits, 1)), np.zeros((fits, 1 + p, 1 + p))
    for _ in range(passes):
        weight = (2.0 / OVERLAP) * trust[:, :, None] / noise[:, None]
        total = packing.matrices((weight.reshape(fits, 1, -1) @ flat)[:, 0])
        covariances = inverse(total[:, 1:, 1:] + prior)
        beta = (covariances @ total[:, 1:, :1])[:, :, 0]
        vector = np.concatenate([one, -beta], axis=1)
        errors[:, 1:, 1:] = covariances
        power = packing.form(vector) + packing.trace(errors)
        left = left_of(rows, power, packing)
        found = (trust[:, None] @ left)[:, 0] / np.maximum(bins, 1.0)
        noise = np.asarray((found + NOISE_WINDOWS * usual) / (made + NOISE_WINDOWS), float)
        trust[:, old:] = trust_in(left[:, old:], noise)  # in the sums of old ones it is already
    each = (weight[:, :, None] @ rows)[:, :, 0]
    scores = (packing.matrices(each) @ vector[:, None, :, None])[:, :, 1:, 0]
    model = covariances[:, :keep, :keep]
    variance = np.diagonal(model, axis1=1, axis2=2)
    segment = segments_of(old, rows.shape[1])
    sandwich = np.zeros((fits, keep))
    for length in SEGMENTS:
        s = _by_place(scores, segment * SEGMENTS[0] // length, made // length + 1)
        M = s.swapaxes(1, 2) @ s
        if s.shape[1] > 3:
            M = M + 0.5 * (
                s[:, 1:].swapaxes(1, 2) @ s[:, :-1] + s[:, :-1].swapaxes(1, 2) @ s[:, 1:]
            )
        enough = 1.0 if length == SEGMENTS[0] else min(1.0, s.shape[1] / 8.0)
        spread_out = np.diagonal(covariances @ M @ covariances, axis1=1, axis2=2)[:, :keep]
        sandwich = np.maximum(sandwich, enough * spread_out)
    segments = _effective_segments(each, covariances[:, :keep], packing, segment)
    ratio = np.clip(sandwich / variance, 0.1, 100.0)
    student = 1.0 + 12.0 / (PRIOR_SEGMENTS + segments) ** 2  # about
    grow = np.maximum(grown(ratio, segments), 1.0) * student
    root = np.sqrt(grow)
    covariance = np.asarray(model * root[:, :, None] * root[:, None], dtype=float)
    value = np.asarray(beta[:, :keep], float)
    alone = np.diagonal(covariances, axis1=1, axis2=2)
    return Responses(value, covariance, segments, vector, power, noise, trust, alone)


def _effective_segments(
    each: Array, covariances: Array, packing: Packing, segment: NDArray[np.int_]
) -> Array:
    """Return the effective number of road segments (F, keep) from which each coefficient is
    estimated.

    each: (F, n, size) weighted windows. covariances: (F, keep, p) rows of the covariance for the
    coefficients.
    """
    picked = np.concatenate([np.zeros((*covariances.shape[:2], 1)), covariances], axis=2)
    part = each @ packing.form(picked).swapaxes(1, 2)
    share = _by_place(part, segment, int(segment[-1]) + 1)
    squares = np.maximum((share**2).sum(axis=1), 1e-30)
    return np.asarray(np.maximum(share.sum(axis=1) ** 2 / squares, 1.0))


def _by_place(values: Array, place: NDArray[np.int_], places: int) -> Array:
    """Return sums (F, places, m) of values (F, n, m) with the same place. place: (n,) in ascending
    order.
    """
    made = np.zeros((len(values), places, values.shape[2]))
    starts = np.flatnonzero(np.diff(place, prepend=-1))
    made[:, place[starts]] = np.add.reduceat(values, starts, axis=1)
    return made
