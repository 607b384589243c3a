"""Raw to physical and back, exactly as cantools does it, for one number and for columns.

cantools computes `raw * scale + offset`: in integers where scale and offset are whole and the
signal is no float, else in doubles. The result here is always a double. Where a double holds
every product exactly the double path is used for both; the few 54-to-64-bit signals where it
would not are computed in Python's integers, in columns too.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.dbc.database import Signal
from imucald.core.errors import DatabaseError

EXACT_IN_DOUBLE = 2**53
"""Whole numbers up to here are doubles without rounding."""

MAX_SIGNAL_BITS = 64
"""Longest signal taken as a number."""

FLOAT_BITS = (16, 32, 64)

MAX_PHYSICAL = 1e300
"""A scale that reaches beyond this is no physical one, and would overflow."""


class Scaling(Struct, frozen=True):
    """Conversion of one signal. `expression` is Python text in which ``{r}`` is the raw value.

    `in_integers`: columns need Python's integers too.
    """

    scale: int | float
    offset: int | float
    is_float: bool
    is_identity: bool
    in_integers: bool
    expression: str

    def column(self, raw: NDArray[Any]) -> NDArray[np.float64]:
        """Physical (N,) float64 of raw (N,) values."""
        if self.in_integers:
            convert: Callable[[int], float] = eval("lambda r: " + self.expression.format(r="r"))
            return np.array([convert(r) for r in raw.tolist()], dtype=np.float64)
        values = raw.astype(np.float64)
        if self.is_identity:
            return values
        if not self.is_float:
            values *= float(self.scale)
            values += float(self.offset)
            return values
        with np.errstate(all="ignore"):  # a float signal carries anything; judged by the caller
            values *= float(self.scale)
            values += float(self.offset)
        return values


def raw_limits(signal: Signal) -> tuple[int, int]:
    """Lowest and highest raw integer that the signal's bits can hold."""
    if signal.is_signed:
        return -(1 << signal.length - 1), (1 << signal.length - 1) - 1
    return 0, (1 << signal.length) - 1


def scaling_of(signal: Signal, place: str) -> Scaling:
    """Conversion of a signal; DatabaseError (with `place`) where it is no number."""
    _check(signal, place)
    scale, offset = signal.scale, signal.offset
    if scale == 1 and offset == 0:
        expression = "{r}" if signal.is_float else "({r} + 0.0)"
        return Scaling(scale, offset, signal.is_float, True, False, expression)
    if signal.is_float:
        text = f"({{r}} * {float(scale)!r} + {float(offset)!r})"
        return Scaling(scale, offset, True, False, False, text)
    largest = max(abs(limit) for limit in raw_limits(signal))
    whole = _is_whole(scale) and _is_whole(offset)
    if whole:
        scale, offset = int(scale), int(offset)
        exact = largest * abs(scale) + abs(offset) <= EXACT_IN_DOUBLE
    else:
        exact = not isinstance(scale, int) or largest * abs(scale) <= EXACT_IN_DOUBLE
    if exact:
        text = f"({{r}} * {float(scale)!r} + {float(offset)!r})"
    else:
        text = f"float({{r}} * {scale!r} + {offset!r})"
    return Scaling(scale, offset, False, False, not exact, text)


def _is_whole(value: int | float) -> bool:
    return isinstance(value, int) or value.is_integer()


def _check(signal: Signal, place: str) -> None:
    if not 0 < signal.length <= MAX_SIGNAL_BITS:
        raise DatabaseError(f"{place}: {signal.length} bits are no number (1 to {MAX_SIGNAL_BITS})")
    if signal.is_float and signal.length not in FLOAT_BITS:
        raise DatabaseError(f"{place}: no float has {signal.length} bits")
    try:
        scale, offset = float(signal.scale), float(signal.offset)
        reach = abs(scale) * 2.0**MAX_SIGNAL_BITS + abs(offset)
    except OverflowError:
        reach = math.inf
    if not reach < MAX_PHYSICAL or scale == 0.0:
        raise DatabaseError(
            f"{place}: factor {str(signal.scale)[:20]} and offset {str(signal.offset)[:20]} "
            "make no physical value"
        )
