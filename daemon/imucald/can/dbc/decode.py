"""Decode plans: a message and the signals asked for, compiled once.

One frame is decoded by a small generated function (a few integer operations a signal), whole
columns by numpy; both give the same doubles, and the ones cantools gives. A multiplexer's value
is compared as raw value. The way back is in `encode`; databases are read by `database`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK, IdMatch
from imucald.can.dbc.bits import (
    Columns,
    read_column,
    signed_column,
    words_of,
)
from imucald.can.dbc.database import Message
from imucald.can.dbc.generated_decode import decode_functions
from imucald.can.dbc.resolved_signal import Extraction, resolve
from imucald.core.errors import DatabaseError, DecodeError

J1939_BROADCAST_FORMAT = 240
"""From this PDU format on (PDU2) the PDU-specific byte is part of the PGN (SAE J1939-21)."""

J1939_PDU1_MASK = 0x03FF_0000
"""Extended data page, data page and PDU format: the PGN of a message to one address."""

J1939_PDU2_MASK = 0x03FF_FF00
"""The same with the group extension: the PGN of a broadcast message."""

FEW_VALUES = 8
"""Up to so many multiplexer values, comparing with each is quicker than a search."""

Raw = int | float | None
RawColumn = NDArray[np.int64] | NDArray[np.uint64] | NDArray[np.float64]


def id_match(message: Message, j1939: bool | None = None, channel: str | None = None) -> IdMatch:
    """Which frames are this message's.

    A J1939 message is matched by its PGN, whatever priority and source address (and, for PDU1,
    destination); `j1939` overrides what the database says.
    """
    if message.is_j1939 if j1939 is None else j1939:
        if not message.can_id & CAN_EFF_FLAG:
            text = f"{message.source}: message {message.name} has 11 bits of identifier, no PGN"
            raise DatabaseError(text)
        is_pdu2 = (message.can_id >> 16 & 0xFF) >= J1939_BROADCAST_FORMAT
        return IdMatch(message.can_id, J1939_PDU2_MASK if is_pdu2 else J1939_PDU1_MASK, channel)
    is_extended = bool(message.can_id & CAN_EFF_FLAG)
    return IdMatch(message.can_id, CAN_EFF_MASK if is_extended else CAN_SFF_MASK, channel)


class DecodedColumns(Struct, frozen=True):
    """Columns of one message; `N` frames.

    `raw`: a signal's raw integers (int64; uint64 for 64 unsigned bits) or floats. `values`:
    physical float64, NaN where the signal is absent. `present`: (N,) bool a signal, None where
    it always is. `ok`: (N,) bool, False where the frame is short (everything is absent there).
    """

    raw: tuple[RawColumn, ...]
    values: tuple[NDArray[np.float64], ...]
    present: tuple[NDArray[np.bool_] | None, ...]
    ok: NDArray[np.bool_]


class DecodePlan:
    """Decodes the asked signals of one message, in the order asked.

    `size`: bytes a frame must have. `decode_raw(data)`: raw values, None where another multiplexer
    value stands. `scale(raw)`: physical values of those. `decode(data)`: both in one. The first
    and the last raise DecodeError ("short_frame"). Not-finite floats come out as they are.
    """

    def __init__(
        self,
        message: Message,
        extractions: Sequence[Extraction],
        multiplexers: Mapping[str, Extraction],
        match: IdMatch,
    ) -> None:
        self.message = message
        self.id_match = match
        self.signal_names = tuple(e.signal.name for e in extractions)
        self.extractions = tuple(extractions)
        self.multiplexers = dict(multiplexers)
        self.size = message.length
        names = decode_functions(self.size, extractions, multiplexers, self.raise_short)
        self.decode_raw: Callable[[bytes | bytearray], tuple[Raw, ...]] = names["decode_raw"]
        self.scale: Callable[[Sequence[Raw]], tuple[float | None, ...]] = names["scale"]
        self.decode: Callable[[bytes | bytearray], tuple[float | None, ...]] = names["decode"]

    def raise_short(self, length: int) -> NoReturn:
        """Raise the DecodeError of a frame that is shorter than its message."""
        text = f"{self.message.name}: {length} of {self.size} bytes"
        raise DecodeError("short_frame", text)

    def decode_columns(self, data: Columns, length: NDArray[np.uint8]) -> DecodedColumns:
        """Decode (N, W) payloads of (N,) lengths; never raises on what a frame contains."""
        ok = length >= self.size
        if data.shape[1] < self.size:
            wide = np.zeros((len(data), self.size), np.uint8)
            wide[:, : data.shape[1]] = data
            data = wide
            ok = np.zeros(len(data), bool)
        words: dict[str, NDArray[np.uint64]] = {}
        selected = {
            name: _raw_column(data, words, e).astype(np.int64, copy=False)
            for name, e in self.multiplexers.items()
        }
        raws, values, presents = [], [], []
        all_ok = bool(ok.all())
        for extraction in self.extractions:
            raw = _raw_column(data, words, extraction)
            value = extraction.scaling.column(raw)
            present = _present(extraction, selected, ok)
            if present is not None:
                value[~present] = np.nan
            elif not all_ok:
                value[~ok] = np.nan
            raws.append(raw)
            values.append(value)
            presents.append(present)
        return DecodedColumns(tuple(raws), tuple(values), tuple(presents), ok)


def compile_decode(
    message: Message,
    signal_names: Sequence[str],
    j1939: bool | None = None,
    channel: str | None = None,
) -> DecodePlan:
    """Plan for the signals asked, in that order; DatabaseError where one cannot be decoded."""
    if message.unsupported:
        raise DatabaseError(f"{message.source}: message {message.name}: {message.unsupported}")
    extractions = [resolve(message, name) for name in signal_names]
    multiplexers: dict[str, Extraction] = {}
    for extraction in extractions:
        for name, _ in extraction.selectors:
            multiplexers[name] = resolve(message, name)
    return DecodePlan(message, extractions, multiplexers, id_match(message, j1939, channel))


def _present(
    extraction: Extraction, selected: Mapping[str, NDArray[np.int64]], ok: NDArray[np.bool_]
) -> NDArray[np.bool_] | None:
    present: NDArray[np.bool_] | None = None
    for name, ids in extraction.selectors:
        found = _any_of(selected[name], ids)
        present = found & ok if present is None else present & found
    return present


def _any_of(values: NDArray[np.int64], ids: frozenset[int]) -> NDArray[np.bool_]:
    if len(ids) > FEW_VALUES:
        return np.isin(values, np.fromiter(ids, np.int64, len(ids)))
    found = np.zeros(len(values), bool)
    for value in ids:
        found |= values == value
    return found


def _raw_column(data: Columns, words: dict[str, NDArray[np.uint64]], e: Extraction) -> RawColumn:
    order = e.field.byte_order
    if order not in words:
        words[order] = words_of(data, order)
    bits = read_column(words[order], e.field)
    if e.signal.is_float:
        return float_column(bits, e.field.length)
    if e.signal.is_signed:
        return signed_column(bits, e.field.length)
    return bits if e.field.length == 64 else bits.view(np.int64)


def float_column(bits: NDArray[np.uint64], length: int) -> NDArray[np.float64]:
    """IEEE 754 numbers of `length` bits, as float64 (N,)."""
    if length == 64:
        return bits.view(np.float64)
    kinds: dict[int, tuple[Any, Any]] = {
        16: (np.uint16, np.float16),
        32: (np.uint32, np.float32),
    }
    unsigned, floating = kinds[length]
    narrow: NDArray[Any] = bits.astype(unsigned).view(floating)
    with np.errstate(invalid="ignore"):  # signalling NaNs come from the bus
        return narrow.astype(np.float64)
