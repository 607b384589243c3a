"""A signal prepared for coding: its bits, its scaling and the multiplexers above it.

The scaling `raw * scale + offset` gives the same results as cantools, for one number and for
columns. cantools computes in integers if scale and offset are integers and the signal is not a
float, else in doubles. The result here is always a double. If a double represents every product
exactly, this module computes in doubles. For the few signals of 54 to 64 bits where a double would
round, it computes in Python's integers, also for columns.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import FD_BYTES
from imucald.can.dbc.bits import Field, field_of
from imucald.can.dbc.message import Message, Signal
from imucald.core.errors import DatabaseError

EXACT_IN_DOUBLE = 2**53
"""Integers up to this value are exact in a double."""

MAX_SIGNAL_BITS = 64
"""Longest signal that is treated as a number [bits]."""

FLOAT_CODES = {16: "e", 32: "f", 64: "d"}
"""The letter of module struct for a float, by its number of bits."""


class Scaling(Struct, frozen=True):
    """Linear scaling in doubles: ``raw * scale + offset``. Subclasses compute the result
    differently. The values of a float may overflow or be NaN; the caller checks them.
    """

    scale: int | float
    offset: int | float

    is_identity = False

    def value(self, raw: int | float) -> float:
        """Convert a raw value to the physical value."""
        return raw * self.scale + self.offset

    def column(self, raw: NDArray[Any]) -> NDArray[np.float64]:
        """Convert raw values (N,) to physical values, float64 (N,)."""
        values = raw.astype(np.float64)
        with np.errstate(all="ignore"):
            values *= self.scale
            values += self.offset
        return values


class NoScaling(Scaling, frozen=True):
    """Scale 1, offset 0: integers are converted to doubles, floats are not changed."""

    is_identity = True

    def value(self, raw: int | float) -> float:
        """See `Scaling`."""
        return float(raw)

    def column(self, raw: NDArray[Any]) -> NDArray[np.float64]:
        """See `Scaling`."""
        return raw.astype(np.float64)


class IntegerScaling(Scaling, frozen=True):
    """Scaling in Python's integers, for signals for which doubles would round."""

    def value(self, raw: int | float) -> float:
        """See `Scaling`."""
        return float(raw * self.scale + self.offset)

    def column(self, raw: NDArray[Any]) -> NDArray[np.float64]:
        """See `Scaling`."""
        return np.array([self.value(r) for r in raw.tolist()], dtype=np.float64)


def scaling_of(signal: Signal, place: str) -> Scaling:
    """Return the scaling of a signal. Raises DatabaseError (with `place`) if the signal is not a
    number."""
    _check(signal, place)
    scale, offset = signal.scale, signal.offset
    if scale == 1 and offset == 0:
        return NoScaling(scale, offset)
    if signal.is_float:
        return Scaling(float(scale), float(offset))
    largest = max(abs(limit) for limit in raw_limits(signal))
    if _is_whole(scale) and _is_whole(offset):
        scale, offset = int(scale), int(offset)
        is_exact = largest * abs(scale) + abs(offset) <= EXACT_IN_DOUBLE
    else:
        is_exact = not isinstance(scale, int) or largest * abs(scale) <= EXACT_IN_DOUBLE
    if is_exact:
        return Scaling(float(scale), float(offset))
    return IntegerScaling(scale, offset)


def raw_limits(signal: Signal) -> tuple[int, int]:
    """Return the lowest and the highest raw integer that the signal's bits can represent."""
    if signal.is_signed:
        return -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    return 0, (1 << signal.length) - 1


class ResolvedSignal(Struct, frozen=True):
    """One prepared signal: its bits, its conversion and the multiplexers above it."""

    signal: Signal
    field: Field
    scaling: Scaling
    selectors: tuple[tuple[str, frozenset[int]], ...] = ()


def resolve(message: Message, name: str) -> ResolvedSignal:
    """Return bits, conversion and multiplexers of a signal. Raises DatabaseError if the signal
    cannot be coded."""
    signal = message.signal(name)
    place = f"{message.source}: {message.name}.{name}"
    scaling = scaling_of(signal, place)
    field = field_of(signal)
    if not 0 < message.length <= FD_BYTES:
        raise DatabaseError(
            f"{place}: a message of {message.length} bytes does not fit a CAN frame"
        )
    if field.first_bit < 0 or field.end_byte > message.length:
        raise DatabaseError(f"{place}: lies outside its message of {message.length} bytes")
    seen = {name}
    for parent, ids in signal.selectors:
        multiplexer = message.signals.get(parent)
        is_broken = multiplexer is None or multiplexer.is_float or parent in seen or not ids
        # columns compare multiplexer values as signed 64-bit integers
        if is_broken or not 0 <= min(ids) <= max(ids) < 2**63:
            raise DatabaseError(f"{place}: its multiplexer {parent} is broken")
        seen.add(parent)
    return ResolvedSignal(signal, field, scaling, signal.selectors)


def _is_whole(value: int | float) -> bool:
    return isinstance(value, int) or value.is_integer()


def _short(number: float) -> str:
    """Return a short text for a number from a file, because the number may have many digits."""
    try:
        return f"{number:g}"
    except OverflowError:
        return "above 1e308"


def _check(signal: Signal, place: str) -> None:
    if not 0 < signal.length <= MAX_SIGNAL_BITS:
        raise DatabaseError(
            f"{place}: a signal of {signal.length} bits is not possible (1 to {MAX_SIGNAL_BITS})"
        )
    if signal.is_float and signal.length not in FLOAT_CODES:
        raise DatabaseError(f"{place}: a float cannot have {signal.length} bits")
    try:
        scale, offset = float(signal.scale), float(signal.offset)
        reach = abs(scale) * 2.0**MAX_SIGNAL_BITS + abs(offset)
    except OverflowError:
        reach = math.inf
    # larger values have no physical meaning, and would cause an overflow
    if not reach < 1e300 or scale == 0.0:
        raise DatabaseError(
            f"{place}: factor {_short(signal.scale)} and offset {_short(signal.offset)} do "
            "not give a physical value"
        )
