"""Plans for encoding physical values in the bits of a message. A plan is made once and used for all
frames.

One frame and whole columns give the same bytes as cantools: raw is `round((value - offset) /
scale)`, with halves rounded to even. Values are never clipped. A value that the signal cannot
represent (outside its range or bits, NaN, None) becomes the not-available raw value. If the signal
has no such value, EncodeError is raised.
"""

from __future__ import annotations

import math
import struct
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imucald.can.dbc.bits import Columns, Field, field_of, write_bits, write_column
from imucald.can.dbc.message import Message, Signal
from imucald.can.dbc.resolved_signal import FLOAT_CODES, ResolvedSignal, raw_limits, resolve
from imucald.core.errors import DatabaseError, EncodeError

RANGE_TOLERANCE = 1e-6
"""Tolerance at a stated minimum or maximum, in raw steps, because databases round numbers."""

MAX_DOUBLE = sys.float_info.max
"""Largest finite number. Comparing with it also excludes NaN."""


class SignalEncoder:
    """One signal of an encode plan: its range in raw steps and its not-available bits."""

    def __init__(
        self, message: Message, s: ResolvedSignal, not_available: int | float | None
    ) -> None:
        self.field: Field = s.field
        self.is_float = s.signal.is_float
        self.place = f"{message.name}.{s.signal.name}"
        self._scale = float(s.scaling.scale)
        self._offset = float(s.scaling.offset)
        self._is_identity = s.scaling.is_identity
        self.low, self.high = _float_limits(s.signal)
        self.lowest, self.highest = (0, 0) if self.is_float else _integer_limits(s.signal)
        self._mask = s.field.mask
        self._absent = None
        if not_available is not None:
            self._absent = _not_available_bits(s.signal, not_available, self.place)

    def bits(self, value: float | None) -> int:
        """Return the bits of one value. Raises EncodeError if it cannot be encoded."""
        if value is not None and math.isfinite(value):
            raw = value if self._is_identity else (value - self._offset) / self._scale
            if self.is_float:
                if self.low <= value <= self.high and math.isfinite(raw):
                    found = float_bits(raw, self.field.length)
                    if found is not None:
                        return found
            elif math.isfinite(raw) and self.lowest <= (number := round(raw)) <= self.highest:
                return number & self._mask
        if self._absent is None:
            raise EncodeError(f"{self.place}: {value} is out of its range")
        return self._absent

    def bits_column(self, values: NDArray[np.float64]) -> NDArray[np.uint64]:
        """Return the bits of values (N,). Raises EncodeError if one cannot be encoded."""
        with np.errstate(all="ignore"):
            raw = values if self._is_identity else (values - self._offset) / self._scale
            if self.is_float:
                bits, good = _float_bits_column(raw, self.field.length)
                good &= (values >= self.low) & (values <= self.high)
            else:
                bits, good = self._integer_bits_column(raw)
            good &= np.isfinite(values)
        if not good.all():
            if self._absent is None:
                value = values[~good][0]
                raise EncodeError(f"{self.place}: {value} is out of its range")
            bits[~good] = self._absent
        return bits

    def _integer_bits_column(
        self, raw: NDArray[np.float64]
    ) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
        rounded = np.rint(raw)
        good = (rounded >= _ceil_double(self.lowest)) & (rounded <= _floor_double(self.highest))
        rounded = np.where(good, rounded, 0.0)
        if self.lowest < 0:
            bits = rounded.astype(np.int64).view(np.uint64) & np.uint64(self.field.mask)
        else:
            bits = rounded.astype(np.uint64)
        return bits, good


def _integer_limits(signal: Signal) -> tuple[int, int]:
    """Lowest and highest raw integer that fit the bits and the stated physical range."""
    lowest, highest = raw_limits(signal)
    scale, offset = float(signal.scale), float(signal.offset)
    ends = [
        None if end is None or not math.isfinite(end) else (end - offset) / scale
        for end in (signal.minimum, signal.maximum)
    ]
    low, high = ends if scale > 0 else reversed(ends)
    if low is not None and math.isfinite(low):
        lowest = max(lowest, math.ceil(low - RANGE_TOLERANCE))
    if high is not None and math.isfinite(high):
        highest = min(highest, math.floor(high + RANGE_TOLERANCE))
    return lowest, highest


def _float_limits(signal: Signal) -> tuple[float, float]:
    """Return the stated physical range. A limit that is not stated is the largest finite double, so
    infinity is excluded."""
    low = -MAX_DOUBLE if signal.minimum is None else signal.minimum
    high = MAX_DOUBLE if signal.maximum is None else signal.maximum
    return low, high


def _ceil_double(limit: int) -> float:
    near = float(limit)
    return near if int(near) >= limit else math.nextafter(near, math.inf)


def _floor_double(limit: int) -> float:
    near = float(limit)
    return near if int(near) <= limit else math.nextafter(near, -math.inf)


def float_bits(raw: float, length: int) -> int | None:
    """Return the IEEE 754 bits; None if the number is too large for this length."""
    try:
        return int.from_bytes(struct.pack("<" + FLOAT_CODES[length], raw), "little")
    except OverflowError:
        return None


def _float_bits_column(
    raw: NDArray[np.float64], length: int
) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    size = length // 8
    narrow: NDArray[Any] = raw.astype(f"f{size}")
    return narrow.view(f"u{size}").astype(np.uint64), np.isfinite(narrow)


def _not_available_bits(signal: Signal, raw: int | float, place: str) -> int:
    if signal.is_float:
        found = float_bits(float(raw), signal.length)
        if found is not None:
            return found
    elif float(raw).is_integer() and -(1 << signal.length - 1) <= raw < 1 << signal.length:
        return int(raw) & ((1 << signal.length) - 1)
    raise DatabaseError(
        f"{place}: the raw value {raw} for 'not available' needs more bits than the signal has"
    )


class EncodePlan:
    """Encodes the requested signals of one message into `size` bytes, in the requested order.

    `encode(values)`: one frame from floats (None: not available). `encode_columns(columns)`:
    (N, size) uint8 from arrays (NaN: not available). All other signals have their start values.
    Multiplexers have the raw values in `multiplexer`.
    """

    def __init__(
        self,
        message: Message,
        signals: Sequence[ResolvedSignal],
        not_available: Mapping[str, int | float],
        multiplexer: Mapping[str, int],
    ) -> None:
        self.message = message
        self.size = message.length
        self.signal_names = tuple(s.signal.name for s in signals)
        self.multiplexer = dict(multiplexer)
        self._encoders = [
            SignalEncoder(message, s, not_available.get(s.signal.name)) for s in signals
        ]
        self._places = [(e, e.field.is_big, e.field.shift(self.size)) for e in self._encoders]
        self.start_bytes = self._start_bytes()

    def encode(self, values: Sequence[float | None]) -> bytes:
        """Return the payload of one frame. Raises EncodeError if a value cannot be encoded."""
        if len(values) != len(self._encoders):
            text = f"{len(values)} values for {len(self._encoders)} signals"
            raise EncodeError(f"{self.message.name}: {text}")
        little, big = int.from_bytes(self.start_bytes, "little"), 0
        for (encoder, is_big, shift), value in zip(self._places, values, strict=True):
            if is_big:
                big |= encoder.bits(value) << shift
            else:
                little |= encoder.bits(value) << shift
        if big:
            little |= int.from_bytes(big.to_bytes(self.size, "big"), "little")
        return little.to_bytes(self.size, "little")

    def encode_columns(self, columns: Sequence[ArrayLike]) -> Columns:
        """Return payloads (N, size). Raises EncodeError if a value cannot be encoded."""
        if len(columns) != len(self._encoders):
            text = f"{len(columns)} columns for {len(self._encoders)} signals"
            raise EncodeError(f"{self.message.name}: {text}")
        arrays = [np.asarray(c, dtype=np.float64) for c in columns]
        count = len(arrays[0]) if arrays else 0
        if any(a.shape != (count,) for a in arrays):
            raise EncodeError(f"{self.message.name}: columns differ in length")
        out = np.zeros((count, -(-self.size // 8) * 8), np.uint8)
        out[:, : self.size] = np.frombuffer(self.start_bytes, np.uint8)
        for encoder, array in zip(self._encoders, arrays, strict=True):
            write_column(out, encoder.field, encoder.bits_column(array))
        return np.ascontiguousarray(out[:, : self.size])

    def _start_bytes(self) -> bytes:
        """Return a frame with the start values of present signals and 0 for requested signals."""
        payload = bytearray(self.size)
        for signal in self.message.signals.values():
            field = field_of(signal)
            inside = field.first_bit >= 0 and field.end_byte <= self.size and field.length > 0
            if not inside or not self._is_there(signal):
                continue
            raw = self.multiplexer.get(signal.name, signal.initial_raw)
            if raw is not None:
                write_bits(payload, field, _start_bits(signal, raw))
        for encoder in self._encoders:
            write_bits(payload, encoder.field, 0)
        return bytes(payload)

    def _is_there(self, signal: Signal) -> bool:
        for name, ids in signal.selectors:
            multiplexer = self.message.signals.get(name)
            start = (multiplexer.initial_raw if multiplexer is not None else None) or 0
            if self.multiplexer.get(name, start) not in ids:
                return False
        return True


def compile_encode(
    message: Message,
    signal_names: Sequence[str],
    not_available: Mapping[str, int | float] | None = None,
    multiplexer: Mapping[str, int] | None = None,
) -> EncodePlan:
    """Make the plan for the given signals, in that order.

    `not_available`: the raw value that means "not available", by signal (float for float signals).
    `multiplexer`: raw values of multiplexers. A multiplexer without an entry gets the lowest value
    for which all requested signals are present. Raises DatabaseError if a signal cannot be encoded
    or if signals exclude each other.
    """
    if message.unsupported:
        raise DatabaseError(f"{message.source}: message {message.name}: {message.unsupported}")
    if len(set(signal_names)) != len(signal_names):
        raise DatabaseError(f"{message.source}: message {message.name}: a signal is given twice")
    signals = [resolve(message, name) for name in signal_names]
    chosen = _choose_multiplexers(message, signals, multiplexer or {})
    return EncodePlan(message, signals, not_available or {}, chosen)


def _choose_multiplexers(
    message: Message, signals: Sequence[ResolvedSignal], given: Mapping[str, int]
) -> dict[str, int]:
    allowed: dict[str, frozenset[int]] = {n: frozenset([v]) for n, v in given.items()}
    for s in signals:
        for name, ids in s.selectors:
            allowed[name] = allowed.get(name, ids) & ids
            if not allowed[name]:
                text = f"its signals need different values of {name} in one frame"
                raise DatabaseError(f"{message.source}: message {message.name}: {text}")
    for name in allowed:
        resolve(message, name)
        if any(name == s.signal.name for s in signals):
            raise DatabaseError(
                f"{message.source}: {message.name}.{name} is a multiplexer; "
                "give its raw value, not a column"
            )
    return {name: min(ids) for name, ids in allowed.items()}


def _start_bits(signal: Signal, raw: int | float) -> int:
    mask = (1 << signal.length) - 1
    if not signal.is_float:
        return round(raw) & mask if math.isfinite(raw) else 0
    found = float_bits(float(raw), signal.length) if signal.length in FLOAT_CODES else None
    return found or 0
