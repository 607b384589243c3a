"""One signal of an encode plan: what it can say, and the bits that say it."""

from __future__ import annotations

import math
import struct
import sys
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.bits import Field
from imucald.can.dbc.message import Message, Signal
from imucald.can.dbc.resolved_signal import FLOAT_CODES, ResolvedSignal, raw_limits
from imucald.core.errors import DatabaseError, EncodeError

RANGE_TOLERANCE = 1e-6
"""Slack at a stated minimum or maximum, in raw steps: the rounding of numbers in a database."""

MAX_DOUBLE = sys.float_info.max
"""Beyond this a number is not finite; NaN fails any comparison."""


class SignalEncoder:
    """One signal of an encode plan: range in raw steps and its not-available bits."""

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
        self._absent = None
        if not_available is not None:
            self._absent = _not_available_bits(s.signal, not_available, self.place)

    def generate(self, i: int, scope: dict[str, Any]) -> list[str]:
        """Lines of Python that set ``b{i}``, the bits, from ``v{i}``, the value."""
        raw = f"v{i}"
        if not self._is_identity:
            raw = f"(v{i} - {self._offset!r}) / {self._scale!r}"
        scope[f"bits_{i}"] = self.bits
        if self.is_float:
            scope[f"pack_{i}"] = struct.Struct("<" + FLOAT_CODES[self.field.length]).pack
            test = (
                f"{self.low!r} <= v{i} <= {self.high!r} and {-MAX_DOUBLE!r} <= x <= {MAX_DOUBLE!r}"
            )
            packed = f"from_bytes(pack_{i}(x), 'little')"
            return [f"    x = {raw}", f"    b{i} = {packed} if {test} else bits_{i}(v{i})"]
        test = f"{self.lowest} <= b{i} <= {self.highest}"
        mask = f" & {self.field.mask}" if self.lowest < 0 else ""
        return [f"    b{i} = round({raw})", f"    b{i} = b{i}{mask} if {test} else bits_{i}(v{i})"]

    def bits(self, value: float | None) -> int:
        """Bits of one value; EncodeError where it cannot be encoded."""
        if value is not None and math.isfinite(value):
            raw = value if self._is_identity else (value - self._offset) / self._scale
            if self.is_float:
                if self.low <= value <= self.high and math.isfinite(raw):
                    found = float_bits(raw, self.field.length)
                    if found is not None:
                        return found
            elif math.isfinite(raw) and self.lowest <= round(raw) <= self.highest:
                return round(raw) & self.field.mask
        if self._absent is None:
            raise EncodeError(f"{self.place}: {value} is out of its range")
        return self._absent

    def bits_column(self, values: NDArray[np.float64]) -> NDArray[np.uint64]:
        """The same for (N,) values."""
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
    """Lowest and highest raw integer within the bits and the stated physical range."""
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
    """Stated physical range; finite, so that no infinity is within it."""
    low = -MAX_DOUBLE if signal.minimum is None else signal.minimum
    high = MAX_DOUBLE if signal.maximum is None else signal.maximum
    return low, high


def _ceil_double(limit: int) -> float:
    """Smallest double that is not below the limit."""
    near = float(limit)
    return near if int(near) >= limit else math.nextafter(near, math.inf)


def _floor_double(limit: int) -> float:
    """Largest double that is not above the limit."""
    near = float(limit)
    return near if int(near) <= limit else math.nextafter(near, -math.inf)


def float_bits(raw: float, length: int) -> int | None:
    """IEEE 754 bits; None where the number is too large for the length."""
    try:
        return int.from_bytes(struct.pack("<" + FLOAT_CODES[length], raw), "little")
    except OverflowError:
        return None


def _float_bits_column(
    raw: NDArray[np.float64], length: int
) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    if length == 64:
        return raw.copy().view(np.uint64), np.isfinite(raw)
    floating, unsigned = (np.float32, np.uint32) if length == 32 else (np.float16, np.uint16)
    narrow: NDArray[Any] = raw.astype(floating)
    return narrow.view(unsigned).astype(np.uint64), np.isfinite(narrow)


def _not_available_bits(signal: Signal, raw: int | float, place: str) -> int:
    if signal.is_float:
        found = float_bits(float(raw), signal.length)
        if found is not None:
            return found
    elif float(raw).is_integer() and -(1 << signal.length - 1) <= raw < 1 << signal.length:
        return int(raw) & ((1 << signal.length) - 1)
    raise DatabaseError(f"{place}: not-available raw value {raw} does not fit its bits")
