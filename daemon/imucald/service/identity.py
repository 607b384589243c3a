"""The owner of a saved state: the configured vehicle, and the sensor as defined by its signals."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any

from msgspec import to_builtins

from imucald.can.dbc.message import Message, Signal
from imucald.config import LoadedConfig, SourceSettings, TriadSettings
from imucald.core.files import sha256
from imucald.inputs.router import Router
from imucald.inputs.routes import MessageRoute
from imucald.service.saved_state import StateKey

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
