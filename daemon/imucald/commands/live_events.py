"""Find events of a watched daemon by comparing successive statuses."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from imucald.core.errors import LinkError
from imucald.core.text import without_numbers
from imucald.runtime.drive_events import StateChanges, reported_events
from imucald.runtime.flow import ALARMS, present_alarms
from imucald.runtime.timebase import FORWARD_STEP
from imucald.service.asking import ask, content

KEPT = 200


@dataclass(frozen=True)
class LiveEvent:
    """An event. at: wall clock [s]. kind: state, reason, moved, fault, sensor, bus, alarm or log.

    text: readable description.
    """

    at: float
    kind: str
    text: str

    @property
    def clock(self) -> str:
        """Time of day."""
        return time.strftime("%H:%M:%S", time.localtime(self.at))


class LiveEvents:
    """Collects events in `events`, oldest first.

    A new event may have an earlier time than collected events, because a reason is reported only
    after it has lasted for some time. Events from before the start of the monitor are shown too,
    with the time of the daemon's clock.
    """

    def __init__(self) -> None:
        self.events: deque[LiveEvent] = deque(maxlen=KEPT)
        self._states = StateChanges()
        self._state: str | None = None
        self._link: str | None = None
        self._alarms: frozenset[str] = frozenset()
        self._has_log = False
        self._listed: dict[tuple[float, str, str], LiveEvent] = {}

    def remember(self, logged: Sequence[Mapping[str, Any]]) -> None:
        """Add earlier events of the daemon, in the form of `imucald events`."""
        self.events.extend(LiveEvent(e["at"], _kind(e), e["text"]) for e in logged)
        self._has_log = bool(logged)

    def update(self, status: Mapping[str, Any], now: float) -> None:
        """Process a status at wall clock `now` [s]."""
        # stream time stops in a long silence; an older daemon does not state it
        stood = max(0.0, float(status.get("silent_s", 0.0)) - FORWARD_STEP)
        began = now - stood - float(status["duration_s"])
        first = self._state is None
        found = []
        for event in reported_events(status):
            is_change = event.kind in ("moved", "evidence")  # which one is known later
            name = "" if is_change else without_numbers(event.text.partition(",")[0])
            key = event.t, "moved" if is_change else event.kind, name
            before = self._listed.get(key)
            if before is None:
                self._listed[key] = LiveEvent(began + event.t, event.kind, event.text)
                found.append(self._listed[key])
            elif before.text != event.text:  # more is known now
                self._listed[key] = replace(before, kind=event.kind, text=event.text)
                same = [self._listed[key] if e is before else e for e in self.events]
                self.events = deque(same, maxlen=KEPT)
        if (
            first and not self._has_log and status["state"] != "restored"
        ):  # not confirmed, and active
            found += [
                LiveEvent(began + status[f"first_{name}_s"], "state", f"{name} for the first time")
                for name in ("usable", "fine")
                if status[f"first_{name}_s"] is not None
            ]
        self.events.extend(found)
        self._changes(status, now)
        self.events = deque(sorted(self.events, key=lambda event: event.at), maxlen=KEPT)

    def _changes(self, status: Mapping[str, Any], now: float) -> None:
        state, link = str(status["state"]), str(status["link"]["state"])
        event = self._states.note_state(now, state, status["waiting_for"])
        if event is not None and not (self._state is None and self._has_log):
            self.events.append(LiveEvent(event.t, event.kind, event.text))
        if self._link is not None and link != self._link:
            self.events.append(LiveEvent(now, "bus", f"{status['link']['channel']} is {link}"))
        alarms = frozenset(present_alarms(status))
        if self._state is None and self._has_log:
            self._alarms = alarms  # they are in the log
        elif self._state is None and not status["signals"]:
            alarms = frozenset()  # no frame yet is not an event
        for flag in sorted(alarms - self._alarms):
            self.events.append(LiveEvent(now, "alarm", ALARMS[flag]))
        for flag in sorted(self._alarms - alarms):
            self.events.append(LiveEvent(now, "alarm", f"{ALARMS[flag]}: over"))
        self._state, self._link, self._alarms = state, link, alarms


def logged_events(path: Path) -> list[dict[str, Any]]:
    """Return the logged events of the daemon at a status socket; empty if the daemon does not
    answer."""
    try:
        found: list[dict[str, Any]] = content(path, "events", ask(path, "events"))["events"]
    except LinkError:
        return []
    return found


def _kind(logged: Mapping[str, Any]) -> str:
    return "alarm" if logged["level"] in ("error", "warning") else "log"
