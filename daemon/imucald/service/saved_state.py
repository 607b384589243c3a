"""The saved state: the estimated mount, and the vehicle and sensor to which the mount belongs."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
from msgspec import Meta, Struct, convert, to_builtins
from msgspec.structs import replace

from imucald.can.dbc.message import Message, Signal
from imucald.config import LoadedConfig, SourceSettings, TriadSettings
from imucald.core.files import sha256
from imucald.inputs.router import Router
from imucald.inputs.routes import MessageRoute
from imucald.mount.estimate import GOOD_NAMES
from imucald.service.records import LARGEST_NUMBER, RecordFiles

KIND: Final = "imucald-state"
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
    if not np.abs(R @ R.T - np.eye(3)).max() <= 1e-6 or not np.linalg.det(R) > 0.0:
        raise ValueError("rotation")
    # the variance of an unknown angle is below 4 rad^2
    is_sound = np.abs(C - C.T).max() <= 1e-12 and np.diag(C).max() <= 4.0
    if not is_sound or not all(np.linalg.det(C[:n, :n]) > 0.0 for n in (1, 2, 3)):
        raise ValueError("covariance")
    if state.state not in GOOD_NAMES:
        raise ValueError("state")
    if not state.doubt.isprintable():
        raise ValueError("doubt")
    return state


_DECISIVE = frozenset({"signal", "raw", "unit", "sign", "offset"})
"""Keys of a configured source that change the values of its signal."""


def state_key(loaded: LoadedConfig, router: Router, model: str = "") -> StateKey:
    """Return the key of the saved state that belongs to a configuration. The key contains only
    settings that turn the accelerometer's axes or select another sensor. These settings are the
    accelerometer's sources with identifiers, layout, units and signs, the signal effects that a
    model file removes (`model`, see `Engine.model_key`), and the mount that the configuration
    states. Ids of outputs, speed sources and limits are not in the key.
    """
    described = _triads(loaded.config.signals.accelerometer, router)
    text = json.dumps(described, sort_keys=True, default=str) + model
    if (mount := loaded.config.calibration.mount) is not None:
        text += json.dumps(to_builtins(mount), sort_keys=True)
    return StateKey(loaded.config.vehicle.id, sha256(text.encode()).hexdigest())


def _triads(triads: Sequence[TriadSettings], router: Router) -> list[list[dict[str, Any]]]:
    return [
        [_described(source, router) for source in (triad.x, triad.y, triad.z) if source is not None]
        for triad in triads
    ]


def _described(source: SourceSettings, router: Router) -> dict[str, Any]:
    """Return all properties of a source that determine the values of its signal."""
    found: dict[str, Any] = {
        "configured": {k: v for k, v in to_builtins(source).items() if k in _DECISIVE}
    }
    for message, signal in _found(source.signal, router):
        found["id"] = message.can_id
        found["layout"] = [signal.start, signal.length, signal.byte_order]
        found["number"] = [signal.is_signed, signal.is_float, signal.scale, signal.offset]
        found["unit"] = signal.unit
    for message, signal in _found(source.sign_signal, router):
        found["sign"] = [message.can_id, signal.start, signal.byte_order]
    return found


def _found(path: str | None, router: Router) -> Iterator[tuple[Message, Signal]]:
    """Yield message and signal of the path ``MESSAGE.SIGNAL``, once for each route that reads the
    message."""
    name, _, signal = (path or "").partition(".")
    for route in router.routes:
        if isinstance(route, MessageRoute) and route.name == name:
            yield route.plan.message, route.plan.message.signals[signal]
