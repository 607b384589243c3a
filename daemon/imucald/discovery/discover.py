"""From databases and a recording to a proposed configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from imucald.can.dbc.database import Database
from imucald.discovery.candidates import (
    Candidate,
    MessageTraffic,
    candidates_of,
    messages_in,
    obd_speeds,
)
from imucald.discovery.flags import find_brake, find_reverse, find_temperature
from imucald.discovery.proposal import Choice, Proposal
from imucald.discovery.protection_search import find_protection
from imucald.discovery.recording import Recording, Traffic
from imucald.discovery.scalars import find_heading
from imucald.discovery.sensors import Sensors
from imucald.discovery.turning import Turning
from imucald.motion.ticks import TICK_RATE


def discover(databases: Mapping[str, Database], recording: Recording) -> Proposal:
    """Propose a configuration. databases: by the path that the configuration will name."""
    traffic = recording.traffic()
    ticks = int(recording.seconds * TICK_RATE) + 1
    proposal = Proposal()
    messages: dict[str, MessageTraffic] = {}
    channels: dict[str, str] = {}
    for path, database in databases.items():
        channel = _channel_of(database, traffic)
        if channel is not None:
            channels[path] = channel
        for one in messages_in(database, traffic, channel):
            messages.setdefault(one.message.name, one)
    proposal.channels = channels
    candidates = [c for one in messages.values() for c in candidates_of(one, ticks)]
    candidates += obd_speeds(traffic, ticks)
    proposal.choices = choices_from(candidates, proposal)
    for name in used_messages(proposal.choices):
        if name in messages:
            found = find_protection(messages[name])
            if found is not None:
                proposal.protections.append(found)
    return proposal


def choices_from(candidates: Sequence[Candidate], proposal: Proposal) -> list[Choice]:
    """Every quantity that the candidates hold."""
    sensors = Sensors(candidates)
    turning = Turning(sensors)
    reference = sensors.reference
    free = [c for c in candidates if c.path not in sensors.taken]
    found: list[Choice | None] = [
        *sensors.choices(),
        *turning.choices(free),
        find_reverse(reference, free),
        find_brake(reference, free),
        find_temperature(reference, free),
        find_heading(reference, free),
    ]
    proposal.vehicle += turning.vehicle
    return [c for c in found if c is not None]


def used_messages(choices: Sequence[Choice]) -> list[str]:
    """Messages from which something is taken, in order."""
    names = (
        source.signal.partition(".")[0]
        for choice in choices
        for source in choice.sources.values()
        if source.signal
    )
    return list(dict.fromkeys(names))


def _channel_of(database: Database, traffic: Sequence[Traffic]) -> str | None:
    """The channel on which most messages of a database come, where the recording has several."""
    channels = dict.fromkeys(one.channel for one in traffic)
    if len(channels) < 2:
        return None
    counts = {c: sum(1 for _ in messages_in(database, traffic, c)) for c in channels}
    return max(counts, key=lambda c: counts[c])
