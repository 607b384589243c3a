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

from imucald.core.arrays import Array
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
