"""Log lines of the service about states, link, alarms, the model file and rejected frames."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import asdict

from imucald.can.link.link import LinkEvent, LinkState
from imucald.config import LoadedConfig
from imucald.core.text import counted
from imucald.mount.mount_words import reasons_line
from imucald.runtime.drive_events import StateChanges
from imucald.runtime.engine import Engine
from imucald.runtime.flow import ALARMS, PASSING, STARTING_S, alarms_of
from imucald.runtime.pipeline import Snapshot
from imucald.service.journal import INFO, NOTICE, WARNING, Journal

_QUIET_EVENTS = frozenset({"up", "lost", "conflict", "queue_full", "rejected"})
"""Kinds of link events that are logged with priority INFO. "up" is not a warning, and the link
reports the other kinds at a limited rate."""


def say_idle_keys(loaded: LoadedConfig, journal: Journal) -> None:
    """Log the keys of the configuration that have no effect."""
    for line in loaded.idle_keys():
        journal.say(line, WARNING)


_STATES = frozenset(str(state) for state in LinkState)


class Announcements:
    """Writes one log line for each change of the service."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._alarms: set[str] = set()
        self._states = StateChanges()
        self._untold_event: LinkEvent | None = None
        self._rejected = self._late = 0
        self._failures: dict[str, int] = {}

    def model(self, engine: Engine) -> None:
        """Log which parts of the model file are used, and which are not."""
        preprocessing = engine.preprocessing
        if preprocessing is not None:
            self._journal.say(preprocessing.words())
            for note in preprocessing.notes:
                self._journal.say(f"part of the model that is not used: {note}", NOTICE)

    def link_event(self, event: LinkEvent) -> None:
        """Log an event of the bus link."""
        priority = INFO if event.kind in _QUIET_EVENTS else WARNING
        if event.kind not in _STATES:
            self._journal.say(event.text, priority)
        else:  # an interface may come and go for ever
            is_told = self._journal.seldom("bus", event.text, priority, burst=20)
            self._untold_event = None if is_told else event

    def snapshot(self, snapshot: Snapshot) -> None:
        """Log each change of state in one line, and each change of the reason within a state."""
        estimate = snapshot.estimate
        state, waiting_for = estimate.state.name.lower(), estimate.waiting_for
        event = self._states.note_state(snapshot.t, state, waiting_for)
        if event is None:
            return
        if event.kind == "reason":  # an input may come and go for ever
            self._journal.seldom("reason", event.text, INFO)
            return
        waiting = reasons_line(waiting_for)
        text = f"{state} at {snapshot.t:.1f} s"
        self._journal.say(text + (waiting and f" ({waiting})"), NOTICE)

    def update(self, engine: Engine, late: int, uptime: float) -> None:
        """Log alarms, rejections, late frames and failed calculations; called once a second.

        late: number of late frames so far. uptime: uptime of the process [s].
        """
        self._update_alarms(asdict(engine.health()), uptime)
        event = self._untold_event
        if event is not None and self._journal.is_due("bus"):  # how the bus is after all that
            self.link_event(event)
        rejected = engine.router.rejected
        if (total := rejected.total()) > self._rejected:
            self._rejected = total
            text = ", ".join(f"{reason} {n}" for reason, n in sorted(rejected.items()))
            self._journal.seldom("rejected", f"rejected so far: {text}", WARNING)
        if late > self._late:
            text = f"frames too late to be corrected so far: {late} (the processor was busy)"
            self._journal.seldom("late", text, WARNING)
        self._late = late  # counters of another link begin at zero
        group = engine.consumer_group
        for name, n in group.failures.items():
            if n > self._failures.get(name, 0):
                times = f"failed and was restarted, {counted(n, 'time')} so far"
                text = f"{name} {times}: {group.last_failures[name]}"
                self._journal.seldom(f"{name} failed", text, WARNING)
        self._failures = dict(group.failures)  # counters of another group begin at zero

    def _update_alarms(self, health: Mapping[str, object], uptime: float) -> None:
        """Log each change of a health flag. health: flags by the names of `Health`."""
        if uptime < STARTING_S:
            return
        now = set(alarms_of(health)) - PASSING
        for name in sorted(now - self._alarms):
            self._journal.seldom(f"alarm {name}", ALARMS[name], WARNING)
        for name in sorted(self._alarms - now):
            self._journal.seldom(f"over {name}", f"{ALARMS[name]}: over", NOTICE)
        self._alarms = now
