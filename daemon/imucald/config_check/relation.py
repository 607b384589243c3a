"""How far two signals show the same motion, and how sure that is: for `check` and for `init`.

Neighbouring values of a smoothed signal say the same thing twice. Each comparison therefore counts
with the number of independent values (Bartlett's formula, summed up to the first negative product
of the autocorrelations, after Geyer 1992). It is believed where noise would do the same in one of a
thousand recordings, all comparisons of a search taken together (Bonferroni).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from imucald.core.arrays import Array
from imucald.mount.contradictions import LIKE

FALSE_ALARM = 1e-3
"""Part of the recordings in which a search may find a relation that is chance."""
MANY = 1000
"""Comparisons of a search through all signals of a bus, where they are not counted."""
BELIEVED_NATS = math.log(1e3)
"""Log likelihood ratio from which one hypothesis is believed rather than another."""
MIN_VALUES = 50
"""Ticks in common that a comparison needs: five seconds."""


@dataclass(frozen=True)
class Relation:
    """How a signal follows a reference.

    correlation: with sign. independent: number of independent values. low, high: size of the
    signal for one of the reference: least squares of the signal on the reference, and the other
    way round; noise in either moves the truth between them. error: relative standard error.
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
        """Whether the two are certainly related, found among any signals of a bus."""
        return self.is_believed_of(MANY)

    def is_believed_of(self, comparisons: int) -> bool:
        """Whether the two are certainly related, the best of so many comparisons or not."""
        return self.z >= believed_z(comparisons)

    @property
    def is_same_motion(self) -> bool:
        """Whether the two certainly show the same motion, most of it, as the daemon asks for it."""
        return abs(self.correlation) >= LIKE and self.is_believed_of(1)

    @property
    def gain(self) -> float:
        """Size of the signal for one of the reference: the middle, the ratio of their spreads."""
        return math.sqrt(self.low * self.high)

    @property
    def sign(self) -> int:
        """1 or -1."""
        return -1 if self.correlation < 0.0 else 1

    @property
    def explained(self) -> float:
        """Part of the variance that both share."""
        return self.correlation * self.correlation


def believed_z(comparisons: int) -> float:
    """Fisher's z [standard deviations] from which one of so many comparisons is believed."""
    return NormalDist().inv_cdf(1.0 - 0.5 * FALSE_ALARM / max(comparisons, 1))


def is_better(a: Relation, b: Relation) -> bool:
    """Whether one relation is stronger than another beyond chance (Fisher's z, z = 2)."""
    if a.independent <= 4.0 or b.independent <= 4.0:
        return a.z > b.z
    spread = math.sqrt(1.0 / (a.independent - 3.0) + 1.0 / (b.independent - 3.0))
    first, second = (math.atanh(min(abs(r.correlation), 1.0 - 1e-12)) for r in (a, b))
    return first - second > 2.0 * spread


def relation(reference: Array, signal: Array) -> Relation:
    """Compare two (n,) signals where both are known."""
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
    """Independent values of two zero-filled, centred signals."""
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
