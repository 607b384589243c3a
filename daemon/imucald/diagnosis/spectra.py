"""Residuals and derivatives by stretches and frequencies, whitened by the residual's spectrum.

A drive is cut into stretches of `BLOCK_S` that overlap by half (Hann windows). In each, residual
and columns are transformed; frequencies up to the drive's band are kept. The noise is the
residual's own cross-spectral matrix over the signals, smooth in frequency: this takes colour and
the correlation between signals into account (Whittle's likelihood). Stretches are the unit of all
statements about certainty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from imucald.diagnosis.grid import GRID_HZ, Array

Complex = NDArray[np.complexfloating]

BLOCK_S = 51.2
BLOCK = int(BLOCK_S * GRID_HZ)
HOP = BLOCK // 2
LEAST_SHARE = 0.4
"""A stretch counts where at least this share of the rows of a signal is usable."""
BAND_EDGES = (0, 1, 2, 3, 5, 7, 10, 14, 20, 28, 40, 56, 80, 112, 150, 200, 256)
"""First frequency of each band in which the noise is taken as flat."""
OVERLAP_WEIGHT = 0.5
"""Half-overlapping windows count every row twice."""
SHRINK = 0.12
"""Share by which cross-spectra are pulled to zero."""
PRIOR_COUNT = 3.0
"""Frequencies of usual loudness that each stretch is taken to have besides its own."""
LEAST_LOUD, MOST_LOUD = 0.3, 5.0
ERROR_STEADY, ERROR_PER_HZ, ERROR_PER_HZ2 = 0.025, 0.1, 2.0
"""Error of the forward model, relative to what it predicts: in steady state, per hertz and per
hertz squared. What is quick is small, and the inputs' own noise counts in it: it would otherwise
pull scales down and delays away."""
ERROR_OF_LEAN = 0.12
"""The same for the rates of roll and pitch: they are the springs' work alone."""
FLOOR = 1e-3
"""Least noise of a signal in a band, relative to its own largest band."""


@dataclass(frozen=True)
class Blocks:
    """Transformed columns: (B, F, C, P) for B stretches, F frequencies, C signals, P columns."""

    values: Complex
    present: NDArray[np.bool_]
    """(B, C): signals usable in a stretch."""
    start: Array
    """(B,) time of each stretch's middle [s] after the drive's first row."""


@dataclass(frozen=True)
class Noise:
    """What residuals are weighed by: covariance loud S loud + error^2 of each stretch and band.

    The noise of different signals goes together (one road shakes all); the forward model's errors
    in different signals are taken as independent of each other.
    """

    S: Complex
    """(bands, C, C) cross-spectra at usual loudness."""
    loud: Array
    """(B, bands, C)"""
    error: Array
    """(B, bands, C) forward model's error."""

    def matrices(self, band: int, blocks: NDArray[np.int64], c: NDArray[np.int64]) -> Complex:
        """Covariance (b, c, c) of some stretches and signals in a band."""
        scale = self.loud[blocks, band][:, c]
        made = self.S[band][np.ix_(c, c)] * (scale[:, :, None] * scale[:, None, :])
        made[:, range(len(c)), range(len(c))] += self.error[blocks, band][:, c] ** 2
        return np.asarray(made)

    def volume(self, present: NDArray[np.bool_], frequencies: int) -> float:
        """Log of the density's norm: what an explanation pays for noise that it leaves.

        Complex Gaussian values of each stretch, weighed as in the normal equations.
        """
        total = 0.0
        for blocks, c in alike(present):
            for i, band in enumerate(bands(frequencies)):
                size = 0.5 if band.start == 0 else band.stop - band.start
                total += size * float(np.linalg.slogdet(self.matrices(i, blocks, c))[1].sum())
        return OVERLAP_WEIGHT * total

    def louder(self, factor: Array) -> Noise:
        """All of it times a factor (1 or B, bands, C)."""
        return Noise(self.S, self.loud * factor, self.error * factor)


def alike(present: NDArray[np.bool_]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Stretches that have the same signals, and which: (b,) and (c,) of present (B, C)."""
    patterns, which = np.unique(present, axis=0, return_inverse=True)
    for kind, pattern in enumerate(patterns):
        if pattern.any():
            yield np.flatnonzero(which.ravel() == kind), np.flatnonzero(pattern)


def windows(n: int) -> NDArray[np.int64]:
    """First rows of the stretches of a drive of n rows."""
    return np.arange(0, max(n - BLOCK, 0) + 1, HOP)


def transform(columns: NDArray[np.floating], usable: NDArray[np.bool_], top_hz: float) -> Blocks:
    """Cut and transform columns (P, C, N) with their usable rows (C, N)."""
    n = columns.shape[-1]
    starts = windows(n)
    keep = int(top_hz * BLOCK_S) + 1
    window = np.hanning(BLOCK + 1)[:-1]
    window /= np.sqrt(np.mean(window**2) * BLOCK)
    P, C = columns.shape[:2]
    made = np.empty((len(starts), keep, C, P), dtype=np.complex64)
    present = np.empty((len(starts), C), dtype=bool)
    for b, first in enumerate(starts):
        rows = slice(first, first + BLOCK)
        mask = usable[:, rows]
        present[b] = mask.mean(axis=1) >= LEAST_SHARE
        tapered = columns[:, :, rows] * (window * (mask & present[b][:, None]))
        made[b] = np.fft.rfft(tapered, axis=-1)[:, :, :keep].transpose(2, 1, 0)
    return Blocks(made, present, np.asarray((starts + BLOCK / 2) / GRID_HZ, dtype=float))


def bands(frequencies: int) -> list[slice]:
    """Frequency bands for a number of kept frequencies."""
    edges = [e for e in BAND_EDGES if e < frequencies] + [frequencies]
    return [slice(a, b) for a, b in pairwise(edges)]


def cross_spectra(
    residual: Complex, present: NDArray[np.bool_], loud: Array | None = None, taken: float = 0.0
) -> Complex:
    """Noise (bands, C, C) from residuals (B, F, C), of usual loudness.

    loud: see `loudness`; taken: degrees of freedom that the fit used of the means.
    """
    B, F, C = residual.shape
    result = np.empty((len(bands(F)), C, C), dtype=np.complex128)
    for i, band in enumerate(bands(F)):
        e = residual[:, band, :]
        if loud is not None:
            e = e / loud[:, i, None, :]
        means = np.asarray(e[:, 0, :].real, dtype=float)
        e = e.reshape(-1, C)
        there = np.repeat(present, band.stop - band.start, axis=0).astype(float)
        pairs = there.T @ there
        S = (e.T @ e.conj()) / np.maximum(pairs, 1.0)
        if i == 0:
            S = _long_run(means, present)
            S = S * (B / max(B - taken, 0.3 * B))
        diagonal = np.real(np.diag(S)).copy()
        # Few values make a poor inverse: the fewer, the more the cross terms are pulled in.
        count = OVERLAP_WEIGHT * B * (band.stop - band.start)
        pull = SHRINK + (1.0 - SHRINK) * C / (count + C)
        result[i] = (1.0 - pull) * S + pull * np.diag(diagonal)
    power = np.real(np.einsum("icc->ic", result))
    least = FLOOR * power.max(axis=0) + 1e-18
    for i in range(len(result)):
        result[i] += np.diag(np.maximum(least - power[i], 0.0) + 1e-6 * least)
    return result


def loudness(residual: Complex, present: NDArray[np.bool_], noise: Complex) -> Array:
    """How loud each stretch is in each band and signal against the noise: (B, bands, C).

    Rough roads and turns make some stretches louder than others; each is weighed by its own.
    """
    B, F, C = residual.shape
    result = np.ones((B, len(noise), C))
    for i, band in enumerate(bands(F)):
        # Neighbouring bands lend their frequencies: a single one says little.
        wide = slice(max(band.start - max(2, band.start // 2), 1), band.stop + 2 + band.stop // 2)
        e = np.abs(residual[:, wide, :]) ** 2
        usual = np.where(present[:, None, :], e, 0.0).sum(axis=(0, 1)) / np.maximum(
            present.sum(axis=0) * e.shape[1], 1
        )
        here = e.sum(axis=1) / np.maximum(usual, 1e-30)
        ratio = (PRIOR_COUNT + here) / (PRIOR_COUNT + e.shape[1])
        result[:, i, :] = np.clip(np.sqrt(ratio), LEAST_LOUD, MOST_LOUD)
    return result


def model_error(predicted: Complex, steady: Array) -> Array:
    """What the forward model itself cannot promise: (B, bands, C).

    Its error is a share of the predicted signal that grows with frequency: dynamics of tyres and
    springs are known less well than steady states. steady: (C,) that share in steady state.
    """
    edges = bands(predicted.shape[1])
    result = np.empty((len(predicted), len(edges), predicted.shape[2]))
    for i, band in enumerate(edges):
        f = 0.5 * (band.start + band.stop - 1) / BLOCK_S
        share = np.hypot(steady, ERROR_PER_HZ * f + ERROR_PER_HZ2 * f * f)
        power = np.mean(np.abs(predicted[:, band, :]) ** 2, axis=1)
        result[:, i, :] = share * np.sqrt(power)
    return result


def _long_run(mean: Array, present: NDArray[np.bool_]) -> NDArray[np.complex128]:
    """Long-run covariance of the stretches' means (Bartlett), (C, C): slow wander counts."""
    lags = 5
    x = np.where(present, mean, 0.0)
    count = np.maximum(present.astype(float).T @ present.astype(float), 1.0)
    S = x.T @ x / count
    for lag in range(1, min(lags, len(x) - 1)):
        cross = x[lag:].T @ x[:-lag] / count
        S = S + (1.0 - lag / lags) * (cross + cross.T)
    # Half-overlapping windows make neighbours alike by a sixth of the power already.
    values, vectors = np.linalg.eigh(S / (1.0 + 2.0 * 0.8 / 6.0))
    least = 0.1 * np.maximum(values.max(), 0.0) * 1e-6
    kept = (vectors * np.maximum(values, least)) @ vectors.T
    diagonal = np.maximum(np.diag(kept), np.mean(x**2, axis=0))
    np.fill_diagonal(kept, diagonal)
    return np.asarray(kept, dtype=np.complex128)


def noise_of(left: Complex, present: NDArray[np.bool_], loud: Array, error: Array) -> Noise:
    """Noise that a fit leaves (B, F, C); loud: of each stretch by a fit before, error: kept."""
    louder = loudness(left, present, cross_spectra(left, present, loud))
    return Noise(cross_spectra(left, present, louder), louder, error)


@dataclass(frozen=True)
class Normal:
    """Normal equations by stretch: information (B, P, P), score (B, P), square (B,)."""

    information: Array
    score: Array
    square: Array

    def total(self) -> tuple[Array, Array, float]:
        """Return the sums over all stretches."""
        return self.information.sum(axis=0), self.score.sum(axis=0), float(self.square.sum())


def normal_equations(columns: Blocks, residual: Complex, noise: Noise) -> Normal:
    """Weighted normal equations of residual (B, F, C) on columns; signals absent weigh nothing."""
    B, F, _, P = columns.values.shape
    information, score = np.zeros((B, P, P)), np.zeros((B, P))
    square = np.zeros(B)
    for blocks, c in alike(columns.present):
        for i, band in enumerate(bands(F)):
            # A complex value has two parts of half the power each; the mean (first band) is real.
            weight = OVERLAP_WEIGHT * (1.0 if band.start == 0 else 2.0)
            white = np.linalg.inv(np.linalg.cholesky(noise.matrices(i, blocks, c)))
            root = (np.sqrt(weight) * white).astype(np.complex64)[:, None]
            X = _stacked(root @ columns.values[blocks, band][:, :, c, :])
            e = _stacked(root @ residual[blocks, band][:, :, c, None])
            information[blocks] += X.transpose(0, 2, 1) @ X
            score[blocks] += (X.transpose(0, 2, 1) @ e)[..., 0]
            square[blocks] += np.sum(e * e, axis=(1, 2))
    return Normal(information, score, square)


def weighted(residual: Complex, present: NDArray[np.bool_], noise: Noise) -> Complex:
    """Residual (B, F, C) times the inverse noise, as the normal equations weigh it."""
    result = np.zeros_like(residual)
    for blocks, c in alike(present):
        for i, band in enumerate(bands(residual.shape[1])):
            weight = OVERLAP_WEIGHT * (1.0 if band.start == 0 else 2.0)
            inverse = weight * np.linalg.inv(noise.matrices(i, blocks, c))
            part = np.einsum("bij,bfj->bfi", inverse, residual[blocks, band][:, :, c])
            result[np.ix_(blocks, np.arange(band.start, band.stop), c)] = part
    return result


def _stacked(x: NDArray[np.complexfloating]) -> NDArray[np.floating]:
    """(b, f, c, P) complex -> (b, 2 f c, P) real."""
    flat = x.reshape(len(x), -1, x.shape[-1])
    return np.concatenate((flat.real, flat.imag), axis=1)
