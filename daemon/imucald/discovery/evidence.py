"""How far two signals show the same motion, and how sure that is.

Neighbouring values of a smoothed signal say the same thing twice. Each comparison therefore counts
with the number of independent values (Bartlett's formula, summed up to the first negative product
of the autocorrelations, after Geyer 1992). It is believed where noise would do the same in one of a
thousand recordings, all comparisons of a search taken together (Bonferroni).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from imucald.core.arrays import Array
from imucald.core.errors import ConfigError
from imucald.inputs.units import find_unit

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
    def gain(self) -> float:
        """Size of the signal for one of the reference: the middle, without sign."""
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


COMMON_UNITS = {
    "acceleration": ("m/s^2", "g", "mg"),
    "angular_rate": ("deg/s", "rad/s"),
    "angle": ("deg", "rad"),
    "speed": ("km/h", "m/s", "mph", "kn"),
    "magnetic_field": ("uT", "mG", "Gs"),
}
"""Units that senders use, the usual one first; others are believed only where they are stated."""


USUAL_COUNTS = {
    "acceleration": ("g", (16384, 8192, 4096, 2048, 1024, 512, 256, 1000, 100)),
    "angular_rate": (
        "deg/s",
        (131, 65.5, 32.8, 16.4, 114.3, 57.1, 28.6, 14.3, 100, 64, 50, 20, 10),
    ),
}
"""Counts for one of a unit, of the ranges of usual sensors (MPU-6050, LSM6, BMI, ...), the usual
ones first."""


def in_counts(dimension: str, low: float, high: float) -> UnitChoice:
    """The unit of raw counts whose SI value lies in [low, high]: a usual scale, else the middle."""
    name, usual = USUAL_COUNTS[dimension]
    one = find_unit(name, dimension).factor
    fitting = [n for n in usual if low <= one / n <= high]
    counts, *others = fitting or [float(f"{one / math.sqrt(low * high):.3g}")]
    names = tuple(f"{name}/{n:.6g}" for n in others)
    return UnitChoice(f"{name}/{counts:.6g}", one / counts, False, names, is_counts=True)


@dataclass(frozen=True)
class UnitChoice:
    """A unit and whether the database states it.

    others: units that would fit as well. is_counts: raw counts, whose scale the data show.
    """

    name: str
    factor: float
    is_stated: bool
    others: tuple[str, ...] = ()
    is_counts: bool = False

    @property
    def is_sure(self) -> bool:
        """Whether no other unit fits."""
        return self.is_stated or not self.others


def factor_of(text: str, dimension: str) -> float | None:
    """SI value of one of a unit; None where the text names no unit of the dimension."""
    try:
        return find_unit(text, dimension).factor if text.strip() else None
    except ConfigError:
        return None


def choose_unit(
    stated: str, dimension: str, low: float, high: float, names: Sequence[str] = ()
) -> UnitChoice | None:
    """The unit whose SI value lies in [low, high]; the stated one where it does."""
    factor = factor_of(stated, dimension)
    if factor is not None and low <= factor <= high:
        return UnitChoice(stated, factor, True)
    middle = math.log(math.sqrt(low * high))
    fitting = []
    for name in names or COMMON_UNITS[dimension]:
        size = find_unit(name, dimension).factor
        if low <= size <= high:
            fitting.append((abs(math.log(size) - middle), name, size))
    if not fitting:
        return None
    fitting.sort()
    _, name, size = fitting[0]
    return UnitChoice(name, size, False, tuple(other for _, other, _ in fitting[1:]))
