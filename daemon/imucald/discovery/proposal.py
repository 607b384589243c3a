"""The proposal: a source for each quantity, with its evidence and doubts."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from imucald.core.samples import QUANTITIES
from imucald.discovery.candidates import SeenSignal

MAX_ALTERNATIVES = 3
"""Largest number of other choices that are written for a quantity."""


@dataclass(frozen=True)
class Proposed:
    """The source of one number, as in the configuration."""

    signal: str = ""
    """Name ``MESSAGE.SIGNAL``; empty if `raw` is given."""
    raw: Mapping[str, Any] | None = None
    sign_signal: str | None = None
    source_address: int | None = None
    unit: str | None = None
    """The unit, if it differs from the unit in the database."""
    sign: int = 1
    offset: float = 0.0
    not_available: tuple[int, ...] = ()
    equals: tuple[float, ...] | None = None
    above: float | None = None
    channel: str | None = None

    def settings(self) -> str | dict[str, Any]:
        """Return the entry for the configuration: the keys that are not at their defaults, or a
        text if only the name of the signal is needed."""
        all_keys = ((f.name, getattr(self, f.name), f.default) for f in fields(self))
        found = {name: value for name, value, default in all_keys if value != default}
        if self.equals is not None and len(self.equals) == 1:
            found["equals"] = self.equals[0]
        return self.signal if list(found) == ["signal"] else found


@dataclass(frozen=True)
class Alternative:
    """Another choice for the same quantity. text: its evidence."""

    sources: Mapping[str, Proposed]
    text: str


@dataclass
class Choice:
    """The sources of one quantity, by axis or wheel (key "" for a single source).

    evidence: one line of text. doubt: reason why the choice is not sure; empty if it is sure.
    """

    quantity: str
    sources: Mapping[str, Proposed]
    evidence: str
    doubt: str = ""
    alternatives: list[Alternative] = field(default_factory=list)

    @property
    def is_sure(self) -> bool:
        """True if there is no doubt."""
        return not self.doubt


@dataclass(frozen=True)
class ProtectionFound:
    """The protection of a message, as in the configuration, and the evidence for it."""

    message: str
    settings: Mapping[str, Any]
    evidence: Mapping[str, str]


@dataclass
class Proposal:
    """A complete proposal. notes: lines for the head of the file."""

    choices: list[Choice] = field(default_factory=list)
    messages_seen: int = 0
    """Number of messages of the databases that occur in the recording."""
    protections: list[ProtectionFound] = field(default_factory=list)
    vehicle: list[tuple[str, str, str]] = field(default_factory=list)
    """Keys of the section `vehicle`, each with its value and evidence."""
    channels: Mapping[str, str] = field(default_factory=dict)
    """Channel of each database, by the path of the database. It is used if the recording has
    several channels."""
    by_pgn: frozenset[str] = frozenset()
    """Paths of the databases whose messages are matched by PGN, although the databases do not state
    J1939."""
    notes: list[str] = field(default_factory=list)
    loss: str | None = None
    """Text about a recorder that dropped frames, or None."""
    move: str | None = None
    """Text about a sensor that was moved in the recording, or None."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Quantities that were not found, each with the reason; the reason is empty if it is not
    known."""
    driving_side: str = "unknown"
    output_ids: Mapping[str, int] = field(default_factory=dict)
    """Ids of the output frames if the default ids are already used on this bus; otherwise empty."""

    def choice(self, quantity: str) -> Choice | None:
        """Return the choice of a quantity; None if the quantity has no choice."""
        return next((c for c in self.choices if c.quantity == quantity), None)


def candidate_of(source: Proposed, candidates: Sequence[SeenSignal]) -> SeenSignal:
    """Return the candidate from which a source was made."""
    return next(
        c for c in candidates if (c.path, c.sign_signal) == (source.signal, source.sign_signal)
    )


def source_of(
    candidate: SeenSignal, unit: str | None = None, sign: int = 1, **others: Any
) -> Proposed:
    """Make the source of a candidate. `unit` is stored only if the database does not state it."""
    if candidate.raw is not None:
        others |= {"raw": candidate.raw, "channel": candidate.own_channel}
        return Proposed(unit=unit or candidate.unit, sign=sign, **others)
    return Proposed(
        signal=candidate.path,
        unit=None if unit is None or unit == candidate.unit else unit,
        sign=sign,
        sign_signal=candidate.sign_signal,
        source_address=candidate.source_address,
        not_available=candidate.unavailable,
        **others,
    )


WIDTH = 100
_MISSING = {
    "accelerometer": "{x: MESSAGE.SIGNAL, y: MESSAGE.SIGNAL, z: MESSAGE.SIGNAL}",
    "gyroscope": "{x: MESSAGE.SIGNAL, y: MESSAGE.SIGNAL, z: MESSAGE.SIGNAL}",
    "speed": "MESSAGE.SIGNAL",
}
"""Template lines for important quantities that were not found."""


def as_yaml(proposal: Proposal, databases: Sequence[str]) -> str:
    """Return the text of the configuration file. databases: paths as written in the file."""
    return "\n".join(_lines(proposal, databases)) + "\n"


def _lines(proposal: Proposal, databases: Sequence[str]) -> Iterator[str]:
    yield "# Proposed by 'imucald init'. Please check it: the evidence is above each entry."
    yield (
        "# 'unsure' marks entries that the recording does not confirm. All keys: "
        "docs/configuration.md"
    )
    for note in proposal.notes:
        yield from _comment(note, "")
    yield ""
    yield from _databases(proposal, databases)
    yield ""
    yield "vehicle:"
    yield "  id: my-car"
    unknown = " # state left or right: roads slope to the side, which looks like mount roll"
    side = proposal.driving_side
    yield f"  driving_side: {side}{unknown if side == 'unknown' else ''}"
    for key, value, evidence in proposal.vehicle:
        yield f"  {key}: {value} # {evidence}"
    yield ""
    yield "signals:"
    by_name = {choice.quantity: choice for choice in proposal.choices}
    for name in (row.key for row in QUANTITIES.values()):
        choice = by_name.get(name)
        if choice is not None:
            yield from _choice(choice)
        elif name in _MISSING:
            yield f"  # {name}: {_MISSING[name]} # not found"
        if proposal.missing.get(name):
            yield from _comment(f"{name}: not found: {proposal.missing[name]}", "  ")
        elif name in proposal.missing and name not in _MISSING:
            yield f"  # {name}: not found"
    if proposal.protections:
        yield ""
        yield "messages:"
        for found in proposal.protections:
            yield f"  {_flow(found.message)}:"
            for key, value in found.settings.items():
                yield f"    {key}: {_flow(value)} # {found.evidence[key]}"
    if proposal.output_ids:
        yield ""
        yield "output:"
        yield "  ids: # the default ids are used on this bus already, or in its database"
        for name, can_id in proposal.output_ids.items():
            yield f"    {name}: 0x{can_id:03X}"


def _databases(proposal: Proposal, databases: Sequence[str]) -> Iterator[str]:
    entries: list[Any] = []
    for path in databases:
        channel = proposal.channels.get(path)
        more: dict[str, Any] = {} if channel is None else {"channel": channel}
        if path in proposal.by_pgn:
            more["j1939"] = True
            yield "# its messages come from other source addresses, so PGNs are compared (J1939)"
        entries.append({"path": path, **more} if more else path)
    if entries:
        yield f"database: {_flow(entries[0] if len(entries) == 1 else entries)}"
    else:
        yield "# database: car.dbc # required; an empty .dbc is enough if every source is 'raw'"


def _choice(choice: Choice) -> Iterator[str]:
    yield from _comment(choice.evidence, "  ")
    if choice.doubt:
        yield from _comment(f"unsure: {choice.doubt}", "  ")
    if choice.sources:
        yield from _sources(choice.quantity, choice.sources, "  ")
    for other in choice.alternatives:
        yield from _alternative(choice.quantity, other)


def _alternative(quantity: str, other: Alternative) -> Iterator[str]:
    """Yield one commented line of any length. The user can replace the chosen line with this
    line."""
    flat: Any = {key: one.settings() for key, one in other.sources.items()}
    value = flat.get("", flat)
    yield f"  # unsure: {quantity}: {_flow(value)} # {other.text}"


def _sources(quantity: str, sources: Mapping[str, Proposed], indent: str) -> Iterator[str]:
    if "" in sources:
        yield f"{indent}{quantity}: {_flow(sources[''].settings())}"
        return
    yield f"{indent}{quantity}:"
    for key, one in sources.items():
        yield f"{indent}  {key}: {_flow(one.settings())}"


def _flow(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k}: {_of_key(k, v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_flow(v) for v in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value if _is_plain(value) else json.dumps(value, ensure_ascii=False)
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value)


def _of_key(key: str, value: Any) -> str:
    """Format the value of a key. Identifiers are written in hexadecimal."""
    if key == "source_address":
        return f"0x{value:02X}"
    return f"0x{value:03X}" if key == "id" and isinstance(value, int) else _flow(value)


def _is_plain(text: str) -> bool:
    """True if YAML reads a text without quotes unchanged, also in a list."""
    words = {"y", "n", "yes", "no", "on", "off", "true", "false", "null", "~"}
    if not text or text.lower() in words or text != text.strip():
        return False
    plain = all(c.isalnum() or c in "_./^²°%" for c in text)
    return plain and (text[0].isalpha() or text[0] in "_./") and text.isascii()


def _comment(text: str, indent: str) -> Iterator[str]:
    width = WIDTH - len(indent) - 2
    lines = textwrap.wrap(text, width, break_long_words=False, break_on_hyphens=False)
    yield from (f"{indent}# {line}" for line in lines)
