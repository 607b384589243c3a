"""Measure whether two signals show the same motion, and how certain this result is (for `check` and
`init`).

Neighbouring values of a smoothed signal are not independent. Therefore each comparison uses the
number of independent values (Bartlett's formula, summed up to the first negative product of the
autocorrelations, after Geyer 1992). A relation is accepted if noise would cause it in at most one
of a thousand recordings. This probability is for all comparisons of a search together (Bonferroni).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from imucald.config.base import MIN_SPEED_DELAY
from imucald.config_check.motion import shifted
from imucald.core.arrays import Array
from imucald.core.rotations import levelling_rotation
from imucald.motion.ticks import TICK_S
from imucald.mount.contradictions import LIKE

FALSE_ALARM = 1e-3
"""Share of recordings in which a search may find a relation by chance."""
MANY = 1000
"""Assumed number of comparisons in a search through all signals of a bus, if the comparisons are
not counted."""
BELIEVED_NATS = math.log(1e3)
"""Log likelihood ratio above which one hypothesis is preferred to another."""
MIN_VALUES = 50
"""Smallest number of common ticks for a comparison: five seconds."""


@dataclass(frozen=True)
class Relation:
    """The relation of a signal to a reference.

    correlation: with sign. independent: number of independent values. low, high: limits of the gain
    (signal divided by reference). One limit is the gain of a least-squares fit of the signal with
    the reference, the other limit is the gain of the reverse fit. With noise, the true gain is
    between both. error: relative standard error of the gain.
    """

    correlation: float = 0.0
    independent: float = 0.0
    low: float = 0.0
    high: float = 0.0
    error: float = math.inf

    @property
    def z(self) -> float:
        """Fisher's z of the correlation, in standard deviations."""
        if self.independent <= 4.0:
            return 0.0
        size = min(abs(self.correlation), 1.0 - 1e-12)
        return math.atanh(size) * math.sqrt(self.independent - 3.0)

    @property
    def is_believed(self) -> bool:
        """True if both signals are certainly related, even if the pair is the best of all signals
        of a bus."""
        return self.is_believed_of(MANY)

    def is_believed_of(self, comparisons: int) -> bool:
        """True if both signals are certainly related, even if the pair is the best of `comparisons`
        pairs."""
        return self.z >= believed_z(comparisons)

    @property
    def is_same_motion(self) -> bool:
        """True if most of the motion in both signals is certainly the same. The daemon uses the
        same criterion."""
        return abs(self.correlation) >= LIKE and self.is_believed_of(1)

    @property
    def gain(self) -> float:
        """Gain: standard deviation of the signal divided by the standard deviation of the
        reference."""
        return math.sqrt(self.low * self.high)

    @property
    def sign(self) -> int:
        """Sign of the correlation: 1 or -1."""
        return -1 if self.correlation < 0.0 else 1

    @property
    def explained(self) -> float:
        """Share of the variance that both signals have in common."""
        return self.correlation * self.correlation


def believed_z(comparisons: int) -> float:
    """Smallest Fisher's z [standard deviations] at which a relation is accepted as the best of
    `comparisons` relations."""
    return NormalDist().inv_cdf(1.0 - 0.5 * FALSE_ALARM / max(comparisons, 1))


def is_better(a: Relation, b: Relation) -> bool:
    """True if one relation is stronger than another beyond chance (Fisher's z, z = 2)."""
    if a.independent <= 4.0 or b.independent <= 4.0:
        return a.z > b.z
    spread = math.sqrt(1.0 / (a.independent - 3.0) + 1.0 / (b.independent - 3.0))
    first, second = (math.atanh(min(abs(r.correlation), 1.0 - 1e-12)) for r in (a, b))
    return first - second > 2.0 * spread


def relation(reference: Array, signal: Array) -> Relation:
    """Compare two signals (n,) at the ticks where both are known."""
    rows = np.isfinite(reference) & np.isfinite(signal)
    if np.count_nonzero(rows) < MIN_VALUES:
        return Relation()
    a = np.where(rows, reference - reference[rows].mean(), 0.0)
    b = np.where(rows, signal - signal[rows].mean(), 0.0)
    aa, bb, ab = float(a @ a), float(b @ b), float(a @ b)
    if not (aa > 0.0 and bb > 0.0):
        return Relation()
    r = ab / math.sqrt(aa * bb)
    n = _independent(a, b, int(np.count_nonzero(rows)))
    if abs(r) < 1e-9:
        return Relation(r, n)
    error = math.sqrt(max(1.0 / (r * r) - 1.0, 0.0) / max(n - 2.0, 1.0))
    return Relation(r, n, abs(ab) / aa, bb / abs(ab), error)


def _independent(a: Array, b: Array, n: int) -> float:
    """Return the number of independent values of two signals. Both signals have mean zero and are
    zero in gaps."""
    size = 1 << (2 * len(a) - 1).bit_length()
    shapes = []
    for x in (a, b):
        power = np.abs(np.fft.rfft(x, size)) ** 2
        auto = np.fft.irfft(power)[: len(a) // 4 + 1]
        shapes.append(auto / auto[0])
    product = shapes[0] * shapes[1]
    below = np.flatnonzero(product[1:] <= 0.0)
    last = int(below[0]) if len(below) else len(product) - 1
    return n / max(1.0 + 2.0 * float(product[1 : last + 1].sum()), 1.0)


LATEST = 2.5
"""Largest delay of the speed at which its scale is judged [s]. Such a delay occurs if a GNSS
receiver smooths its speed, is polled once per second, and its answer waits."""
DELAYS = range(round(MIN_SPEED_DELAY / TICK_S), round(LATEST / TICK_S) + 1)
"""Tried delays of a speed or a course [ticks of 0.1 s]."""
COARSE = 3
"""Step of the first search for the delay [ticks]. The signals are means over a longer time, so
their correlation changes slowly with the delay."""


@dataclass(frozen=True, eq=False)
class Response:
    """The response of the horizontal force, in the axes of the sensor.

    along: (3,) per unit of the change of speed. across: (3,) per unit of speed times yaw rate; zero
    if turns are not known. relation: relation of the force along `along`, without turns, to the
    change of speed. delay: delay of the speed [ticks of 0.1 s].
    """

    along: Array
    across: Array
    relation: Relation
    delay: int

    @property
    def gain(self) -> float:
        """Force along `along` per unit of the change of speed; 1 if both have the right unit."""
        return float(np.linalg.norm(self.along))

    @property
    def forward(self) -> Array:
        """Direction forward: unit vector (3,)."""
        return np.asarray(self.along / self.gain)


def response(
    accel: Array, up: Array, change: Array, others: Array | None = None
) -> Response | None:
    """Fit the horizontal force with the change of speed, at the delay of the speed that explains it
    best. None if too few values are known.

    accel: (n, 3). up: unit vector (3,) in the same axes. change: (n,), in any unit of speed per
    second. others: (n, k), further columns of the fit; the first is speed times yaw rate.
    """
    level = levelling_rotation(up)[:2]
    force = accel @ level.T
    others = np.zeros((len(change), 0)) if others is None else others

    def explained(delay: int) -> float:
        return _fit(force, shifted(change, delay), others)[0]

    at = max(DELAYS[::COARSE], key=explained)
    near = range(max(at - COARSE + 1, DELAYS.start), min(at + COARSE, DELAYS.stop))
    at = max(near, key=explained)
    change = shifted(change, at)
    share, coefficients = _fit(force, change, others)
    if not share > 0.0:
        return None
    along, across = coefficients[0], coefficients[1] if len(coefficients) > 1 else np.zeros(2)
    rest = (force - others @ coefficients[1:]) @ (along / np.linalg.norm(along))
    return Response(along @ level, across @ level, relation(change, rest), at)


def _fit(force: Array, change: Array, others: Array) -> tuple[float, Array]:
    """Fit the horizontal force (n, 2) with the change of speed (n,) and other columns (n, k).

    Returns the share of the force along the vehicle that the change of speed explains, without the
    part of the other columns, and the coefficients (1 + k, 2).
    """
    columns = np.column_stack([change, others])
    rows = np.isfinite(columns).all(axis=1) & np.isfinite(force).all(axis=1)
    if np.count_nonzero(rows) < MIN_VALUES:
        return 0.0, np.zeros((columns.shape[1], 2))
    columns, force = columns[rows], force[rows]
    columns, force = columns - columns.mean(axis=0), force - force.mean(axis=0)
    normal = np.linalg.pinv(columns.T @ columns, hermitian=True)
    coefficients = np.asarray(normal @ (columns.T @ force))
    change, along = columns[:, 0], coefficients[0]
    rest = (force - columns[:, 1:] @ coefficients[1:]) @ along
    sizes = float(rest @ rest) * float(change @ change)
    return float(rest @ change) ** 2 / sizes if sizes > 0.0 else 0.0, coefficients
