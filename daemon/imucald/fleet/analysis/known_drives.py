"""The drives with a known mount, as arrays."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucald.core.arrays import Array, Index
from imucald.fleet.columns import COVARIANCES
from imucald.mount.estimate import GOOD_NAMES

FLOOR_DEG2 = 1e-4
"""Smallest variance of a drive [deg^2], from a deviation of 0.01 deg. No estimate is more accurate,
even if its stated variance is smaller."""


@dataclass(frozen=True)
class KnownDrives:
    """n drives with a known mount, sorted by vehicle and time.

    rotation: R_vehicle_from_sensor. P: (n, 3, 3) covariance of the rotation-vector error about the
    vehicle's axes [deg^2], without the effect of the road crown. crown: (n,) standard deviation of
    the roll error from the road crown [deg]; this error is the same for all drives on a driving
    side. row: index into the table. vehicle: index into `vehicles`, ascending. kind: index into
    `kinds` (vehicle types), by vehicle. side: driving side. is_after: (n,) True if the drive began
    after the end of all earlier drives of its vehicle. Drives that overlap or have no time have no
    order (False). is_moved: (n,) True if a move of the sensor was found in this drive, or in a
    drive between this drive and the previous drive with a known mount.
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
    is_after: NDArray[np.bool_]
    is_moved: NDArray[np.bool_]

    def __len__(self) -> int:
        """Return the number of drives."""
        return len(self.row)

    @property
    def first(self) -> Index:
        """Index of each vehicle's first drive."""
        return np.flatnonzero(np.diff(self.vehicle, prepend=-1)).astype(np.int64)


def known_drives(columns: Mapping[str, Sequence[Any]], moved: Collection[str] = ()) -> KnownDrives:
    """Read the drives from the table's columns.

    moved: keys of the drives, known or not, in which the sensor was moved.
    """
    state = np.array(columns["state"], dtype=object)
    numbers = np.array(
        [columns[n] for n in ("q_x", "q_y", "q_z", "q_w", *COVARIANCES, "crown_std_deg")],
        dtype=float,
    ).T
    good = np.isin(state, GOOD_NAMES) & np.isfinite(numbers).all(axis=1)
    names = np.array([str(v) for v in columns["vehicle"]], dtype=object)
    begin, end = _times(columns)
    every = np.lexsort((begin, np.unique(names, return_inverse=True)[1]))
    row = every[good[every]]
    numbers = numbers[row]
    vehicles, vehicle = np.unique(names[row], return_inverse=True)
    is_after = _is_after(begin[row], end[row], vehicle)
    shifts = np.cumsum([columns["log_key"][i] in moved for i in every])[good[every]]
    types = np.array([str(t or "unknown") for t in columns["vehicle_type"]], dtype=object)[row]
    kinds, kind_of_drive = np.unique(types, return_inverse=True)
    kind = np.zeros(len(vehicles), dtype=np.int64)
    kind[vehicle] = kind_of_drive  # the last drive's type, if it changes
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
        is_after,
        _is_moved(shifts, is_after, vehicle),
    )


def _times(columns: Mapping[str, Sequence[Any]]) -> tuple[Array, Array]:
    """Return start and end of the drives, as UNIX time [s]. For a logger without a clock, the drive
    is assumed to cover the whole day that the path states. Without a day, the times are infinite.
    """
    begin, end = (np.array(columns[name], dtype=float) for name in ("start", "end"))
    for i in np.flatnonzero(np.isnan(begin)).tolist():
        day = columns["date"][i]
        midnight = datetime.fromisoformat(day).replace(tzinfo=UTC).timestamp() if day else np.inf
        begin[i], end[i] = midnight, midnight + 86_400.0
    return begin, end


def _is_after(begin: Array, end: Array, vehicle: Index) -> NDArray[np.bool_]:
    """Return `KnownDrives.is_after`. The drives must be sorted by vehicle and start time."""
    found = np.ones(len(begin), dtype=np.bool_)
    latest = -np.inf
    for i in range(len(begin)):
        if i == 0 or vehicle[i] != vehicle[i - 1]:
            latest = -np.inf
        else:
            found[i] = latest <= begin[i] < np.inf
        latest = max(latest, end[i])
    return found


def _is_moved(shifts: Index, is_after: NDArray[np.bool_], vehicle: Index) -> NDArray[np.bool_]:
    """Return `KnownDrives.is_moved`. shifts: (n,) number of moves found until the end of each
    drive. If several drives have no order, a move that was found in one of them counts after the
    last of these drives.
    """
    found = np.zeros(len(shifts), dtype=np.bool_)
    before = 0
    for i in range(1, len(shifts)):
        same = vehicle[i] == vehicle[i - 1]
        before = before if same and not is_after[i - 1] else i - 1
        found[i] = bool(same and is_after[i] and shifts[i] > shifts[before])
    return found


def _without_crown(pairs: Array, crown: Array) -> Array:
    """Return covariances (n, 3, 3) from their six elements. The effect of the road crown is
    subtracted, and no variance is below `FLOOR_DEG2`."""
    P = pairs[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3).copy()
    P[:, 0, 0] -= crown**2
    P[:, 0, 2] = P[:, 2, 0] = 0.0  # only the crown correlates roll and yaw
    values, vectors = np.linalg.eigh(P)
    values = np.maximum(values, FLOOR_DEG2)
    return np.asarray((vectors * values[:, None, :]) @ vectors.transpose(0, 2, 1))


def between(one: Rotation, other: Rotation) -> Array:
    """Return the rotation vectors [deg] (n, 3) about the vehicle's axes that rotate `other` to
    `one`."""
    return np.atleast_2d((one * other.inv()).as_rotvec(degrees=True))


def turned(R: Rotation, vector_deg: Array) -> Rotation:
    """Rotate `R` by rotation vectors [deg] about the axes of the vehicle."""
    return Rotation.from_rotvec(vector_deg, degrees=True) * R
