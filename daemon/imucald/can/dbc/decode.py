"""Decode plans: a message and the signals asked for, compiled once.

One frame is decoded by a small generated function (a few integer operations a signal), whole
columns by numpy; both give the same doubles, and the ones cantools gives. A multiplexer's value
is compared as raw value. The way back is in `encode`; databases are read by `database`. The text of
the generated functions comes from numbers of checked type and from positions only, never from names
in a database.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from types import CodeType
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
from imucald.can.dbc.message import Message, Selectors, Signal
from imucald.can.dbc.resolved_signal import FLOAT_CODES, ResolvedSignal, resolve
from imucald.core.errors import DatabaseError, DecodeError

J1939_BROADCAST_FORMAT = 240
"""From this PDU format on (PDU2) the PDU-specific byte is part of the PGN (SAE J1939-21)."""

J1939_PDU1_MASK = 0x03FF_0000
"""Extended data page, data page and PDU format: the PGN of a message to one address."""

J1939_PDU2_MASK = 0x03FF_FF00
"""The same with the group extension: the PGN of a broadcast message."""

FEW_VALUES = 8
"""Up to so many multiplexer values, comparing with each is quicker than a search."""

_STRUCT_CODES = {8: "b", 16: "h", 32: "i", 64: "q"}
"""struct's letter for a signed integer of so many bits."""

J1939_ADDRESS_MASK = 0xFF
"""The address of the sender."""
J1939_NO_ADDRESS = 0xFE
"""From here on an address is nobody's; databases write it for whoever sends (SAE J1939-81)."""

Raw = int | float | None
RawColumn = NDArray[np.int64] | NDArray[np.uint64] | NDArray[np.float64]


def _pgn_mask(can_id: int) -> int:
    is_pdu2 = (can_id >> 16 & 0xFF) >= J1939_BROADCAST_FORMAT
    return J1939_PDU2_MASK if is_pdu2 else J1939_PDU1_MASK


def pgn_of(can_id: int) -> int:
    """The bits of a 29-bit identifier that are its PGN, where they stand in it."""
    return can_id & _pgn_mask(can_id)


def id_match(
    message: Message,
    j1939: bool | None = None,
    channel: str | None = None,
    source_address: int | None = None,
) -> IdMatch:
    """Which frames are this message's.

    A J1939 message is matched by its PGN, whatever priority and (for PDU1) destination, and
    whatever source address unless one is given, or the database has several messages of that PGN
    and this one has an address of its own; `j1939` overrides what the database says of
    messages with 29 bits of identifier. One with 11 bits has no PGN.

    Raises DatabaseError where a source address is given for a message that is not of J1939.
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
            "its database has 'j1939: true' in the configuration"
            if is_extended
            else "its identifier has 11 bits"
        )
        raise DatabaseError(
            f"{message.source}: message {message.name} is no message of J1939, whose identifier "
            f"has a source address: {why}"
        )
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

    `size`: bytes of the message. `least`: bytes a frame must have: fewer where it may be cut; what
    does not lie in the frame is absent then. `ends`: bytes that hold each signal.
    `decode_raw(data)`: raw values, None where another multiplexer value stands or the frame is
    cut. `scale(raw)`: physical values of those. `decode(data)`: both in one. The first and the
    last raise DecodeError ("short_frame"). Not-finite floats come out as they are.
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
        names = _generated(
            self.size, self.least, self.ends, signals, multiplexers, self.raise_short
        )
        self.is_cut = any(end > self.least for end in self.ends)
        self.decode_raw: Callable[[bytes | bytearray], tuple[Raw, ...]] = names["decode_raw"]
        self.scale: Callable[[Sequence[Raw]], tuple[float | None, ...]] = names["scale"]
        self.decode: Callable[[bytes | bytearray], tuple[float | None, ...]] = names["decode"]

    def raise_short(self, length: int) -> NoReturn:
        """Raise the DecodeError of a frame that is shorter than its message."""
        text = f"{self.message.name}: {length} of {self.least} bytes"
        raise DecodeError("short_frame", text)

    def decode_columns(self, data: Columns, length: NDArray[np.uint8]) -> DecodedColumns:
        """Decode (N, W) payloads of (N,) lengths; never raises on what a frame contains."""
        ok = length >= self.least
        if data.shape[1] < self.least:
            ok = np.zeros(len(data), bool)
        data = self._wide(data)
        is_short = bool(len(length)) and self.is_cut and int(length.min()) < self.size
        words: dict[str, NDArray[np.uint64]] = {}
        selected = {
            name: _raw_column(data, words, s).astype(np.int64, copy=False)
            for name, s in self.multiplexers.items()
        }
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
        """For each choice of multiplexer values among the signals: the frames (N,) with it."""
        if not self.multiplexers:
            return {}
        data = self._wide(data)
        words: dict[str, NDArray[np.uint64]] = {}
        selected = {
            name: _raw_column(data, words, s).astype(np.int64, copy=False)
            for name, s in self.multiplexers.items()
        }
        found = {}
        for signal in self.signals:
            present = _present(signal, selected, length >= self.least)
            if present is not None:
                found[signal.selectors] = present
        return found

    def _wide(self, data: Columns) -> Columns:
        """Payloads at least as wide as the message, with zeros."""
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
    """Plan for the signals asked, in that order; DatabaseError where one cannot be decoded.

    may_be_cut: frames may be shorter than the message: signals that lie in them are decoded.
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


def _present(
    signal: ResolvedSignal, selected: Mapping[str, NDArray[np.int64]], ok: NDArray[np.bool_]
) -> NDArray[np.bool_] | None:
    present: NDArray[np.bool_] | None = None
    for name, ids in signal.selectors:
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


def _generated(
    size: int,
    least: int,
    ends: Sequence[int],
    signals: Sequence[ResolvedSignal],
    multiplexers: Mapping[str, ResolvedSignal],
    short: Callable[[int], NoReturn],
) -> dict[str, Any]:
    """Make `decode_raw(data)`, `scale(raw)` and `decode(data)` for frames of `size` bytes.

    `short` is called with the length of a frame that has fewer than `least`, and raises. ends: of
    the signals, in bytes: a frame of fewer does not hold them.
    """
    body, scope = _reading_lines(size, least, ends, signals, multiplexers)
    scope["short"] = short
    raw = [f"r{i}" for i in range(len(signals))]
    physical = [_physical_expression(s, f"r{i}", ends[i] > least) for i, s in enumerate(signals)]
    lines = ["def decode_raw(data):", *body, f"    return ({_listing(raw)})"]
    lines += ["def decode(data):", *body, f"    return ({_listing(physical)})"]
    lines += ["def scale(raw):", *([f"    ({_listing(raw)}) = raw"] if raw else [])]
    lines += [f"    return ({_listing(physical)})"]
    exec(_compiled("\n".join(lines)), scope)
    return scope


@lru_cache(maxsize=256)
def _compiled(text: str) -> CodeType:
    """Code of a plan; several drives of one configuration ask for the same."""
    return compile(text, "<decode plan>", "exec")


def _reading_lines(
    size: int,
    least: int,
    ends: Sequence[int],
    signals: Sequence[ResolvedSignal],
    multiplexers: Mapping[str, ResolvedSignal],
) -> tuple[list[str], dict[str, Any]]:
    """Lines that set r0, r1, ... from `data`, and the names they use."""
    scope: dict[str, Any] = {"from_bytes": int.from_bytes}
    lines = [
        "    length = len(data)",
        f"    if length != {size}:",
        f"        if length < {least}: short(length)",
        f"        data = data[:{size}]",
    ]
    if least < size:
        lines.append(f"        data = data + bytes({size} - len(data))")
    wanted = [(f"m{i}", s) for i, s in enumerate(multiplexers.values())]
    wanted += [(f"r{i}", s) for i, s in enumerate(signals)]
    grouped, loose = _split_aligned(wanted)
    for order, group in grouped.items():
        text, targets = _struct_group(order, group)
        scope[f"unpack_{order}"] = struct.Struct(text).unpack_from
        lines.append(f"    ({_listing(targets)}) = unpack_{order}(data)")
    for order, short_name in (("little_endian", "little"), ("big_endian", "big")):
        if any(s.field.byte_order == order for _, s in loose):
            lines.append(f"    {short_name} = from_bytes(data, {short_name!r})")
    for target, s in loose:
        lines.append(f"    {target} = {_loose_expression(s, size, scope)}")
    multiplexer_names = {name: f"m{i}" for i, name in enumerate(multiplexers)}
    for i, s in enumerate(signals):
        tests = []
        for j, (name, ids) in enumerate(s.selectors):
            if len(ids) == 1:
                tests.append(f"{multiplexer_names[name]} != {next(iter(ids))}")
            else:
                scope[f"ids_{i}_{j}"] = ids
                tests.append(f"{multiplexer_names[name]} not in ids_{i}_{j}")
        if ends[i] > least:
            tests.append(f"length < {ends[i]}")
        if tests:
            lines.append(f"    if {' or '.join(tests)}: r{i} = None")
    return lines, scope


def _physical_expression(s: ResolvedSignal, raw: str, may_be_cut: bool) -> str:
    """Python text of the physical value of a raw variable."""
    text = s.scaling.expression.format(r=raw)
    return f"None if {raw} is None else {text}" if s.selectors or may_be_cut else text


def _listing(names: Sequence[str]) -> str:
    return "".join(f"{name}, " for name in names)


def _split_aligned(
    wanted: Sequence[tuple[str, ResolvedSignal]],
) -> tuple[dict[str, list[tuple[str, ResolvedSignal]]], list[tuple[str, ResolvedSignal]]]:
    """Signals that a struct can read, by byte order, and the rest."""
    grouped: dict[str, list[tuple[str, ResolvedSignal]]] = {}
    loose = []
    ends = {"little_endian": 0, "big_endian": 0}
    for target, s in sorted(wanted, key=lambda item: item[1].field.first_bit):
        codes = FLOAT_CODES if s.signal.is_float else _STRUCT_CODES
        order, first = s.field.byte_order, s.field.first_bit
        if first % 8 == 0 and s.field.length in codes and first >= ends[order]:
            grouped.setdefault(order, []).append((target, s))
            ends[order] = first + s.field.length
        else:
            loose.append((target, s))
    return grouped, loose


def _struct_group(order: str, group: Sequence[tuple[str, ResolvedSignal]]) -> tuple[str, list[str]]:
    text = ">" if order == "big_endian" else "<"
    at = 0
    for _, s in group:
        gap = s.field.first_bit // 8 - at
        text += f"{gap}x" if gap else ""
        text += _code(s.signal)
        at = s.field.end_byte
    return text, [target for target, _ in group]


def _code(signal: Signal) -> str:
    if signal.is_float:
        return FLOAT_CODES[signal.length]
    code = _STRUCT_CODES[signal.length]
    return code if signal.is_signed else code.upper()


def _loose_expression(s: ResolvedSignal, size: int, scope: dict[str, Any]) -> str:
    source = "big" if s.field.is_big else "little"
    shift = s.field.shift(size)
    text = f"{source} >> {shift} & {s.field.mask}" if shift else f"{source} & {s.field.mask}"
    if s.signal.is_float:
        code = FLOAT_CODES[s.field.length]
        scope[f"float_{code}"] = struct.Struct("<" + code).unpack
        return f"float_{code}(({text}).to_bytes({s.field.length // 8}, 'little'))[0]"
    if s.signal.is_signed:
        top = 1 << s.field.length - 1
        return f"({text} ^ {top}) - {top}"
    return text
