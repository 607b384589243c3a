"""What is proposed: a source for each quantity, with its evidence and what speaks against it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from imucald.discovery.candidates import SeenSignal


@dataclass(frozen=True)
class Proposed:
    """One number's source, as the configuration writes it."""

    signal: str = ""
    """``MESSAGE.SIGNAL``; empty where `raw` is given."""
    raw: Mapping[str, Any] | None = None
    unit: str | None = None
    """Where it is not the database's."""
    sign: int = 1
    sign_signal: str | None = None
    source_address: int | None = None
    offset: float = 0.0
    not_available: tuple[int, ...] = ()
    equals: tuple[float, ...] | None = None
    above: float | None = None
    channel: str | None = None

    def settings(self) -> str | dict[str, Any]:
        """What stands in the configuration: a text where nothing but the signal is to be said."""
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
    """Another choice for the same quantity, and why it is not the first."""

    sources: Mapping[str, Proposed]
    text: str


@dataclass
class Choice:
    """The sources of one quantity: "" alone, or by axis or wheel.

    evidence: one line. doubt: why it is not sure; empty where it is. doubts: by axis or wheel.
    """

    quantity: str
    sources: Mapping[str, Proposed]
    evidence: str
    doubt: str = ""
    alternatives: list[Alternative] = field(default_factory=list)

    @property
    def is_sure(self) -> bool:
        """Whether nothing speaks against it."""
        return not self.doubt


@dataclass(frozen=True)
class ProtectionFound:
    """What protects a message, as the configuration writes it, and the evidence."""

    message: str
    settings: Mapping[str, Any]
    evidence: Mapping[str, str]


@dataclass
class Proposal:
    """A whole proposal. notes: lines for the head of the file."""

    choices: list[Choice] = field(default_factory=list)
    messages_seen: int = 0
    """Messages of the databases that came in the recording."""
    protections: list[ProtectionFound] = field(default_factory=list)
    vehicle: list[tuple[str, str, str]] = field(default_factory=list)
    """Key, value, evidence."""
    channels: Mapping[str, str] = field(default_factory=dict)
    """Channel of each database by its path, where the recording has several."""
    notes: list[str] = field(default_factory=list)
    loss: str | None = None
    """What is said of a recorder that dropped frames."""
    missing: Mapping[str, str] = field(default_factory=dict)
    """Quantities that were looked for and not found, each with a reason where one is known."""
    driving_side: str = "unknown"
    output_ids: Mapping[str, int] = field(default_factory=dict)
    """Ids of the frames that are sent, where the usual ones are taken on this bus."""

    def choice(self, quantity: str) -> Choice | None:
        """The choice of a quantity, None where there is none."""
        return next((c for c in self.choices if c.quantity == quantity), None)


def candidate_of(source: Proposed, candidates: Sequence[SeenSignal]) -> SeenSignal:
    """The candidate that a source was made of."""
    return next(
        c for c in candidates if (c.path, c.sign_signal) == (source.signal, source.sign_signal)
    )


def source_of(
    candidate: SeenSignal, unit: str | None = None, sign: int = 1, **others: Any
) -> Proposed:
    """A source of a candidate; `unit` only where the database does not state it."""
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
