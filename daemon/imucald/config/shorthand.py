"""Short forms of the configuration, spelled out before it is checked.

A text may stand for a source (``MESSAGE.SIGNAL``), a database or a model file (its path), and one
entry where a list is expected. What has neither form is left as it is for the check to refuse.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from imucald.config.signals import MESSAGE_SIGNAL

SHORT_TEXTS: dict[str, dict[str, Any]] = {
    "SourceSettings": {"type": "string", "pattern": MESSAGE_SIGNAL},
    "DatabaseSettings": {"type": "string"},
    "ModelFile": {"type": "string"},
}
"""JSON schema of the text that may stand for settings of this class."""
ONE_OF_LIST = frozenset({"SourceSettings", "DatabaseSettings", "TriadSettings"})
"""Settings of which a single one may stand where a list is expected."""
_TRIADS = frozenset({"accelerometer", "gyroscope", "magnetometer"})
_AXES = frozenset({"x", "y", "z"})


def spelled_out(data: dict[Any, Any]) -> dict[Any, Any]:
    """Return a configuration's data with all short forms in full; the argument stays as it is."""
    found = dict(data)
    if "database" in found:
        found["database"] = _each(found["database"], lambda one: _long(one, "path"))
    if "model" in found:
        found["model"] = _long(found["model"], "path")
    signals = found.get("signals")
    if isinstance(signals, dict):
        found["signals"] = {key: _signal(key, value) for key, value in signals.items()}
    return found


def _signal(key: Any, value: Any) -> Any:
    if key in _TRIADS:
        return _each(value, _axes)
    if key == "wheel_speeds":
        return {k: _source(v) for k, v in value.items()} if isinstance(value, dict) else value
    if key == "parallel":
        return [_axes(sensor) for sensor in value] if isinstance(value, list) else value
    return _each(value, _source)


def _each(value: Any, spell: Callable[[Any], Any]) -> Any:
    if value is None:
        return None
    return [spell(one) for one in (value if isinstance(value, list) else [value])]


def _axes(value: Any) -> Any:
    if not isinstance(value, dict):
        return value
    return {key: _source(one) if key in _AXES else one for key, one in value.items()}


def _source(value: Any) -> Any:
    return _long(value, "signal")


def _long(value: Any, key: str) -> Any:
    return {key: value} if isinstance(value, str) else value
