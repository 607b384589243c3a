"""The proposal: a source for each quantity, with its evidence and doubts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from imucald.discovery.candidates import SeenSignal

MAX_ALTERNATIVES = 3
"""Largest number of other choices that are written for a quantity."""


@dataclass(frozen=True)
class Proposed:
    """The source of one number, as in the configuration."""

    signal: str = ""
    """Name ``MESSAGE.SIGNAL``; empty if `raw` is given."""
    raw: Mapping[str, Any] | None = None
    unit: str | None = None
    """The unit, if it differs from the unit in the database."""
    sign: int = 1
    sign_signal: str | None = None
    source_address: int | None = None
    offset: float = 0.0
    not_available: tuple[int, ...] = ()
    equals: tuple[float, ...] | None = None
    above: float | None = None
    channel: str | None = None

    def settings(self) -> str | dict[str, Any]:
        """Return the entry for the configuration. The entry is a text if only the name of the
        signal is needed."""
        found: dict[str, Any] = {"raw": dict(self.raw)} if self.raw else {"signal": self.signal}
        if self.sign_signal is not None:
            found["sign_signal"] = self.sign_signal
        if self.source_address is not None:
            found["source_address"] = self.source_address
        if self.unit is not None:
            found["unit"] = self.unit
        if self.sign < 0:
            found["sign"] = -1
        if self.offset:
            found["offset"] = self.offset
        if self.not_available:
            found["not_available"] = list(self.not_available)
        if self.equals is not None:
            found["equals"] = self.equals[0] if len(self.equals) == 1 else list(self.equals)
        if self.above is not None:
            found["above"] = self.above
        if self.channel is not None:
            found["channel"] = self.channel
        return self.signal if self.signal and len(found) == 1 else found


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
