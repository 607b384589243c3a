"""For how long a fault is believed that was seen, and which faults were reported."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from typing import Any

from msgspec import Struct

from imucald.motion.signal_health import SignalFault

SOUND_S = 10.0
"""A sensor is used again when it has been sound for so long [s]: longer than a loose contact's
pauses, of which each costs two seconds at most."""
EVENTS = 50
"""So many faults are remembered for the report."""

Faults = Mapping[SignalFault, str]
"""Faults and the axes that have them, such as {stuck: "y"}."""


class FaultEvent(Struct):
    """A fault that was reported: since and until stream time [s]; None while it lasts.

    axes: such as "y"; empty for a signal that has none.
    """

    channel: str
    fault: SignalFault
    axes: str
    since: float
    until: float | None = None

    def as_dict(self) -> dict[str, Any]:
        """Plain, for JSON."""
        until = None if self.until is None else round(self.until, 1)
        return {
            "sensor": self.channel,
            "fault": str(self.fault),
            "axes": self.axes,
            "since_s": round(self.since, 1),
            "until_s": until,
        }


class FaultsInForce:
    """A channel's faults now, and for how long each has not been seen [s].

    events: those of all channels; what begins is appended, what ends is ended there.
    """

    def __init__(self, channel: str, events: deque[FaultEvent]) -> None:
        self.channel = channel
        self.faults: Faults = {}
        self._sound: dict[SignalFault, float] = {}
        self._events = events

    def go_on(self, found: Faults, now: float, passed: float) -> None:
        """Go on with the faults found and those that have not been gone for long enough.

        now: stream time [s]; passed: since the last call [s].
        """
        faults = dict(self.faults)
        for fault in list(faults):
            if fault in found:
                self._sound[fault] = 0.0
            else:
                self._sound[fault] += passed
                if self._sound[fault] >= SOUND_S:
                    del faults[fault]
                    self._ended(fault, now)
        for fault, axes in found.items():
            if fault not in faults:
                self._events.append(FaultEvent(self.channel, fault, axes, now))
            faults[fault] = "".join(sorted({*faults.get(fault, ""), *axes}))
            self._sound[fault] = 0.0
        self.faults = faults

    def end(self, now: float) -> None:
        """Nobody watches the channel any more from stream time now [s] on."""
        for fault in self.faults:
            self._ended(fault, now)
        self.faults = {}

    def _ended(self, fault: SignalFault, now: float) -> None:
        for event in self._events:
            if event.channel == self.channel and event.fault is fault and event.until is None:
                event.until = now
