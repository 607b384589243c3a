"""The sensor check of a running engine (attitude has one): kept, repeated, asked for."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from imucald.runtime.consumer import ChecksSensors
from imucald.runtime.engine import Engine


def repeat_check(engine: Engine) -> bool:
    """Repeat it at the next rest; return whether there is one to repeat."""
    found = _checking(engine)
    for consumer in found:
        consumer.check_sensors()
    return bool(found)


def is_checked(engine: Engine) -> bool:
    """Whether it has been made, where there is one."""
    return all(consumer.checked for consumer in _checking(engine))


def saved_check(engine: Engine) -> Mapping[str, Any] | None:
    """What it found, as it is saved: sensor axes, SI; None before it."""
    return next((consumer.saved_check() for consumer in _checking(engine)), None)


def restore_check(engine: Engine, saved: object) -> None:
    """Take what was saved, where it can be believed."""
    for consumer in _checking(engine):
        consumer.restore_check(saved)


def _checking(engine: Engine) -> list[ChecksSensors]:
    """What checks sensors on an engine: attitude, where it is on."""
    return [consumer for consumer in engine.consumers if isinstance(consumer, ChecksSensors)]
