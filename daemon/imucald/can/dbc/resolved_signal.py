"""A signal resolved for coding: its bits, its conversion and the multiplexers above it."""

from __future__ import annotations

from msgspec import Struct

from imucald.can.dbc.bits import MAX_FRAME_BYTES, Field, field_of
from imucald.can.dbc.database import Message, Signal
from imucald.can.dbc.scaling import Scaling, scaling_of
from imucald.core.errors import DatabaseError

MAX_MULTIPLEXER_VALUE = 2**63
"""Multiplexer values are compared as signed 64-bit integers in columns."""


class Extraction(Struct, frozen=True):
    """One signal, resolved: its bits, its conversion and the multiplexers above it."""

    signal: Signal
    field: Field
    scaling: Scaling
    selectors: tuple[tuple[str, frozenset[int]], ...] = ()


def resolve(message: Message, name: str) -> Extraction:
    """Bits, conversion and multiplexers of a signal; DatabaseError where they make no sense."""
    signal = message.signal(name)
    place = f"{message.source}: {message.name}.{name}"
    scaling = scaling_of(signal, place)
    field = field_of(signal)
    if not 0 < message.length <= MAX_FRAME_BYTES:
        raise DatabaseError(f"{place}: a message of {message.length} bytes is no CAN frame")
    if field.first_bit < 0 or field.end_byte > message.length:
        raise DatabaseError(f"{place}: lies outside its message of {message.length} bytes")
    seen = {name}
    for parent, ids in signal.selectors:
        multiplexer = message.signals.get(parent)
        is_broken = multiplexer is None or multiplexer.is_float or parent in seen or not ids
        if is_broken or not 0 <= min(ids) <= max(ids) < MAX_MULTIPLEXER_VALUE:
            raise DatabaseError(f"{place}: its multiplexer {parent} is broken")
        seen.add(parent)
    return Extraction(signal, field, scaling, signal.selectors)
