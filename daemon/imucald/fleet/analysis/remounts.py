"""Find remounts between drives, over all vehicles, with a controlled false-discovery rate."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control

from imucald.core.arrays import Array, Index
from imucald.fleet.analysis.components import VarianceComponent, between_drives, robust_variance
from imucald.fleet.analysis.known_drives import KnownDrives, between
from imucald.fleet.analysis.segments import candidates, means
from imucald.fleet.analysis.units import MAX_Q

ROUNDS = 3
LEAST_PAIRS = 3
"""Smallest number of pairs of successive drives (`_pairs`) for estimating the variance D between
drives. The first estimate of D is a median over these pairs. With fewer pairs, a single remount
would dominate the median and look like the normal scatter of drives."""
OWN_FREEDOM = 20
"""If the variance D between drives has fewer degrees of freedom in a type, the type uses the D of
all types together.
"""
FREEDOMS = (5.0, 6.0, 8.0, 10.0, 14.0, 20.0, 30.0)
"""Tried degrees of freedom of the null distribution. A few hundred pairs of drives cannot separate
a t distribution with 30 degrees of freedom from a normal distribution, but the difference matters
at thresholds of p = 0.002. Therefore normal tails are never assumed. Chosen on simulated fleets
(seeds from 1000) by `python -m benchmarks.fleet --only statistics`."""


@dataclass(frozen=True)
class Remounts:
    """The k candidates for remounts.

    drive: index of the first drive after the remount. turn: (k, 3) rotation vector of the remount
    [deg]. p, q: p-value and false-discovery rate. D: (kinds, 3) variance between drives [deg^2].
    components: variance components by type and axis. scale: ratio of true variances to stated
    variances. segment: (n,) segment of each drive, ascending over all vehicles. A segment that
    begins at a move found within a drive is no candidate.
    """

    drive: Index
    turn: Array
    p: Array
    q: Array
    D: Array
    components: list[list[VarianceComponent]]
    scale: float
    segment: Index

    @property
    def found(self) -> NDArray[np.bool_]:
        """Mask (k,) of the candidates that are remounts."""
        return self.q <= MAX_Q


def find_remounts(drives: KnownDrives) -> Remounts:
    """Find remounts in all vehicles.

    The variance D between drives is estimated from drives without a remount between them."""
    e = between(drives.rotation, drives.rotation[drives.first[drives.vehicle]])
    D = np.tile(_first_D(e, drives), (len(drives.kinds), 1))
    components: list[list[VarianceComponent]] = []
    found, null = None, Null()
    for _ in range(ROUNDS):
        found = _cuts(e, drives, D, null)
        null = _null(e, drives, D, found.drive[found.found])
        components = _components(e, drives, found.segment)
        D = np.array([[axis.value for axis in kind] for kind in components]).reshape(-1, 3)
    assert found is not None
    return replace(found, D=D, components=components)


def _pairs(drives: KnownDrives) -> Index:
    """Return the index of each drive that follows another drive of the same vehicle, without a move
    of the sensor found in between."""
    same = np.diff(drives.vehicle, prepend=-1) == 0
    return np.flatnonzero(same & drives.is_after & ~drives.is_moved).astype(np.int64)


def _first_D(e: Array, drives: KnownDrives) -> Array:
    """Return a first estimate of the variance D between drives, from the median of the differences
    between successive drives. Remounts change a median only little."""
    after = _pairs(drives)
    squares = (e[after] - e[after - 1]) ** 2
    P = np.diagonal(drives.P, axis1=1, axis2=2)
    known = P[after] + P[after - 1]
    return np.array([robust_variance(squares[:, a] / 2, known[:, a] / 2) for a in range(3)])


def weights(drives: KnownDrives, D: Array, scale: float = 1.0) -> Array:
    """Return the inverse covariances (n, 3, 3) of the deviation of single drives from the mount of
    their vehicle [1/deg^2]."""
    V = drives.P + D[drives.kind[drives.vehicle]][:, :, None] * np.eye(3)
    return np.asarray(np.linalg.inv(scale * V))


@dataclass(frozen=True)
class Null:
    """Empirical null distribution of the squared difference between two single drives without a
    remount.

    square / (3 * scale) has an F distribution with 3 and `freedom` degrees of freedom. The stated
    deviations are right on average, but the distribution has heavier tails than the normal
    distribution.
    """

    scale: float = 1.0
    freedom: float = 1000.0

    @property
    def widening(self) -> float:
        """Ratio of true variances to stated variances, never below 1."""
        return max(1.0, self.scale * self.freedom / (self.freedom - 2.0))

    def p(self, squares: Array, before: Index, after: Index) -> Array:
        """Return the p-values of squared differences between two means. before, after: number of
        drives in each mean.

        The distribution of a mean is closer to normal than the distribution of a single drive: its
        fourth cumulant is proportional to 1 / n^3.
        """
        a, b = 1.0 / before, 1.0 / after
        share = (a**3 + b**3) / (a + b) ** 2 / 0.5
        freedom = 4.0 + (self.freedom - 4.0) / share
        return np.asarray(f_distribution.sf(squares * freedom / (freedom - 2.0) / 3.0, 3, freedom))


def _null(e: Array, drives: KnownDrives, D: Array, cuts: Index) -> Null:
    """Fit the null distribution to the differences of successive drives (maximum likelihood). Found
    remounts are left out."""
    after = np.setdiff1d(_pairs(drives), cuts)
    if len(after) < OWN_FREEDOM:
        return Null()
    V = np.linalg.inv(weights(drives, D))
    d = e[after] - e[after - 1]
    squares = np.einsum(
        "ni,ni->n", d, np.linalg.solve(V[after] + V[after - 1], d[:, :, None])[..., 0]
    )
    best, found = -np.inf, Null()
    for freedom in FREEDOMS:
        for scale in np.geomspace(0.4, 4.0, 24):
            x = squares / (3.0 * scale)
            likely = float(f_distribution.logpdf(np.maximum(x, 1e-9), 3, freedom).sum())
            likely -= len(x) * np.log(scale)
            if likely > best:
                best, found = likely, Null(float(scale), freedom)
    return found


def _cuts(e: Array, drives: KnownDrives, D: Array, null: Null) -> Remounts:
    W = weights(drives, D, null.widening)
    moved = np.flatnonzero(drives.is_moved).astype(np.int64)
    bounds = [*np.union1d(drives.first, moved).tolist(), len(drives)]
    cuts = [
        start + cut
        for start, stop in pairwise(bounds)
        for cut in candidates(e[start:stop], W[start:stop], drives.is_after[start:stop])
    ]
    drive = np.array(cuts, dtype=np.int64)
    segment = _segments(drives, np.union1d(drive, moved))
    mean, covariance = means(e, W, segment, drives.is_after)
    after = segment[drive]
    turn = mean[after] - mean[after - 1]
    spread = covariance[after] + covariance[after - 1]
    squares = np.einsum("ki,ki->k", turn, np.linalg.solve(spread, turn[:, :, None])[..., 0])
    count = np.bincount(segment)
    p = null.p(squares, count[after - 1], count[after])
    # each pair of successive drives is a hypothesis; pairs that are no candidates have p = 1
    padded = np.ones(max(len(_pairs(drives)), len(p)))
    padded[: len(p)] = p
    q = false_discovery_control(padded)[: len(p)] if len(padded) else p
    segment = _segments(drives, np.union1d(drive[q <= MAX_Q], moved))
    return Remounts(drive, turn, p, q, D, [], null.widening, segment)


def _segments(drives: KnownDrives, cuts: Index) -> Index:
    """Return the segment index of each drive, ascending. A new segment starts at each vehicle and
    at each cut."""
    begins = np.zeros(len(drives), dtype=np.int64)
    begins[drives.first] = 1
    begins[cuts] = 1
    return np.asarray(np.cumsum(begins) - 1, dtype=np.int64)


def _components(e: Array, drives: KnownDrives, segment: Index) -> list[list[VarianceComponent]]:
    """Return the variance D between drives by type and axis.

    A type with too little data gets the D of all types together. Segments that contain drives
    without an order are left out, because a remount may be hidden in them.
    """
    use = ~np.isin(segment, segment[~drives.is_after])
    e, segment, kind = e[use], segment[use], drives.kind[drives.vehicle][use]
    P = np.diagonal(drives.P, axis1=1, axis2=2)[use]
    pooled = [between_drives(e[:, a], P[:, a], segment) for a in range(3)]
    found = []
    for k in range(len(drives.kinds)):
        mine = kind == k
        own = [between_drives(e[mine, a], P[mine, a], segment[mine]) for a in range(3)]
        found.append(own if own[0].freedom >= OWN_FREEDOM else pooled)
    return found
