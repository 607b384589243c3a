"""The functions that decode one frame, as generated Python.

A few integer operations a signal; signals that lie on whole bytes are read by one struct. The text
comes from numbers of checked type and from positions only, never from names in a database.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

from imucald.can.dbc.database import Signal
from imucald.can.dbc.resolved_signal import Extraction

_STRUCT_CODES = {8: "b", 16: "h", 32: "i", 64: "q"}
_FLOAT_CODES = {16: "e", 32: "f", 64: "d"}


def decode_functions(
    size: int,
    extractions: Sequence[Extraction],
    multiplexers: Mapping[str, Extraction],
    short: Callable[[int], NoReturn],
) -> dict[str, Any]:
    """Make `decode_raw(data)`, `scale(raw)` and `decode(data)` for frames of `size` bytes.

    `short` is called with the length of a frame that has fewer, and raises.
    """
    body, scope = _reading_lines(size, extractions, multiplexers)
    scope["short"] = short
    raw = [f"r{i}" for i in range(len(extractions))]
    physical = [_physical_expression(e, f"r{i}") for i, e in enumerate(extractions)]
    lines = ["def decode_raw(data):", *body, f"    return ({_listing(raw)})"]
    lines += ["def decode(data):", *body, f"    return ({_listing(physical)})"]
    lines += ["def scale(raw):", *([f"    ({_listing(raw)}) = raw"] if raw else [])]
    lines += [f"    return ({_listing(physical)})"]
    exec("\n".join(lines), scope)
    return scope


def _reading_lines(
    size: int, extractions: Sequence[Extraction], multiplexers: Mapping[str, Extraction]
) -> tuple[list[str], dict[str, Any]]:
    """Lines that set r0, r1, ... from `data`, and the names they use."""
    scope: dict[str, Any] = {"from_bytes": int.from_bytes}
    lines = [
        f"    if len(data) != {size}:",
        f"        if len(data) < {size}: short(len(data))",
        f"        data = data[:{size}]",
    ]
    wanted = [(f"m{i}", e) for i, e in enumerate(multiplexers.values())]
    wanted += [(f"r{i}", e) for i, e in enumerate(extractions)]
    grouped, loose = _split_aligned(wanted)
    for order, group in grouped.items():
        text, targets = _struct_group(order, group)
        scope[f"unpack_{order}"] = struct.Struct(text).unpack_from
        lines.append(f"    ({_listing(targets)}) = unpack_{order}(data)")
    for order, short_name in (("little_endian", "little"), ("big_endian", "big")):
        if any(e.field.byte_order == order for _, e in loose):
            lines.append(f"    {short_name} = from_bytes(data, {short_name!r})")
    for target, e in loose:
        lines.append(f"    {target} = {_loose_expression(e, size, scope)}")
    multiplexer_names = {name: f"m{i}" for i, name in enumerate(multiplexers)}
    for i, e in enumerate(extractions):
        tests = []
        for j, (name, ids) in enumerate(e.selectors):
            if len(ids) == 1:
                tests.append(f"{multiplexer_names[name]} != {next(iter(ids))}")
            else:
                scope[f"ids_{i}_{j}"] = ids
                tests.append(f"{multiplexer_names[name]} not in ids_{i}_{j}")
        if tests:
            lines.append(f"    if {' or '.join(tests)}: r{i} = None")
    return lines, scope


def _physical_expression(e: Extraction, raw: str) -> str:
    """Python text of the physical value of a raw variable."""
    text = e.scaling.expression.format(r=raw)
    return f"None if {raw} is None else {text}" if e.selectors else text


def _listing(names: Sequence[str]) -> str:
    return "".join(f"{name}, " for name in names)


def _split_aligned(
    wanted: Sequence[tuple[str, Extraction]],
) -> tuple[dict[str, list[tuple[str, Extraction]]], list[tuple[str, Extraction]]]:
    """Signals that a struct can read, by byte order, and the rest."""
    grouped: dict[str, list[tuple[str, Extraction]]] = {}
    loose = []
    ends = {"little_endian": 0, "big_endian": 0}
    for target, e in sorted(wanted, key=lambda item: item[1].field.first_bit):
        codes = _FLOAT_CODES if e.signal.is_float else _STRUCT_CODES
        order, first = e.field.byte_order, e.field.first_bit
        if first % 8 == 0 and e.field.length in codes and first >= ends[order]:
            grouped.setdefault(order, []).append((target, e))
            ends[order] = first + e.field.length
        else:
            loose.append((target, e))
    return grouped, loose


def _struct_group(order: str, group: Sequence[tuple[str, Extraction]]) -> tuple[str, list[str]]:
    text = ">" if order == "big_endian" else "<"
    at = 0
    for _, e in group:
        gap = e.field.first_bit // 8 - at
        text += f"{gap}x" if gap else ""
        text += _code(e.signal)
        at = e.field.end_byte
    return text, [target for target, _ in group]


def _code(signal: Signal) -> str:
    if signal.is_float:
        return _FLOAT_CODES[signal.length]
    code = _STRUCT_CODES[signal.length]
    return code if signal.is_signed else code.upper()


def _loose_expression(e: Extraction, size: int, scope: dict[str, Any]) -> str:
    source = "big" if e.field.is_big else "little"
    shift = e.field.shift(size)
    text = f"{source} >> {shift} & {e.field.mask}" if shift else f"{source} & {e.field.mask}"
    if e.signal.is_float:
        code = _FLOAT_CODES[e.field.length]
        scope[f"float_{code}"] = struct.Struct("<" + code).unpack
        return f"float_{code}(({text}).to_bytes({e.field.length // 8}, 'little'))[0]"
    if e.signal.is_signed:
        top = 1 << e.field.length - 1
        return f"({text} ^ {top}) - {top}"
    return text
