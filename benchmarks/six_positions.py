"""Zero error and scale of every axis from rests in several positions.

Gravity has the same size in all of them (six-parameter fit, as in Tedaldi, Pretto and Menegatti,
"A robust and easy to implement method for IMU calibration", ICRA 2014).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imucald.core.errors import EstimateError
from imucald.core.samples import GRAVITY

Array = NDArray[np.float64]

ITERATIONS = 50
CONVERGED = 1e-12
"""Relative change of the parameters at which the fit stands."""
MIN_POSITIONS = 6
"""Six unknowns."""
MAX_CONDITION = 1e8
"""A worse-conditioned set of positions does not show all six (all in one plane, say)."""


@dataclass(frozen=True)
class Rests:
    """Stretches of rest: times (M, 2) [s], means (M, 3) and spreads (M,), in the input's unit."""

    times: Array
    means: Array
    spreads: Array


def find_rests(t: ArrayLike, values: ArrayLike, threshold: float, seconds: float = 2.0) -> Rests:
    """Find where a three-axis sensor rests: standard deviation of each second below a threshold.

    t: (N,) [s]; values: (N, 3). Stretches shorter than `seconds` are left out. Raises EstimateError
    for shapes that do not fit.
    """
    times, v = np.asarray(t, dtype=float), np.asarray(values, dtype=float)
    if v.ndim != 2 or v.shape != (len(times), 3):
        raise EstimateError("rests need times (N,) and values (N, 3)")
    if not len(times):
        return Rests(np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0))
    edges = np.searchsorted(times, np.arange(times[0], times[-1], 0.5))
    found: list[tuple[int, int]] = []
    for a, b in zip(edges[:-2], edges[2:], strict=True):  # seconds that overlap by half
        if b - a < 3 or float(v[a:b].std(axis=0).max()) > threshold:
            continue
        if found and a <= found[-1][1]:
            found[-1] = (found[-1][0], int(b))
        else:
            found.append((int(a), int(b)))
    kept = [(a, b) for a, b in found if times[b - 1] - times[a] >= seconds - 0.5]
    return Rests(
        np.array([[times[a], times[b - 1]] for a, b in kept]).reshape(-1, 2),
        np.array([v[a:b].mean(axis=0) for a, b in kept]).reshape(-1, 3),
        np.array([float(v[a:b].std(axis=0).max()) for a, b in kept]),
    )


@dataclass(frozen=True)
class SixParameters:
    """true = scale * (raw - bias), per axis; residual: rms of the size's error [m/s^2]."""

    bias: Array
    scale: Array
    residual: float


def six_parameters(means: ArrayLike, size: float = GRAVITY) -> SixParameters:
    """Fit zero error and scale of three axes to means at rest (M, 3), whose true size is known.

    Least squares of |scale (m - bias)| - size by Gauss and Newton, from the algebraic ellipsoid.
    Raises EstimateError where the positions do not show all six parameters.
    """
    m = np.asarray(means, dtype=float)
    if m.ndim != 2 or m.shape[1] != 3 or len(m) < MIN_POSITIONS:
        raise EstimateError(f"the fit needs at least {MIN_POSITIONS} positions at rest")
    middle, spread = m.mean(axis=0), float(m.std()) or 1.0
    u = (m - middle) / spread
    bias, scale = _ellipsoid(u)
    parameters = np.concatenate([bias, scale * size])
    for _ in range(ITERATIONS):
        w = parameters[3:] * (u - parameters[:3])
        length = np.sqrt((w * w).sum(axis=1))
        J = np.hstack([-w * parameters[3:], w * (u - parameters[:3])]) / length[:, None]
        if np.linalg.cond(J) > MAX_CONDITION:
            raise EstimateError("the positions at rest are too much alike for the fit")
        step, *_ = np.linalg.lstsq(J, size - length, rcond=None)
        parameters = parameters + step
        if np.abs(step).max() < CONVERGED * size:
            break
    w = parameters[3:] * (u - parameters[:3])
    residual = np.sqrt((w * w).sum(axis=1)) - size
    return SixParameters(
        parameters[:3] * spread + middle,
        np.abs(parameters[3:]) / spread,
        float(np.sqrt(np.mean(residual * residual))),
    )


def _ellipsoid(u: Array) -> tuple[Array, Array]:
    """Centre and inverse half-axes of the upright ellipsoid a u^2 + b u = 1 through the points."""
    solution, *_ = np.linalg.lstsq(np.hstack([u * u, u]), np.ones(len(u)), rcond=None)
    a, b = solution[:3], solution[3:]
    if np.any(a <= 0.0):
        raise EstimateError("the positions at rest are too much alike for the fit")
    centre = -b / (2.0 * a)
    return centre, np.sqrt(a / (1.0 + float((a * centre * centre).sum())))
