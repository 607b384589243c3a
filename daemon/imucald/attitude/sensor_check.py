"""The sensor check of method C, at rest; and what more can be had from rest in several positions.

One position tells the gyroscope's zero error, and of the accelerometer's the part along gravity
(all of it only where the sensor is known to be level). Fourteen positions or so tell zero error
and scale of every axis: gravity has the same size in all of them (six-parameter fit, as in Tedaldi,
Pretto and Menegatti, "A robust and easy to implement method for IMU calibration", ICRA 2014).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imucald.core.errors import EstimateError
from imucald.core.rotations import Matrix3, Vector, matrix_times
from imucald.core.samples import GRAVITY

Array = NDArray[np.float64]

LARGEST_RATE = math.radians(6.0)
"""A constant error of a gyroscope beyond this is a broken one [rad/s]."""
LARGEST_FORCE = 3.0
"""The same of an accelerometer [m/s^2]."""
ITERATIONS = 50
CONVERGED = 1e-12
"""Relative change of the parameters at which the fit stands."""
MIN_POSITIONS = 6
"""Six unknowns."""
MAX_CONDITION = 1e8
"""A worse-conditioned set of positions does not show all six (all in one plane, say)."""


def rest_errors(mean_rate: Vector, mean_force: Vector, is_level: bool) -> tuple[Vector, Vector]:
    """bs and ds of the publication from the means of a rest [rad/s, m/s^2], vertical axis z.

    Level: ds is the mean less gravity on z. Otherwise only its part along the measured vertical is
    taken: the rest of a mean that leans is slope as well as error.
    """
    x, y, z = mean_force
    if is_level:
        return mean_rate, (x, y, z - GRAVITY)
    size = math.sqrt(x * x + y * y + z * z)
    if size < 0.5 * GRAVITY:
        raise EstimateError("the accelerometer at rest feels less than half of gravity")
    k = (size - GRAVITY) / size
    return mean_rate, (x * k, y * k, z * k)


class CheckResult(NamedTuple):
    """What a sensor check found, in any one axes: constant errors [rad/s], [m/s^2]."""

    rate: Vector
    force: Vector

    def turned(self, R_new_from_old: Matrix3) -> CheckResult:
        """The same in other axes."""
        return CheckResult(
            matrix_times(R_new_from_old, self.rate), matrix_times(R_new_from_old, self.force)
        )

    def as_saved(self) -> dict[str, list[float]]:
        """As it stands in a saved state."""
        return {"rate": list(self.rate), "force": list(self.force)}

    @classmethod
    def from_saved(cls, data: object) -> CheckResult | None:
        """What a saved state holds; None where it is not a check of a sensor that works."""
        if not isinstance(data, Mapping):
            return None
        rate, force = data.get("rate"), data.get("force")
        for values, limit in ((rate, LARGEST_RATE), (force, LARGEST_FORCE)):
            if not isinstance(values, Sequence) or isinstance(values, str) or len(values) != 3:
                return None
            if not all(isinstance(c, float | int) and abs(c) <= limit for c in values):
                return None
        assert isinstance(rate, Sequence)
        assert isinstance(force, Sequence)
        return cls((rate[0], rate[1], rate[2]), (force[0], force[1], force[2]))


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
    positions: int


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
        len(m),
    )


def _ellipsoid(u: Array) -> tuple[Array, Array]:
    """Centre and inverse half-axes of the upright ellipsoid a u^2 + b u = 1 through the points."""
    solution, *_ = np.linalg.lstsq(np.hstack([u * u, u]), np.ones(len(u)), rcond=None)
    a, b = solution[:3], solution[3:]
    if np.any(a <= 0.0):
        raise EstimateError("the positions at rest are too much alike for the fit")
    centre = -b / (2.0 * a)
    return centre, np.sqrt(a / (1.0 + float((a * centre * centre).sum())))
