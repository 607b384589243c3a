"""What a CAN database says of a message and of its signals: plain, frozen, known to every codec."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import msgspec
from msgspec import Struct

from imucald.core.errors import DatabaseError

ByteOrder = Literal["little_endian", "big_endian"]
Selectors = tuple[tuple[str, frozenset[int]], ...]
"""A signal's multiplexers, each with the values under which it is there; none: always."""


class Signal(Struct, frozen=True, omit_defaults=True):
    """One signal: where its bits are and what they mean.

    `start` and `byte_order` as in a DBC: the least significant bit of an Intel signal, the most
    significant of a Motorola one, in the DBC's numbering (bit 0 = byte 0's lowest).
    Physical = raw * scale + offset, in `unit`. `minimum`, `maximum`: physical, None where not
    stated. `selectors`: the multiplexers that must hold, outermost first, each with the raw
    values under which this signal is there. `initial_raw`, `invalid_raw`: as the database states.
    """

    name: str
    start: int
    length: int
    byte_order: ByteOrder = "little_endian"
    is_signed: bool = False
    is_float: bool = False
    scale: int | float = 1
    offset: int | float = 0
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    choices: Mapping[int, str] = msgspec.field(default_factory=dict)
    is_multiplexer: bool = False
    selectors: Selectors = ()
    initial_raw: int | float | None = None
    invalid_raw: int | float | None = None
    comment: str = ""


class Message(Struct, frozen=True, omit_defaults=True):
    """One message. `can_id` carries `CAN_EFF_FLAG` for 29 bits; `cycle_time` in seconds."""

    name: str
    can_id: int
    length: int
    signals: Mapping[str, Signal]
    is_fd: bool = False
    is_j1939: bool = False
    cycle_time: float | None = None
    comment: str = ""
    source: str = ""
    unsupported: str = ""
    has_own_address: bool = False
    """Of J1939: another message of its database has the same PGN, so that the address decides."""
    left_out: Mapping[str, str] = msgspec.field(default_factory=dict)
    """Signals that were not taken as the database states them: where (file:line), why, remedy."""

    @property
    def is_multiplexed(self) -> bool:
        """Whether some of its signals come with certain values of a multiplexer alone."""
        return any(signal.is_multiplexer for signal in self.signals.values())

    def signal(self, name: str) -> Signal:
        """Return the signal; DatabaseError with the nearest names where there is none."""
        try:
            return self.signals[name]
        except KeyError:
            if name in self.left_out:
                raise DatabaseError(self.left_out[name]) from None
            hint = nearest(name, list(self.signals))
            text = f"{self.source}: message {self.name} has no signal {name!r}{hint}"
            raise DatabaseError(text) from None


def nearest(name: str, names: list[str]) -> str:
    """The names that may have been meant, in brackets; nothing where none is near."""
    import difflib  # noqa: PLC0415 - for a mistake only

    near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    return f" (nearest: {', '.join(near)})" if near else ""
