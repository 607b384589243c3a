"""The description of a message and its signals in a CAN database, as plain immutable data."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import msgspec
from msgspec import Struct

from imucald.core.errors import DatabaseError

ByteOrder = Literal["little_endian", "big_endian"]
Selectors = tuple[tuple[str, frozenset[int]], ...]
"""The multiplexers of a signal, each with the values for which the signal is present. Empty: the
signal is always present."""


class Signal(Struct, frozen=True, omit_defaults=True):
    """One signal: the position and the meaning of its bits.

    `start`, `byte_order`: as in a DBC. `start` is the least significant bit of an Intel signal and
    the most significant bit of a Motorola signal. Bit 0 is the lowest bit of byte 0.
    Physical value = raw * scale + offset, in `unit`. `minimum`, `maximum`: physical values, None if
    not stated. `selectors`: multiplexers of this signal, outermost first, each with the raw values
    for which the signal is present. `initial_raw`, `invalid_raw`: as stated in the database.
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
    """One message. `can_id` contains `CAN_EFF_FLAG` for a 29-bit id; `cycle_time` is in seconds."""

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
    """True if another J1939 message of the database has the same PGN. The source address then
    distinguishes the messages."""
    left_out: Mapping[str, str] = msgspec.field(default_factory=dict)
    """Signals that were left out or changed: place (file:line), reason, remedy."""

    @property
    def is_multiplexed(self) -> bool:
        """True if some signals are present only for certain values of a multiplexer."""
        return any(signal.is_multiplexer for signal in self.signals.values())

    def signal(self, name: str) -> Signal:
        """Return the signal. If there is none, DatabaseError names the most similar signals."""
        try:
            return self.signals[name]
        except KeyError:
            if name in self.left_out:
                raise DatabaseError(self.left_out[name]) from None
            hint = nearest(name, list(self.signals))
            text = f"{self.source}: message {self.name} has no signal {name!r}{hint}"
            raise DatabaseError(text) from None


def nearest(name: str, names: list[str]) -> str:
    """Return similar names in brackets, as a hint; empty if no name is similar."""
    import difflib  # noqa: PLC0415 - for errors only

    near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    return f" (nearest: {', '.join(near)})" if near else ""
