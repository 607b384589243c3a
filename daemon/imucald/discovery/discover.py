"""Make a proposed configuration from databases and a recording."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set

import numpy as np
from msgspec.structs import asdict

from imucald.can.dbc.database import Database
from imucald.can.dbc.decode import compile_decode, id_match
from imucald.can.dbc.message import Message
from imucald.can.j1939_transport import announced_messages, in_transport
from imucald.can.lost_frames import dropping_recorder, lost_share
from imucald.config.network import OutputIds
from imucald.config_check.finding import cut_frames
from imucald.config_check.moved_sensor import sensor_move
from imucald.core.errors import DatabaseError
from imucald.core.samples import QUANTITIES, TEMPERATURE
from imucald.core.text import clock, counted
from imucald.discovery.candidates import (
    MessageTraffic,
    SeenSignal,
    candidates_of,
    compared_by_pgn,
    messages_in,
    misses_sign,
    obd_speeds,
    readable_messages,
    silent_candidates,
    with_sign_bits,
)
from imucald.discovery.flags import (
    find_brake,
    find_reverse,
    find_temperature,
    unseen_reverse,
)
from imucald.discovery.heading import doubt_both_sensors, heading_choice, hold_against_usual_signs
from imucald.discovery.names import by_names, named_so
from imucald.discovery.proposal import Choice, Proposal
from imucald.discovery.protection_search import find_protection
from imucald.discovery.raw_search import raw_choices, raw_fields
from imucald.discovery.recording import GatheredFrames, Traffic
from imucald.discovery.reference import KnownMotion
from imucald.discovery.scalars import choices_of_motion
from imucald.discovery.sensors import Sensors
from imucald.discovery.triads import of_another_size
from imucald.motion.ticks import TICK_RATE

LEAST_PART_S = 60.0
"""Shortest part of a recording that is used, if the sensor was moved in the recording [s]."""


def discover(databases: Mapping[str, Database], recording: GatheredFrames) -> Proposal:
    """Propose a configuration. databases: databases by their paths in the configuration.

    If the sensor is moved in the recording, only the longer of the two parts, before or after the
    move, is used.
    """
    proposal, reference = _discovered(databases, recording)
    move = sensor_move(reference.motion)
    if move is None:
        return proposal
    is_later = recording.seconds - move.after > move.before
    first, last = (move.after, recording.seconds) if is_later else (0.0, move.before)
    part = recording.between(first, last)
    what_is_used = "so no entry is certain: give a recording without a move"
    if part.seconds >= LEAST_PART_S:
        proposal, _ = _discovered(databases, part)
        what_is_used = f"only {clock(first)} to {clock(last)} of the recording is used"
    proposal.move = f"{move.words}; {what_is_used}"
    proposal.notes.append(f"{proposal.move[:1].upper()}{proposal.move[1:]}.")
    return proposal


def _discovered(
    databases: Mapping[str, Database], recording: GatheredFrames
) -> tuple[Proposal, KnownMotion]:
    traffic = recording.traffic()
    ticks = int(recording.seconds * TICK_RATE) + 1
    proposal = Proposal()
    by_pgn = {path: compared_by_pgn(d, traffic) for path, d in databases.items()}
    databases = {path: by_pgn[path] or database for path, database in databases.items()}
    proposal.by_pgn = frozenset(path for path, found in by_pgn.items() if found is not None)
    messages: dict[str, MessageTraffic] = {}
    channels: dict[str, str] = {}
    for path, database in databases.items():
        channel = _channel_of(database, traffic)
        if channel is not None:
            channels[path] = channel
        for one in messages_in(database, traffic, channel):
            messages.setdefault(one.message.name, one)
    proposal.channels = channels
    proposal.messages_seen = len(messages)
    candidates = [c for one in messages.values() for c in candidates_of(one, ticks)]
    if not recording.frames:
        candidates = [c for d in databases.values() for c in silent_candidates(d)]
    candidates += list(with_sign_bits(messages, candidates, ticks))
    candidates += obd_speeds(traffic, ticks)
    proposal.choices, reference = choices_from(candidates, proposal)
    wanted = {"speed", "steering_wheel_angle"} - {c.quantity for c in proposal.choices}
    if wanted:
        known = {one.can_id for one in traffic if _is_described(databases, one)}
        proposal.choices += raw_choices(
            list(raw_fields(traffic, known, ticks)), reference.motion, wanted
        )
    for name in used_messages(proposal.choices):
        if name in messages:
            found = find_protection(messages[name])
            if found is not None:
                proposal.protections.append(found)
    taken = {one.can_id for one in traffic}
    taken |= {m.can_id for d in databases.values() for m in d.messages.values()}
    proposal.output_ids = free_output_ids(taken)
    proposal.notes = list(_notes(recording, candidates, databases))
    if recording.frames:
        found_ones = {c.quantity for c in proposal.choices}
        used = {s.signal for c in proposal.choices for s in c.sources.values()}
        proposal.missing = not_found(
            found_ones, used, databases, messages, candidates, _announced(traffic)
        )
        proposal.notes += _cut(proposal.choices, messages)
        taken_from = [messages[n] for n in used_messages(proposal.choices) if n in messages]
        shares = {m.message.name: lost_share(np.diff(m.t), m.message) for m in taken_from}
        proposal.loss = dropping_recorder(list(shares.values()))
        proposal.notes += [f"{proposal.loss}."] if proposal.loss else []
        proposal.notes += _lost(shares)
    for choice in proposal.choices:
        doubt_sender(choice, messages)
    accelerometer = proposal.choice("accelerometer")
    if accelerometer is not None and (accelerometer.doubt or len(accelerometer.sources) < 3):
        accelerometer.doubt = of_another_size(candidates) or accelerometer.doubt
    if recording.frames and not any(c.quantity == "reverse" for c in proposal.choices):
        proposal.notes += unseen_reverse(candidates)
    return proposal, reference


def _lost(shares: Mapping[str, float | None]) -> list[str]:
    """Return a text with the lost share of each message; empty if no message has losses."""
    known = {name: f"{100.0 * share:.1f}" for name, share in shares.items() if share is not None}
    if not set(known.values()) - {"0.0"}:
        return []
    return ["Frames lost: " + ", ".join(f"{n} {x} %" for n, x in known.items()) + "."]


def _announced(traffic: Sequence[Traffic]) -> dict[int, int]:
    found: dict[int, int] = {}
    for one in traffic:
        ids = np.full(len(one), one.can_id, np.uint32)
        found |= announced_messages(ids, one.data, one.length)
    return found


def _cut(choices: Sequence[Choice], messages: Mapping[str, MessageTraffic]) -> Iterator[str]:
    """Yield a note for each used message whose frames are shorter than in the database."""
    for name in used_messages(choices):
        one = messages.get(name)
        if one is not None and (shortest := int(one.length.min())) < one.message.length:
            yield cut_frames(name, shortest, one.message.length)


def doubt_sender(choice: Choice, messages: Mapping[str, MessageTraffic]) -> None:
    """Add a doubt to a choice whose J1939 message comes from several control units."""
    for name in used_messages([choice]):
        senders = messages[name].senders if name in messages else ()
        if len(senders) > 1 and not choice.doubt:
            first, *others = (f"0x{address:02X}" for address in senders)
            choice.doubt = (
                f"{name} comes from {len(senders)} source addresses, {first} and "
                f"{', '.join(others)}: {first} is used; write another one under "
                "'source_address:' if it is wrong"
            )


def _notes(
    recording: GatheredFrames, candidates: Sequence[SeenSignal], databases: Mapping[str, Database]
) -> Iterator[str]:
    if not recording.frames:
        yield "No recording was given: the proposal uses names and units only and is unsure."
        return
    names = {c.message.name for c in candidates}
    known = sum(bool(m.signals) for d in databases.values() for m in d.messages.values())
    yield (
        f"The recording has {counted(recording.frames, 'frame')} in {recording.seconds:.0f} s. It "
        f"contains {len(names)} of the {counted(known, 'message')} in the database, with "
        f"{counted(len({c.path for c in candidates}), 'signal')}."
    )
    if recording.is_full:
        yield "The recording is longer than that: only its beginning was used."
    if not names and databases:
        yield "No message of the database is on this bus. Is it the database of this vehicle?"


def free_output_ids(taken: Set[int]) -> dict[str, int]:
    """Return other ids for the output frames if a default id is on the bus; empty if the default
    ids are free."""
    usual = asdict(OutputIds())
    if not taken & set(usual.values()):
        return {}
    first, count = min(usual.values()), len(usual)
    for base in (*range(first, 0x7F0 - count, 0x10), *range(0x100, first, 0x10)):
        if not taken & set(range(base, base + count)):
            return {name: base + i - first for name, i in usual.items()}
    return {}


def choices_from(
    candidates: Sequence[SeenSignal], proposal: Proposal
) -> tuple[list[Choice], KnownMotion]:
    """Return choices for all quantities that were found, and the motion used as the reference."""
    plain = [c for c in candidates if c.sign_signal is None]
    sensors = Sensors(plain, candidates)
    every = [c for c in candidates if c.path not in sensors.taken]
    free = [c for c in every if c.sign_signal is None]
    of_motion, vehicle = choices_of_motion(sensors, every)
    proposal.vehicle += vehicle
    reference = sensors.reference
    found: list[Choice | None] = [
        *sensors.choices,
        *of_motion,
        find_reverse(reference, free),
        find_brake(reference.motion, free),
        find_temperature(reference, free),
        heading_choice(sensors.heading, reference.motion, free),
    ]
    chosen = [c for c in found if c is not None]
    hold_against_usual_signs(chosen, sensors.heading)
    if sensors.contradiction:
        doubt_both_sensors(chosen, sensors.contradiction)
    unused = [c for c in plain if c.path not in sensors.taken]
    chosen += by_names(unused, {c.quantity for c in chosen})
    rates = {c.path: 1.0 / c.cycle for c in candidates if c.cycle > 0.0 and c.x.size > 1}
    for choice in chosen:
        first = next(iter(choice.sources.values()), None)
        if first is not None and first.signal in rates:
            choice.evidence = f"{rates[first.signal]:.3g}/s; {choice.evidence}"
    return chosen, reference


def used_messages(choices: Sequence[Choice]) -> list[str]:
    """Return the names of the messages that the choices use, in order."""
    names = (
        path.partition(".")[0]
        for choice in choices
        for source in choice.sources.values()
        for path in (source.signal, source.sign_signal)
        if path
    )
    return list(dict.fromkeys(names))


def _is_described(databases: Mapping[str, Database], one: Traffic) -> bool:
    """True if a database has a message with signals for this identifier."""
    return any(
        match.matches(one.can_id, one.channel)
        for database in databases.values()
        for _, match in readable_messages(database)
    )


def _channel_of(database: Database, traffic: Sequence[Traffic]) -> str | None:
    """Return the channel with the most messages of a database; None if the recording has one
    channel only."""
    channels = dict.fromkeys(one.channel for one in traffic)
    if len(channels) < 2:
        return None
    counts = {c: sum(1 for _ in messages_in(database, traffic, c)) for c in channels}
    return max(counts, key=lambda c: counts[c])


def not_found(
    found: Set[str],
    used: Set[str],
    databases: Mapping[str, Database],
    messages: Mapping[str, MessageTraffic],
    candidates: Sequence[SeenSignal],
    announced: Mapping[int, int],
) -> dict[str, str]:
    """Return, for each missing quantity, the reason why a signal with a similar name was not used.

    The reason is empty if no signal has such a name. used: paths of signals used for another
    quantity. announced: messages announced by J1939 transport frames, see `announced_messages`.
    """
    seen = {c.path: c for c in candidates}
    reasons = {}
    for quantity in (row.key for row in QUANTITIES.values()):
        if quantity not in found and quantity != "magnetometer":  # which is rare
            named = _named(quantity, databases)
            why = (
                _why(quantity, message, name, messages, seen, announced)
                for message, name in named
                if f"{message.name}.{name}" not in used
            )
            reasons[quantity] = next(filter(None, why), "")
    return reasons


def _named(quantity: str, databases: Mapping[str, Database]) -> Iterator[tuple[Message, str]]:
    for database in databases.values():
        for message in database.messages.values():
            yield from ((message, name) for name in message.signals if named_so(quantity, name))


def _why(
    quantity: str,
    message: Message,
    name: str,
    messages: Mapping[str, MessageTraffic],
    seen: Mapping[str, SeenSignal],
    announced: Mapping[int, int],
) -> str:
    path = f"{message.name}.{name}"
    if path in seen:
        return f"{path} {_why_not_chosen(quantity, seen[path])}"
    try:
        plan = compile_decode(message, [name])
        id_match(message)
    except DatabaseError as error:
        return f"{path} cannot be read: {error}"
    traffic = messages.get(message.name)
    if traffic is None:
        match = id_match(message, j1939=True)
        sizes = [size for can_id, size in announced.items() if match.matches(can_id, "")]
        return f"{message.name} does not come" + (f": {in_transport(max(sizes))}" if sizes else "")
    longest = int(traffic.length.max())
    if longest < message.length:
        return (
            f"the frames of {message.name} have {longest} bytes, but the database says "
            f"{message.length}"
        )
    decoded = plan.decode_columns(traffic.data, traffic.length)
    if misses_sign(message.signal(name), decoded.raw[0][decoded.ok]):
        return (
            f"{path} is signed according to its values, but unsigned in the database: in a DBC, "
            "change '+' to '-' behind '@0' or '@1' of its line"
        )
    return f"{path} has no usable value"


def _why_not_chosen(quantity: str, signal: SeenSignal) -> str:
    if signal.is_constant:
        return "never changes"
    if quantity == TEMPERATURE.key and signal.states("temperature"):
        return "may be the temperature of another part"
    unit = f" (its unit is '{signal.unit}')" if signal.unit else ""
    if quantity == TEMPERATURE.key:
        return f"has no unit of temperature{unit}"
    return f"does not follow the motion in any unit of this quantity{unit}"
