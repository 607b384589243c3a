"""Mounts of segments and vehicles with their intervals: measured mounts, and mounts shrunk towards
the mean of the vehicle type."""

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
    """k segments. rotation: mounts of the segments. V: (k, 3, 3) covariance without the road crown
    [deg^2]. crown: (k,) standard deviation of the roll error from the road crown [deg]. vehicle:
    (k,) index of
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
        """Index of the first segment of each vehicle."""
        return np.flatnonzero(np.diff(self.vehicle, prepend=-1)).astype(np.int64)

    @property
    def ends(self) -> Index:
        """Index of the last segment of each vehicle."""
        return np.flatnonzero(np.diff(self.vehicle, append=-1)).astype(np.int64)

    def half_width(self) -> Array:
        """Half width of the 95 % interval (k, 3) [deg], including the error from the road crown."""
        return interval(np.diagonal(self.V, axis1=1, axis2=2), self.crown)


def interval(variance: Array, crown: Array, quantile: float = NORMAL_95) -> Array:
    """Return the half width of the 95 % interval (n, 3) [deg]. The error from the road crown is a
    normally distributed roll, for any distribution of the other errors."""
    wide = quantile**2 * variance
    wide = wide + np.stack([(NORMAL_95 * crown) ** 2, 0.0 * crown, 0.0 * crown], axis=1)
    return np.sqrt(wide)


def segment_mounts(drives: KnownDrives, remounts: Remounts) -> Segments:
    """Return the mount of each segment: the mean of the rotation vectors of its drives. The
    rotation vectors are relative to the first drive of the vehicle."""
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
    """Return the first segment of each vehicle: the mount at delivery."""
    s = segments.starts
    return Units(segments.rotation[s], segments.V[s], drives.kind, len(drives.kinds))


@dataclass(frozen=True)
class Shrunk:
    """Present mounts of vehicles. weight: (n, 3) weight of the vehicle's own data; 1 if the mount
    is not shrunk. half_width: (n, 3) half width of the 95 % interval [deg]."""

    rotation: Rotation
    weight: Array
    half_width: Array


def shrink(drives: KnownDrives, segments: Segments, found: Population) -> Shrunk:
    """Return the best estimate of each vehicle's mount: the mean of its measured mount and the
    mount of its type, weighted by the inverse variances.

    If the sensor was moved or the vehicle is an outlier, the measured mount is not changed, because
    the sensor does not represent its type. The error from the road crown is the same in both
    mounts, so it is added only once.
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
    """Return the half width of the 95 % interval of the mount of each type (kinds, 3) [deg]. crown:
    (kinds,) standard deviation of the roll error from the road crown [deg]."""
    rows = []
    for k, freedom in enumerate(found.freedom):
        variance = np.diagonal(found.mean_covariance[k])[None]
        rows.append(interval(variance, crown[k : k + 1], t_quantile(freedom))[0])
    return np.array(rows).reshape(-1, 3)
