"""The events of a watched daemon: its log, and the moves and faults that its status lists."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imucald.core.errors import LinkError
from imucald.runtime.drive_events import reported_events
from imucald.runtime.timebase import FORWARD_STEP
from imucald.service.asking import ask, content


@dataclass(frozen=True)
class LiveEvent:
    """An event. at: wall clock [s]. kind: moved, evidence, fault, sensor, alarm or log.

    text: readable description.
    """

    at: float
    kind: str
    text: str

    @property
    def clock(self) -> str:
        """Time of day."""
        return time.strftime("%H:%M:%S", time.localtime(self.at))


def live_events(
    status: Mapping[str, Any], now: float, logged: Sequence[Mapping[str, Any]]
) -> list[LiveEvent]:
    """Return the events, oldest first. now: wall clock of the status [s]. logged: the log, as
    `imucald events` shows it."""
    # stream time stops in a long silence; an older daemon does not state it
    stood = max(0.0, float(status.get("silent_s", 0.0)) - FORWARD_STEP)
    began = now - stood - float(status["duration_s"])
    found = [LiveEvent(e["at"], _kind(e), e["text"]) for e in logged]
    found += [LiveEvent(began + e.t, e.kind, e.text) for e in reported_events(status)]
    return sorted(found, key=lambda event: event.at)


def asked_events(path: Path) -> list[dict[str, Any]]:
    """Return the log of the daemon at a status socket; empty if the daemon does not answer."""
    try:
        found: list[dict[str, Any]] = content(path, "events", ask(path, "events"))["events"]
    except LinkError:
        return []
    return found


def _kind(logged: Mapping[str, Any]) -> str:
    return "alarm" if logged["level"] in ("error", "warning") else "log"
