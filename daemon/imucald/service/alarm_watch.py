"""Reports when an alarm begins and when it is over, a line each, and never in floods."""

from __future__ import annotations

from collections.abc import Mapping

from imucald.runtime.alarms import ALARMS, PASSING, alarms_of
from imucald.service.journal import NOTICE, WARNING, Journal

START_S = 2.0
"""Before that much of a run [s] inputs are not missed."""


class AlarmWatch:
    """Looks at the health once a second."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._on: set[str] = set()

    def update(self, health: Mapping[str, object], uptime: float) -> None:
        """health: flags by the names of `Health`. uptime: of the process [s]."""
        if uptime < START_S:
            return
        now = set(alarms_of(health)) - PASSING
        for name in sorted(now - self._on):
            self._journal.seldom(f"alarm {name}", ALARMS[name], WARNING)
        for name in sorted(self._on - now):
            self._journal.seldom(f"over {name}", f"{ALARMS[name]}: over", NOTICE)
        self._on = now
