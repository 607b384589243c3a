"""List of the events of a drive: changes of state, moves of the sensor, faults, holes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from imucald.core.text import without_numbers
from imucald.mount.contradictions import WORDS
from imucald.mount.mount_words import change_words, contradicted_words, is_move, reasons_line

STATE_WORDS: Mapping[str, str] = {
    "waiting": "nothing is known yet",
    "levelled": "roll and pitch are known roughly; corrected frames say 'not available'",
    "usable": "corrected frames are marked usable",
    "fine": "every axis is within its target",
    "suspect": "the drive contradicts the mount, or signals contradict each other",
    "recalibrating": "after a move or a contradiction, the mount is being determined again",
    "restored": "a saved or stated mount is in use; this drive has not confirmed it yet",
}


REASON_STANDS_S = 12.8
"""Shortest duration of a reason that is reported [s]: two evaluations of the mount. A reason that
disappears at the next evaluation is not useful for a reader.
"""


@dataclass(frozen=True)
class Event:
    """An event of a drive. t: stream time [s]. kind: state, reason, moved, fault, sensor or gap.
    text: text for people.
    """

    t: float
    kind: str
    text: str


class StateChanges:
    """Finds changes of the mount's state, and changes of the reason within a state. A new reason is
    reported after it has lasted for `REASON_STANDS_S`. A change of numbers in a reason's text does
    not count as a change.
    """

    def __init__(self) -> None:
        self._state: str | None = None
        self._shown = self._newest = self._text = ""
        self._since = 0.0

    def note_state(self, t: float, state: str, waiting_for: Mapping[str, str]) -> Event | None:
        """Process the state and the missing evidence at time t [s]. Return the new event, if
        any."""
        waiting = reasons_line(waiting_for)
        reason = without_numbers(waiting)
        if reason != self._newest:
            self._newest, self._since, self._text = reason, t, waiting
        before, self._state = self._state, state
        if state != before:
            self._shown = reason
            text = f"{state}: {STATE_WORDS.get(state, '')}"
            return Event(t, "state", text + (f"; {waiting}" if waiting else ""))
        if reason == self._shown or t - self._since < REASON_STANDS_S:
            return None
        self._shown = reason
        return Event(self._since, "reason", self._text) if reason else None


def state_changes(states: Iterable[tuple[float, str, Mapping[str, str]]]) -> Iterator[Event]:
    """Yield the events of a series of times [s], states and missing evidence."""
    changes = StateChanges()
    yield from filter(None, (changes.note_state(*one) for one in states))


def reported_events(result: Mapping[str, Any], gaps: Sequence[float] = ()) -> Iterator[Event]:
    """Yield the events in a result or a daemon's status: moved sensors, faults, sensor health and
    gaps.
    """
    details = result.get("details", {})
    for shift in details.get("shifts", ()):
        kind = "moved" if is_move(shift) else "evidence"
        yield Event(float(shift["t"]), kind, change_words(shift))
    for fault in details.get("faults", ()):
        yield Event(float(fault["t"]), "fault", _fault_words(str(fault["fault"])))
    restored = details.get("restored") or {}
    if (wrong := restored.get("contradicted")) is not None:
        text = contradicted_words(wrong["turned_deg"], restored["given"])
        yield Event(float(wrong["t"]), "fault", text)
    for one in result.get("signal_health", {}).get("events", ()):
        axes = f" ({', '.join(one['axes'])})" if one.get("axes") else ""
        text = f"{one['sensor']} {one['fault']}{axes}"
        if one.get("until_s") is not None:
            text += f", for {one['until_s'] - one['since_s']:.0f} s"
        yield Event(float(one["since_s"]), "sensor", text)
    for t in gaps:
        yield Event(t, "gap", "the clock jumped, or no frame came for more than 10 s")


def _fault_words(name: str) -> str:
    known = {fault.value: words for fault, words in WORDS.items()}
    return known.get(name, name.replace("_", " "))


def in_order(events: Iterable[Event]) -> list[Event]:
    """Return events sorted by time; events of the same time keep their order."""
    return sorted(events, key=lambda event: event.t)
