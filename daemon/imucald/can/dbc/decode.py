"""Plans for decoding the requested signals of a message. A plan is made once and used for all
frames.

`decode` decodes one frame and is the reference implementation. `decode_columns` gives the same
values for many frames, with numpy. Both functions give the same doubles as cantools. The values of
multiplexers are compared as raw values. The module `encode` does the reverse; the module `database`
reads databases.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any

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
from imucald.can.dbc.message import Message, Selectors
from imucald.can.dbc.resolved_signal import FLOAT_CODES, ResolvedSignal, resolve
from imucald.core.errors import DatabaseError, DecodeError

J1939_PDU1_MASK = 0x03FF_0000
"""Mask of the PGN of a message to one address: extended data page, data page, PDU format. A
broadcast message also has the group extension."""

J1939_ADDRESS_MASK = 0xFF
"""Mask of the sender's address."""
J1939_NO_ADDRESS = 0xFE
"""Smallest value that is not the address of a unit. Databases use such a value for any sender (SAE
J1939-81)."""

Raw = int | float | None
Words = tuple[int, int]
"""The bytes of a frame as two integers: little-endian and big-endian."""
RawColumn = NDArray[np.int64] | NDArray[np.uint64] | NDArray[np.float64]


def _pgn_mask(can_id: int) -> int:
    # PDU2: the PDU-specific byte is part of the PGN (SAE J1939-21)
    is_pdu2 = (can_id >> 16 & 0xFF) >= 240
    return J1939_PDU1_MASK | 0xFF00 if is_pdu2 else J1939_PDU1_MASK


def pgn_of(can_id: int) -> int:
    """Return the PGN bits of a 29-bit identifier, at their original position."""
    return can_id & _pgn_mask(can_id)


def id_match(
    message: Message,
    j1939: bool | None = None,
    channel: str | None = None,
    source_address: int | None = None,
) -> IdMatch:
    """Return the filter for the frames of this message.

    A J1939 message is matched by its PGN. Priority and (for PDU1) destination are ignored. The
    source address is compared only in two cases: if `source_address` is given, or if the database
    has several messages with this PGN and this message has its own address. `j1939` overrides the
    database for messages with a 29-bit identifier. A message with an 11-bit identifier has no PGN.

    Raises DatabaseError if a source address is given for a message that is not J1939.
    """
    is_extended = bool(message.can_id & CAN_EFF_FLAG)
    if is_extended and (message.is_j1939 if j1939 is None else j1939):
        can_id, mask = message.can_id, _pgn_mask(message.can_id)
        if source_address is None and message.has_own_address:
            source_address = can_id & J1939_ADDRESS_MASK
        if source_address is not None:
            can_id = can_id & ~J1939_ADDRESS_MASK | source_address
            mask |= J1939_ADDRESS_MASK
        return IdMatch(can_id, mask, channel)
    if source_address is not None:
        why = (
            "set 'j1939: true' at its database in the configuration"
            if is_extended
            else "its identifier has 11 bits"
        )
        raise DatabaseError(
            f"{message.source}: message {message.name} is not a J1939 message, so it has no "
            f"source address: {why}"
        )
    return IdMatch(message.can_id, CAN_EFF_MASK if is_extended else CAN_SFF_MASK, channel)


class DecodedColumns(Struct, frozen=True):
    """Decoded columns of one message, for N frames.

    `raw`: raw integers (int64; uint64 for 64 unsigned bits) or floats of each signal. `values`:
    physical values, float64, NaN if the signal is absent. `present`: (N,) bool for each signal;
    None if it is always present. `ok`: (N,) bool, False for a frame that is too short (all its
    signals are absent).
    """

    raw: tuple[RawColumn, ...]
    values: tuple[NDArray[np.float64], ...]
    present: tuple[NDArray[np.bool_] | None, ...]
    ok: NDArray[np.bool_]


class DecodePlan:
    """Decodes the requested signals of one message, in the requested order.

    `size`: length of the message [bytes]. `least`: shortest accepted frame [bytes]. `least` is less
    than `size` if frames may be cut; signals outside the frame are then absent. `ends`: for each
    signal, the shortest frame [bytes] that contains it. `decode_raw(data)`: returns raw
    values; None if the signal is absent because of the multiplexer or of a cut frame. `scale(raw)`:
    converts raw values to physical values. `decode(data)`: does both steps. `decode_raw` and
    `decode` raise DecodeError ("short_frame"). Infinite and NaN floats are returned unchanged.
    """

    def __init__(
        self,
        message: Message,
        signals: Sequence[ResolvedSignal],
        multiplexers: Mapping[str, ResolvedSignal],
        match: IdMatch,
        may_be_cut: bool = False,
    ) -> None:
        self.message = message
        self.id_match = match
        self.signal_names = tuple(s.signal.name for s in signals)
        self.signals = tuple(signals)
        self.multiplexers = dict(multiplexers)
        self.size = message.length
        self.ends = [
            max([s.field.end_byte, *(multiplexers[name].field.end_byte for name, _ in s.selectors)])
            for s in signals
        ]
        self.least = min(self.ends, default=self.size) if may_be_cut else self.size
        self.is_cut = any(end > self.least for end in self.ends)
        self._values = [s.scaling.value for s in signals]
        self._reads: list[Callable[[Words], Raw]] = [_reader(s, self.size) for s in signals]
        self._selecting = {name: _reader(s, self.size) for name, s in multiplexers.items()}

    def decode_raw(self, data: bytes | bytearray) -> tuple[Raw, ...]:
        """Return the raw values of one frame."""
        length = len(data)
        if length < self.least:
            text = f"{self.message.name}: {length} of {self.least} bytes"
            raise DecodeError("short_frame", text)
        data = data[: self.size].ljust(self.size, b"\0")
        words = int.from_bytes(data, "little"), int.from_bytes(data, "big")
        found = [read(words) for read in self._reads]
        if self.multiplexers or length < self.size:
            selected = {name: read(words) for name, read in self._selecting.items()}
            for i, s in enumerate(self.signals):
                if length < self.ends[i] or any(selected[n] not in ids for n, ids in s.selectors):
                    found[i] = None
        return tuple(found)

    def scale(self, raw: Sequence[Raw]) -> tuple[float | None, ...]:
        """Convert raw values to physical values."""
        pairs = zip(self._values, raw, strict=True)
        return tuple([None if r is None else value(r) for value, r in pairs])

    def decode(self, data: bytes | bytearray) -> tuple[float | None, ...]:
        """Return the physical values of one frame."""
        return self.scale(self.decode_raw(data))

    def decode_columns(self, data: Columns, length: NDArray[np.uint8]) -> DecodedColumns:
        """Decode payloads (N, W) with lengths (N,). No frame content raises an error."""
        ok = length >= self.least
        if data.shape[1] < self.least:
            ok = np.zeros(len(data), bool)
        data = self._wide(data)
        is_short = bool(len(length)) and self.is_cut and int(length.min()) < self.size
        words: dict[str, NDArray[np.uint64]] = {}
        selected = self._selected(data, words)
        raws, values, presents = [], [], []
        all_ok = bool(ok.all())
        for signal, end in zip(self.signals, self.ends, strict=True):
            raw = _raw_column(data, words, signal)
            value = signal.scaling.column(raw)
            present = _present(signal, selected, ok)
            if is_short and end > self.least:
                whole = length >= end
                present = whole & ok if present is None else present & whole
            if present is not None:
                value[~present] = np.nan
            elif not all_ok:
                value[~ok] = np.nan
            raws.append(raw)
            values.append(value)
            presents.append(present)
        return DecodedColumns(tuple(raws), tuple(values), tuple(presents), ok)

    def presence(
        self, data: Columns, length: NDArray[np.uint8]
    ) -> Mapping[Selectors, NDArray[np.bool_]]:
        """Return masks (N,) of frames. The key of a mask is a condition for multiplexer values
        under which signals are present; the frames of the mask meet this condition."""
        if not self.multiplexers:
            return {}
        selected = self._selected(self._wide(data), {})
        found = {}
        for signal in self.signals:
            present = _present(signal, selected, length >= self.least)
            if present is not None:
                found[signal.selectors] = present
        return found

    def _selected(
        self, data: Columns, words: dict[str, NDArray[np.uint64]]
    ) -> dict[str, NDArray[np.int64]]:
        return {
            name: _raw_column(data, words, s).astype(np.int64, copy=False)
            for name, s in self.multiplexers.items()
        }

    def _wide(self, data: Columns) -> Columns:
        if data.shape[1] >= self.size:
            return data
        wide = np.zeros((len(data), self.size), np.uint8)
        wide[:, : data.shape[1]] = data
        return wide


def compile_decode(
    message: Message,
    signal_names: Sequence[str],
    j1939: bool | None = None,
    channel: str | None = None,
    source_address: int | None = None,
    may_be_cut: bool = False,
) -> DecodePlan:
    """Make the plan for the requested signals, in that order.

    may_be_cut: frames may be shorter than the message; signals within the frame are decoded.
    Raises DatabaseError if a signal cannot be decoded.
    """
    if message.unsupported:
        raise DatabaseError(f"{message.source}: message {message.name}: {message.unsupported}")
    signals = [resolve(message, name) for name in signal_names]
    multiplexers: dict[str, ResolvedSignal] = {}
    for signal in signals:
        for name, _ in signal.selectors:
            multiplexers[name] = resolve(message, name)
    match = id_match(message, j1939, channel, source_address)
    return DecodePlan(message, signals, multiplexers, match, may_be_cut)


def _reader(s: ResolvedSignal, size: int) -> Callable[[Words], int | float]:
    """Return a function that gives the raw value of a signal in a frame of `size` bytes."""
    at, shift, mask = int(s.field.is_big), s.field.shift(size), s.field.mask
    if s.signal.is_float:
        unpack, length = (
            struct.Struct("<" + FLOAT_CODES[s.field.length]).unpack,
            s.field.length // 8,
        )
        return lambda words: unpack((words[at] >> shift & mask).to_bytes(length, "little"))[0]
    if not s.signal.is_signed:
        return lambda words: words[at] >> shift & mask
    top = 1 << s.field.length - 1
    return lambda words: ((words[at] >> shift & mask) ^ top) - top


def _present(
    signal: ResolvedSignal, selected: Mapping[str, NDArray[np.int64]], ok: NDArray[np.bool_]
) -> NDArray[np.bool_] | None:
    present: NDArray[np.bool_] | None = None
    for name, ids in signal.selectors:
        found = np.isin(selected[name], np.fromiter(ids, np.int64, len(ids)))
        present = found & ok if present is None else present & found
    return present


def _raw_column(
    data: Columns, words: dict[str, NDArray[np.uint64]], s: ResolvedSignal
) -> RawColumn:
    order = s.field.byte_order
    if order not in words:
        words[order] = words_of(data, order)
    bits = read_column(words[order], s.field)
    if s.signal.is_float:
        return float_column(bits, s.field.length)
    if s.signal.is_signed:
        return signed_column(bits, s.field.length)
    return bits if s.field.length == 64 else bits.view(np.int64)


def float_column(bits: NDArray[np.uint64], length: int) -> NDArray[np.float64]:
    """Convert bits of IEEE 754 numbers of `length` bits to float64 (N,)."""
    size = length // 8
    narrow: NDArray[Any] = bits.astype(f"u{size}").view(f"f{size}")
    with np.errstate(invalid="ignore"):  # a frame may hold signalling NaNs
        return narrow.astype(np.float64)
