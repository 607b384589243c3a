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
from imucald.discovery.raw_fields import raw_fields
from imucald.discovery.raw_search import raw_choices
from imucald.discovery.recording import Recording, Traffic
from imucald.discovery.reference import Reference
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
    proposal.choices, reference = choices_from(candidates, proposal)
    wanted = {"speed", "steering_wheel_angle"} - {c.quantity for c in proposal.choices}
    if wanted:
        known = {one.can_id for one in traffic if _is_described(databases, one)}
        proposal.choices += raw_choices(list(raw_fields(traffic, known, ticks)), reference, wanted)
    for name in used_messages(proposal.choices):
        if name in messages:
            found = find_protection(messages[name])
            if found is not None:
                proposal.protections.append(found)
    return proposal


def choices_from(
    candidates: Sequence[Candidate], proposal: Proposal
) -> tuple[list[Choice], Reference]:
    """Every quantity that the candidates hold, and the motion that they were held against."""
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
    return [c for c in found if c is not None], reference


def used_messages(choices: Sequence[Choice]) -> list[str]:
    """Messages from which something is taken, in order."""
    names = (
        source.signal.partition(".")[0]
        for choice in choices
        for source in choice.sources.values()
        if source.signal
    )
    return list(dict.fromkeys(names))


def _is_described(databases: Mapping[str, Database], one: Traffic) -> bool:
    """Whether a database has a message with signals of this identifier."""
    return any(
        message.signals and not message.unsupported and message.can_id == one.can_id
        for database in databases.values()
        for message in database.messages.values()
    )


def _channel_of(database: Database, traffic: Sequence[Traffic]) -> str | None:
    """The channel on which most messages of a database come, where the recording has several."""
    channels = dict.fromkeys(one.channel for one in traffic)
    if len(channels) < 2:
        return None
    counts = {c: sum(1 for _ in messages_in(database, traffic, c)) for c in channels}
    return max(counts, key=lambda c: counts[c])
