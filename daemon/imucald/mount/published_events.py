"""Manoeuvres: what one braking or one acceleration says about the target angle, and their sum.

A published sample angle with v*r taken off is lambda_i = atan2(v r, dv/dt) - atan2(R'y, R'x), and
the circular mean of those, weighted by |R'| |(dv/dt, v r)|, is the argument of the sum of
conj(R') (dv/dt + i v r). A manoeuvre keeps that sum in sensor axes, before levelling, so that a
better tilt later re-reads every earlier manoeuvre. Uncertainty comes from how manoeuvres differ
from one another: samples within one share its slope, its bank and its driver.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

from imucald.frames import Matrix3

PRIOR_SPREAD = math.radians(4.0)
"""Spread of single manoeuvres about the truth that is expected before there are any [rad]."""
PRIOR_MANOEUVRES = 2.0
"""Weight of that expectation, in manoeuvres."""
SMALLEST_SPREAD = math.radians(0.8)
"""Robust limits never shrink below this [rad]."""
ROBUST_SPREADS = 1.5
"""A manoeuvre further than this many spreads from the rest counts less (Huber)."""
FLOOR_STD = math.radians(0.15)
"""What manoeuvres share, so that no number of them averages it: cross-axis error, delay [rad]."""


class Manoeuvre:
    """Sums over the blocks of one straight braking or acceleration, in sensor axes."""

    __slots__ = ("along", "lateral", "moment", "peak", "seconds", "signed", "start", "stop")

    def __init__(self, start: float, signed: bool) -> None:
        self.start = self.stop = start
        self.signed = signed
        self.peak = 0.0
        self.seconds = 0.0
        self.along = [0.0, 0.0, 0.0]  # sum f dv/dt
        self.lateral = [0.0, 0.0, 0.0]  # sum f v r
        self.moment = [0.0] * 6  # sum f f', xx yy zz xy xz yz

    def add(self, stop: float, dt: float, f: Sequence[float], dvdt: float, lateral: float) -> None:
        """Take a block: force less offset (3,) [m/s^2], dv/dt and v r [m/s^2], over dt [s]."""
        x, y, z = f
        for i in range(3):
            self.along[i] += dt * f[i] * dvdt
            self.lateral[i] += dt * f[i] * lateral
        m = self.moment
        m[0] += dt * x * x
        m[1] += dt * y * y
        m[2] += dt * z * z
        m[3] += dt * x * y
        m[4] += dt * x * z
        m[5] += dt * y * z
        self.seconds += dt
        self.stop = stop

    def pointer(self, R_level_from_sensor: Matrix3) -> complex:
        """Sum of conj(R') (dv/dt + i v r): its argument is this manoeuvre's lambda."""
        (ax, ay, az), (bx, by, bz), _ = R_level_from_sensor.tolist()
        u, w = self.along, self.lateral
        p = complex(ax * u[0] + ay * u[1] + az * u[2], bx * u[0] + by * u[1] + bz * u[2])
        q = complex(ax * w[0] + ay * w[1] + az * w[2], bx * w[0] + by * w[1] + bz * w[2])
        return p.conjugate() + 1j * q.conjugate()

    def axis_pointer(self, R_level_from_sensor: Matrix3) -> complex:
        """Sum of conj(R')^2: half its argument is lambda up to 180 deg; isotropic noise cancels."""
        a, b, _ = R_level_from_sensor.tolist()
        xx, yy, zz, xy, xz, yz = self.moment
        m = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
        aa = sum(a[i] * a[j] * m[i][j] for i in range(3) for j in range(3))
        bb = sum(b[i] * b[j] * m[i][j] for i in range(3) for j in range(3))
        ab = sum(a[i] * b[j] * m[i][j] for i in range(3) for j in range(3))
        return complex(aa - bb, -2.0 * ab)


class Angle(NamedTuple):
    """A combined angle [rad], its standard deviation [rad], and manoeuvres behind it."""

    value: float
    std: float
    manoeuvres: int


def combined(pointers: Sequence[complex]) -> Angle | None:
    """Combine pointers robustly into one angle; None where there is nothing to combine.

    The spread over manoeuvres (with a prior worth two) over their effective number gives the
    standard deviation; Huber weights keep a manoeuvre that disagrees from deciding.
    """
    sizes = [abs(p) for p in pointers]
    if not sizes or max(sizes) <= 0.0:
        return None
    weights = list(sizes)
    mean = sum(pointers)
    spread = PRIOR_SPREAD
    away: list[float] = []
    for _ in range(4):
        if mean == 0.0:
            return None
        away = [cmath.phase(p * mean.conjugate()) for p in pointers]
        limit = ROBUST_SPREADS * max(SMALLEST_SPREAD, _median_size(away) * 1.4826)
        weights = [
            s if abs(d) <= limit else s * limit / abs(d) for s, d in zip(sizes, away, strict=True)
        ]
        mean = sum((p * w / s for p, w, s in zip(pointers, weights, sizes, strict=True) if s), 0j)
    total = sum(weights)
    effective = total * total / sum(w * w for w in weights)
    square = sum(w * d * d for w, d in zip(weights, away, strict=True)) / total
    spread = math.sqrt(
        (PRIOR_MANOEUVRES * PRIOR_SPREAD**2 + effective * square)
        / (PRIOR_MANOEUVRES + effective - 1.0)
    )
    std = math.sqrt(spread * spread / effective + FLOOR_STD**2)
    return Angle(cmath.phase(mean), std, len(pointers))


def combined_axis(pointers: Sequence[complex]) -> Angle | None:
    """Combine axis pointers (`Manoeuvre.axis_pointer`): the angle is known up to 180 deg."""
    double = combined(pointers)
    if double is None:
        return None
    return Angle(0.5 * double.value, 0.5 * double.std, double.manoeuvres)


def _median_size(values: Sequence[float]) -> float:
    sizes = sorted(abs(v) for v in values)
    n = len(sizes)
    return sizes[n // 2] if n % 2 else 0.5 * (sizes[n // 2 - 1] + sizes[n // 2])
