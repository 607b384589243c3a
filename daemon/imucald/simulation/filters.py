"""Linear recursive filters and seeded noise. scipy.signal is not used, because its import is slow.

A recursive filter ``a * y = b * x`` is a banded triangular system. BLAS solves this system in
place.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence

import numpy as np
from scipy.linalg.blas import dtbsv

from imucald.core.arrays import Array


def generator(seed: int, stream: str) -> np.random.Generator:
    """Return the random generator of a named stream.

    Each effect has its own stream, so that turning off one effect does not change the random
    numbers of the others.
    """
    return np.random.default_rng([seed & 0xFFFF_FFFF_FFFF_FFFF, zlib.crc32(stream.encode())])


def filtered(b: Sequence[float], a: Sequence[float], x: Array, settled: bool = True) -> Array:
    """Apply the filter ``a[0] y[n] = sum b[i] x[n-i] - sum a[i] y[n-i]`` to x (N,).

    settled: True if the filter is in steady state for x[0] at the start. Otherwise, the filter
    starts from zero.
    """
    start = float(x[0]) if settled and len(x) else 0.0
    deviation = x - start
    drive = b[0] * deviation
    for lag in range(1, len(b)):
        drive[lag:] += b[lag] * deviation[:-lag]
    order = len(a) - 1
    if order:
        band = np.empty((order + 1, len(x)), order="F")
        band[:] = np.asarray(a, dtype=float)[:, None]
        drive = dtbsv(order, band, drive, lower=1, overwrite_x=1)
    else:
        drive /= a[0]
    if start:
        drive += start * (sum(b) / sum(a))
    return drive


def bilinear(
    numerator: Sequence[float], denominator: Sequence[float], rate: float
) -> tuple[list[float], list[float]]:
    """Discretise N(s)/D(s) (coefficients from the constant upwards) by the bilinear rule.

    Returns b, a for `filtered`. Both polynomials are treated as having the denominator's degree.
    """
    degree = len(denominator) - 1
    k = 2.0 * rate

    def substituted(coefficients: Sequence[float]) -> list[float]:
        total = np.zeros(degree + 1)
        for power, c in enumerate(coefficients):
            term = np.array([c * k**power])
            for _ in range(power):
                term = np.convolve(term, [1.0, -1.0])
            for _ in range(degree - power):
                term = np.convolve(term, [1.0, 1.0])
            total += term
        return [float(c) for c in total]

    return substituted(numerator), substituted(denominator)


def second_order(
    x: Array, rate: float, frequency_hz: float, damping: float, derivative: bool = False
) -> Array:
    """Return the response of w^2 / (s^2 + 2 z w s + w^2), or of its time derivative, to x (N,)."""
    w = 2.0 * math.pi * frequency_hz
    numerator = [0.0, w * w] if derivative else [w * w]
    b, a = bilinear(numerator, [w * w, 2.0 * damping * w, 1.0], rate)
    return filtered(b, a, x)


def butterworth(x: Array, rate: float, cutoff_hz: float) -> Array:
    """Apply a second-order Butterworth low-pass filter. The bilinear rule is prewarped, so the
    cut-off frequency is exact."""
    nyquist_share = min(cutoff_hz / rate, 0.49)
    w = 2.0 * rate * math.tan(math.pi * nyquist_share)
    b, a = bilinear([w * w], [w * w, math.sqrt(2.0) * w, 1.0], rate)
    return filtered(b, a, x)


def first_order(x: Array, rate: float, time_constant_s: float) -> Array:
    """Apply a first-order low-pass filter 1 / (1 + tau s)."""
    b, a = bilinear([1.0], [1.0, time_constant_s], rate)
    return filtered(b, a, x)


def gauss_markov(rng: np.random.Generator, n: int, step: float, length: float) -> Array:
    """Return a second-order Gauss-Markov process (n,) with variance 1, stationary from the first
    sample.

    The autocorrelation of the process is (1 + d/length) exp(-d/length). The slope of this
    autocorrelation is continuous, so the rate of change of the process is finite.
    """
    if n <= 0:
        return np.zeros(0)
    c = math.exp(-step / length)
    lead = min(math.ceil(8.0 * length / step), 200_000)
    variance = (1.0 + c * c) / (1.0 - c * c) ** 3
    white = rng.standard_normal(n + lead) / math.sqrt(variance)
    return filtered([1.0], [1.0, -2.0 * c, c * c], white, settled=False)[lead:]


def smoothed(x: Array, rate: float, width_s: float) -> Array:
    """Apply two running means of width_s each, without phase shift. The means keep the integral and
    limit the jerk."""
    n = max(1, round(width_s * rate)) | 1
    for _ in range(2):
        half = n // 2
        padded = np.concatenate((np.full(half + 1, x[0]), x, np.full(half, x[-1])))
        total = np.cumsum(padded)
        x = (total[n:] - total[:-n]) / n
    return x
