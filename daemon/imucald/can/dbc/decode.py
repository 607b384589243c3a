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
from imucald.can.dbc.message import Message, Signal
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
        signals: Sequence[ResolvedSignal],
        multiplexers: Mapping[str, ResolvedSignal],
        match: IdMatch,
    ) -> None:
        self.message = message
        self.id_match = match
        self.signal_names = tuple(s.signal.name for s in signals)
        self.signals = tuple(signals)
        self.multiplexers = dict(multiplexers)
        self.size = message.length
        names = _generated(self.size, signals, multiplexers, self.raise_short)
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
            name: _raw_column(data, words, s).astype(np.int64, copy=False)
            for name, s in self.multiplexers.items()
        }
        raws, values, presents = [], [], []
        all_ok = bool(ok.all())
        for signal in self.signals:
            raw = _raw_column(data, words, signal)
            value = signal.scaling.column(raw)
            present = _present(signal, selected, ok)
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
    signals = [resolve(message, name) for name in signal_names]
    multiplexers: dict[str, ResolvedSignal] = {}
    for signal in signals:
        for name, _ in signal.selectors:
            multiplexers[name] = resolve(message, name)
    return DecodePlan(message, signals, multiplexers, id_match(message, j1939, channel))


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
    signals: Sequence[ResolvedSignal],
    multiplexers: Mapping[str, ResolvedSignal],
    short: Callable[[int], NoReturn],
) -> dict[str, Any]:
    """Make `decode_raw(data)`, `scale(raw)` and `decode(data)` for frames of `size` bytes.

    `short` is called with the length of a frame that has fewer, and raises.
    """
    body, scope = _reading_lines(size, signals, multiplexers)
    scope["short"] = short
    raw = [f"r{i}" for i in range(len(signals))]
    physical = [_physical_expression(s, f"r{i}") for i, s in enumerate(signals)]
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
    size: int, signals: Sequence[ResolvedSignal], multiplexers: Mapping[str, ResolvedSignal]
) -> tuple[list[str], dict[str, Any]]:
    """Lines that set r0, r1, ... from `data`, and the names they use."""
    scope: dict[str, Any] = {"from_bytes": int.from_bytes}
    lines = [
        f"    if len(data) != {size}:",
        f"        if len(data) < {size}: short(len(data))",
        f"        data = data[:{size}]",
    ]
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
        if tests:
            lines.append(f"    if {' or '.join(tests)}: r{i} = None")
    return lines, scope


def _physical_expression(s: ResolvedSignal, raw: str) -> str:
    """Python text of the physical value of a raw variable."""
    text = s.scaling.expression.format(r=raw)
    return f"None if {raw} is None else {text}" if s.selectors else text


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
