"""The saved state: the estimated mount, and the vehicle and sensor to which the mount belongs."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta, Struct, convert
from msgspec.structs import replace

from imucald.core.files import sha256
from imucald.mount.estimate import GOOD_NAMES
from imucald.service.records import LARGEST_NUMBER, RecordFiles

KIND: Final = "imucald-state"
ROTATION_TOLERANCE: Final = 1e-6
"""Largest accepted difference of a stored matrix from a rotation matrix."""
LARGEST_VARIANCE: Final = 4.0
"""Largest accepted variance of an angle [rad^2]. The variance of an unknown angle is smaller."""
LONGEST_DOUBT: Final = 2000
"""Largest length of the text `doubt`. All existing texts together are shorter."""

Number = Annotated[float, Meta(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
Matrix = Annotated[tuple[Number, ...], Meta(min_length=9, max_length=9)]


class StateKey(Struct, frozen=True):
    """Owner of a saved state: identity of the vehicle, and a hash of the sensor's definition."""

    vehicle: str
    sensor: str

    @property
    def file_name(self) -> str:
        """A valid file name for any identity. Different keys have different file names."""
        readable = re.sub(r"[^A-Za-z0-9_-]+", "_", self.vehicle)[:24]
        digest = sha256(f"{self.vehicle}\0{self.sensor}".encode()).hexdigest()[:16]
        return f"{readable}-{digest}.state"


class SavedState(Struct, frozen=True):
    """Content of a saved state.

    rotation: R_vehicle_from_sensor, nine numbers row by row. covariance: nine numbers [rad^2].
    state: "usable" or "fine". doubted: the mount was suspect when it was saved. saved_at: wall
    clock [s], for people only. driven_s: driving time that the estimate uses [s]. offsets: offsets
    of sensors and signals, SI. shifts: history of remounts, newest last. evidence: numbers about
    the evidence, for people. Its key "sensor" contains the properties of the sensor with which the
    estimator continues (`mount.joint.known`). held: the mount was held, so nothing was learnt.
    given: a person stated the mount. doubt: the reason why the mount was suspect, in words.
    """

    rotation: Matrix
    covariance: Matrix
    state: str
    doubted: bool = False
    saved_at: Number = 0.0
    driven_s: Number = 0.0
    offsets: Mapping[str, Any] = {}
    shifts: tuple[Mapping[str, Any], ...] = ()
    evidence: Mapping[str, Any] = {}
    held: bool = False
    given: bool = False
    doubt: Annotated[str, Meta(max_length=LONGEST_DOUBT)] = ""


class StateStore(RecordFiles[SavedState]):
    """Saves and loads the state of one vehicle and sensor, in two generations."""

    def __init__(self, folder: Path, key: StateKey) -> None:
        owner = {"vehicle": key.vehicle, "sensor": key.sensor}
        super().__init__(folder, key.file_name, KIND, _state_from, owner, (".0", ".1"))

    def encoded(self, generation: int, content: SavedState) -> bytes:
        """Return the bytes of a file. A text `doubt` that is too long is cut, so that the file can
        be read again."""
        return super().encoded(generation, replace(content, doubt=content.doubt[:LONGEST_DOUBT]))


def _state_from(record: Mapping[str, Any]) -> SavedState:
    """Return the state in a record. Raises ValueError if a number or text is not plausible."""
    state = convert(record, SavedState)
    R, C = (np.reshape(numbers, (3, 3)) for numbers in (state.rotation, state.covariance))
    if not np.abs(R @ R.T - np.eye(3)).max() <= ROTATION_TOLERANCE or not np.linalg.det(R) > 0.0:
        raise ValueError("rotation")
    is_symmetric = np.abs(C - C.T).max() <= 1e-12 and np.diag(C).max() <= LARGEST_VARIANCE
    if not is_symmetric or not all(np.linalg.det(C[:n, :n]) > 0.0 for n in (1, 2, 3)):
        raise ValueError("covariance")
    if state.state not in GOOD_NAMES:
        raise ValueError("state")
    if not state.doubt.isprintable():
        raise ValueError("doubt")
    return state
