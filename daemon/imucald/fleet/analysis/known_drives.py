"""The drives that can be read together, as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucald.core.arrays import Array

Index = NDArray[np.int64]

KNOWN = ("usable", "fine")
"""States of drives whose mount counts: the others say that it is not known, or moving."""
FLOOR_DEG2 = 1e-4
"""Least variance of a drive [deg^2], 0.01 deg: no estimate is better, whatever it says."""


@dataclass(frozen=True)
class KnownDrives:
    """n drives with a known mount, sorted by vehicle and time.

    rotation: R_vehicle_from_sensor. P: (n, 3, 3) covariance of the rotation-vector error about the
    vehicle's axes [deg^2] without the road crown's part. crown: (n,) standard deviation of that
    part [deg], a roll, common to a driving side. row: index into the table. vehicle: index into
    `vehicles`, ascending. kind: index into `kinds` (vehicle types), by vehicle. side: driving side.
    """

    rotation: Rotation
    P: Array
    crown: Array
    side: Sequence[str]
    row: Index
    vehicle: Index
    vehicles: Sequence[str]
    kind: Index
    kinds: Sequence[str]

    def __len__(self) -> int:
        """Return the number of drives."""
        return len(self.row)

    @property
    def first(self) -> Index:
        """Index of each vehicle's first drive."""
        return np.flatnonzero(np.diff(self.vehicle, prepend=-1)).astype(np.int64)


def known_drives(columns: Mapping[str, Sequence[object]]) -> KnownDrives:
    """Take the drives out of the table's columns (in its order: by vehicle and time)."""
    state = np.array(columns["state"], dtype=object)
    numbers = np.array(
        [columns[n] for n in ("q_x", "q_y", "q_z", "q_w", *_COVARIANCE, "crown_std_deg")],
        dtype=float,
    ).T
    good = np.isin(state, KNOWN) & np.isfinite(numbers).all(axis=1)
    names = np.array([str(v) for v in columns["vehicle"]], dtype=object)
    row = np.flatnonzero(good)
    row = row[np.argsort(names[row], kind="stable")]
    numbers = numbers[row]
    vehicles, vehicle = np.unique(names[row], return_inverse=True)
    types = np.array([str(t or "unknown") for t in columns["vehicle_type"]], dtype=object)[row]
    kinds, kind_of_drive = np.unique(types, return_inverse=True)
    kind = np.zeros(len(vehicles), dtype=np.int64)
    kind[vehicle] = kind_of_drive  # the last drive's, should it change
    crown = numbers[:, 10]
    return KnownDrives(
        Rotation.from_quat(numbers[:, :4]) if len(row) else Rotation.identity(0),
        _without_crown(numbers[:, 4:10], crown),
        crown,
        [str(s) for s in np.array(columns["driving_side"], dtype=object)[row]],
        row,
        vehicle.astype(np.int64),
        [str(v) for v in vehicles],
        kind,
        [str(k) for k in kinds],
    )


_COVARIANCE = tuple(f"cov_{pair}_deg2" for pair in ("xx", "xy", "xz", "yy", "yz", "zz"))


def _without_crown(pairs: Array, crown: Array) -> Array:
    """Covariances (n, 3, 3) from their six numbers, less the crown's; never below the floor."""
    P = pairs[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).copy()
    P[:, 0, 0] -= crown**2
    P[:, 0, 2] = P[:, 2, 0] = 0.0  # it alone makes roll and yaw go together
    values, vectors = np.linalg.eigh(P)
    values = np.maximum(values, FLOOR_DEG2)
    return np.asarray((vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1))


def between(one: Rotation, other: Rotation) -> Array:
    """Rotation vectors [deg] (n, 3) about the vehicle's axes that turn `other` into `one`."""
    return np.atleast_2d((one * other.inv()).as_rotvec(degrees=True))


def turned(R: Rotation, vector_deg: Array) -> Rotation:
    """Rotations turned by rotation vectors [deg] about the vehicle's axes."""
    return Rotation.from_rotvec(vector_deg, degrees=True) * R
