"""Decode, scale and check the values of a tap for columns of frames, in compiled code.

The results are bit for bit the same as those of `DecodePlan.decode_columns` and `Tap.array`, which
are used for all other taps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, Payloads
from imucald.can.dbc.bits import WORD_BITS
from imucald.can.dbc.decode import DecodePlan
from imucald.can.dbc.resolved_signal import IntegerScaling, ResolvedSignal
from imucald.core.compiled import Kernels
from imucald.inputs.conversion import Conversion
from imucald.inputs.taps import Tap

_LEAST, _MOST = -(2**63), 2**63 - 1
_QUANTITY, _NOT_ZERO, _ABOVE, _AMONG = range(4)

_Numbers = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]
"""The integer and float parameters of a signal, its raw values for "not available", and the values
at which a flag is on (see `core/kernels/frames.c`)."""


class CompiledTap:
    """One tap of a message."""

    def __init__(self, plan: DecodePlan, tap: Tap) -> None:
        self._size, self._third, self._may_be_cut = plan.size, tap.third, plan.is_cut
        signals = [plan.signals[component.index] for component in tap.components]
        self._is_plain = not tap.statuses and all(map(_is_plain, signals))
        self._parts: list[_Numbers] = []
        if self._is_plain:
            self._parts = [
                _numbers(signal, component.conversion, plan.least)
                for signal, component in zip(signals, tap.components, strict=True)
            ]

    def array(
        self, kernels: Kernels, frames: FrameColumns | Payloads
    ) -> tuple[NDArray[np.float64], NDArray[np.int8]]:
        """Do the work of `Tap.array` for good frames (N,)."""
        data, length, n = frames.data, frames.length, len(frames)
        codes = np.zeros(n, np.int8)
        values = np.empty((len(self._parts) + (self._third is not None), n))
        for column, numbers in zip(values, self._parts, strict=False):
            kernels.signal_column(data, length, *numbers, column, codes)
        if self._third is not None:
            values[-1] = self._third
        return (values[0] if len(values) == 1 else values.T), codes

    def can_take(self, frames: FrameColumns | Payloads) -> bool:
        """True if the compiled code supports these signals and all are within the frames."""
        if not self._is_plain or frames.data.shape[1] < self._size:
            return False
        return not self._may_be_cut or not len(frames) or int(frames.length.min()) >= self._size


def _is_plain(signal: ResolvedSignal) -> bool:
    """True if a signal is always present, and is an integer that doubles scale exactly enough."""
    is_other = signal.signal.is_float or isinstance(signal.scaling, IntegerScaling)
    is_large = not signal.signal.is_signed and signal.field.length == WORD_BITS
    return not (is_other or is_large or signal.selectors)


def _numbers(signal: ResolvedSignal, c: Conversion, size: int) -> _Numbers:
    field, scaling, rails = signal.field, signal.scaling, c.rails
    on_values: Sequence[float] = ()
    kind = _QUANTITY
    if c.unit.dimension == "flag":
        kind = _NOT_ZERO if c.on_above is None else _ABOVE
        if c.on_values is not None:
            kind, on_values = _AMONG, c.on_values
    wholes = (
        field.first_bit, field.length, field.is_big, signal.signal.is_signed,
        not scaling.is_identity, size, kind,
    )  # fmt: skip
    low, high = (-math.inf, math.inf) if rails is None else rails
    numbers = (
        scaling.scale, scaling.offset, c.offset, c.unit.factor, c.unit.offset, c.sign,
        c.low, c.high, c.limit, low, high, c.on_above or 0.0,
    )  # fmt: skip
    refused = [number for number in c.not_available if _LEAST <= number <= _MOST]
    return (
        np.array(wholes, np.int64),
        np.array(numbers, np.float64),
        np.array(refused, np.int64),
        np.array(on_values, np.float64),
    )
