"""Mounts of segments and vehicles with their intervals: as measured, and shrunk towards the
type."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from imucald.core.arrays import Array, Index
from imucald.fleet.analysis.known_drives import KnownDrives, between, turned
from imucald.fleet.analysis.population import Population
from imucald.fleet.analysis.remounts import Remounts, weights
from imucald.fleet.analysis.segments import means
from imucald.fleet.analysis.units import Units, t_quantile

NORMAL_95 = 1.959964
"""Half width of a 95 % interval in standard deviations."""


@dataclass(frozen=True)
class Segments:
    """k segments. rotation: their mounts. V: (k, 3, 3) covariance without the crown [deg^2].
    crown: (k,) its standard deviation [deg]. vehicle: (k,) index of
    the vehicle. first, last: (k,) indices of the first and the last drive.
    """

    rotation: Rotation
    V: Array
    crown: Array
    vehicle: Index
    first: Index
    last: Index

    @property
    def starts(self) -> Index:
        """Each vehicle's first segment."""
        return np.flatnonzero(np.diff(self.vehicle, prepend=-1)).astype(np.int64)

    @property
    def ends(self) -> Index:
        """Each vehicle's last segment."""
        return np.flatnonzero(np.diff(self.vehicle, append=-1)).astype(np.int64)

    def half_width(self) -> Array:
        """Half width of the 95 % interval (k, 3) [deg], including the crown."""
        return interval(np.diagonal(self.V, axis1=1, axis2=2), self.crown)


def interval(variance: Array, crown: Array, quantile: float = NORMAL_95) -> Array:
    """Half width of a 95 % interval (n, 3) [deg]. The crown adds a normally distributed roll,
    whatever the distribution of the rest."""
    wide = quantile**2 * variance
    wide = wide + np.stack([(NORMAL_95 * crown) ** 2, 0.0 * crown, 0.0 * crown], axis=1)
    return np.sqrt(wide)


def segment_mounts(drives: KnownDrives, remounts: Remounts) -> Segments:
    """The mount of each segment: the mean of its drives' rotation vectors relative to the first
    drive."""
    segment = remounts.segment
    first = np.flatnonzero(np.diff(segment, prepend=-1))
    e = between(drives.rotation, drives.rotation[first[segment]])
    W = weights(drives, remounts.D, remounts.scale)
    mean, V = means(e, W, segment, drives.is_after)
    last = np.append(first[1:], len(drives)) - 1
    crown = np.add.reduceat(drives.crown, first) / (last - first + 1)
    rotation = turned(drives.rotation[first], mean)
    return Segments(rotation, V, crown, drives.vehicle[first], first, last)


def first_units(drives: KnownDrives, segments: Segments) -> Units:
    """The first segment of each vehicle: its mount at delivery."""
    s = segments.starts
    return Units(segments.rotation[s], segments.V[s], drives.kind, len(drives.kinds))


@dataclass(frozen=True)
class Shrunk:
    """Present mounts of vehicles. weight: (n, 3) of the vehicle's own data; 1 if it is not shrunk.
    half_width: (n, 3) of the 95 % interval [deg]."""

    rotation: Rotation
    weight: Array
    half_width: Array


def shrink(drives: KnownDrives, segments: Segments, found: Population) -> Shrunk:
    """The best estimate of each vehicle: the mean of its own value and its type's, weighted by
    their variances.

    A sensor that was moved or stands out no longer represents its type, so its measured value is
    kept. The same crown affects its own mean and its type's mean, so it counts once.
    """
    s, kind = segments.ends, drives.kind
    V, T = segments.V[s], found.tau2[kind]
    plain = (segments.starts == s) & ~found.outlier
    prior = found.offset  # offset of the vehicles of a found batch
    e = between(segments.rotation[s], found.centre[kind]) - prior
    wide = V + T[:, :, None] * np.eye(3)
    B = np.where(plain[:, None, None], V @ np.linalg.inv(wide), 0.0)
    shrunk = e - np.einsum("nij,nj->ni", B, e)
    keep = np.eye(3) - B
    of_mean = found.mean_covariance[kind]
    covariance = keep @ V + B @ of_mean @ B.transpose(0, 2, 1)
    rotation = turned(found.centre[kind], shrunk + prior)
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    weight = 1.0 - np.diagonal(B, axis1=1, axis2=2)
    return Shrunk(rotation, weight, interval(variance, segments.crown[s]))


def type_half_width(found: Population, crown: Array) -> Array:
    """Half width of the 95 % interval of each type's mount (kinds, 3) [deg]; crown: (kinds,)."""
    rows = []
    for k, freedom in enumerate(found.freedom):
        variance = np.diagonal(found.mean_covariance[k])[None]
        rows.append(interval(variance, crown[k : k + 1], t_quantile(freedom))[0])
    return np.array(rows).reshape(-1, 3)
