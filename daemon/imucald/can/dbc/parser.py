"""Parse the text of a CAN database with cantools. No other module uses cantools.

A database is untrusted input. A text that would exhaust the parser is refused before parsing
(`database_limits`). Every exception of the parser becomes a `DatabaseError`.
"""

from __future__ import annotations

import importlib
import importlib.util
import logging
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from msgspec.structs import replace

from imucald.can.columns import CAN_EFF_FLAG
from imucald.can.dbc.database_limits import refuse_heavy
from imucald.can.dbc.mending import LeftOut, MendedKcd, MendedText, lost_multiplexers
from imucald.can.dbc.message import Message, Signal
from imucald.core.errors import DatabaseError
from imucald.core.libraries import standing_in

MAX_REASON = 300
"""Largest number of characters of a reason that are shown."""


def parse(text: str, database_format: str, source: str) -> list[Message]:
    """Return the messages of a database's text.

    source: the name of the text in errors. Raises DatabaseError with the reason if the text is
    wrong. Raises MemoryError if there is not enough memory.
    """
    refuse_heavy(text, database_format, source)
    mended = MendedKcd(text, _reason_of_kcd) if database_format == "kcd" else MendedText(text)
    first: Exception | None = None
    while True:
        try:
            found = []
            if not mended.left_out or mended.text.strip():
                loaded: Any = _cantools().load_string(mended.text, database_format, strict=False)
                found = [_message(message, source) for message in loaded.messages]
        # For damaged text, the parser may raise almost any exception.
        except Exception as error:
            if _is_out_of_memory(error):
                raise MemoryError from error
            if database_format not in {"dbc", "kcd"} or not mended.mend(str(error)):
                reason = _reason(first or error)
                if database_format == "arxml" and not isinstance(error, RecursionError):
                    reason = _cut(_why_refused(error, text))
                raise DatabaseError(f"{source}: {reason}") from error
            first = first or error
        else:
            left_out = mended.left_out
            if first is not None and not found and not any(one.length for one in left_out):
                raise DatabaseError(f"{source}: {_reason(first)}") from first
            if database_format == "dbc":
                left_out = [*left_out, *lost_multiplexers(mended.text, found)]
            return _with_left_out(found, left_out, source)


def _with_left_out(found: list[Message], left_out: Sequence[LeftOut], source: str) -> list[Message]:
    """Add the left-out items to the messages, so that errors can state their place and reason."""
    by_name = {message.name: message for message in found}
    last = dict(by_name)  # the last of equal names; the others stay, and are reported as different
    for one in left_out:
        place = f"{source}:{one.line}"
        known = by_name.get(one.message)
        if not one.signal:
            text = f"left out: {one.why}"
            by_name.setdefault(
                one.message,
                Message(one.message, one.can_id, one.length, {}, source=place, unsupported=text),
            )
        elif known is not None:
            why = f"{place}: signal {one.message}.{one.signal} {one.why}"
            left = {**known.left_out, one.signal: why}
            by_name[one.message] = replace(known, left_out=left)
    added = [message for name, message in by_name.items() if name not in last]
    changed = {name for name, message in by_name.items() if message.left_out}
    return [
        by_name[m.name] if m.name in changed and m is last[m.name] else m for m in found
    ] + added


def _reason_of_kcd(text: str) -> str:
    try:
        _cantools().load_string(text, "kcd", strict=False)
    except Exception as error:
        if _is_out_of_memory(error):
            raise MemoryError from error
        return _reason(error)
    return ""


def _cantools() -> Any:
    """Import `cantools.database` without the rest of cantools, which would load python-can.

    The partial import saves 12 MiB (a daemon may use 50 MiB) and 45 ms. A later import of cantools
    loads the whole package. The warnings of cantools about duplicate names are switched off,
    because this module reports duplicate names with a remedy.
    """
    logging.getLogger("cantools").setLevel(logging.ERROR)
    spec = importlib.util.find_spec("cantools")
    with standing_in("cantools", None if spec is None else importlib.util.module_from_spec(spec)):
        return importlib.import_module("cantools.database")


def _is_out_of_memory(error: Exception) -> bool:
    """True if an error is a MemoryError, or cantools raised it because of a MemoryError."""
    behind = (error, error.__cause__, error.__context__, *vars(error).values())
    return any(isinstance(one, MemoryError) for one in behind) or "MemoryError" in str(error)


def _reason(error: Exception) -> str:
    """Return one line of a parser's error, without the errors of the other formats.

    The text is shortened, because the parser quotes the whole line of the file."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    return _cut(" ".join(str(error).split()) or type(error).__name__)


def _cut(text: str) -> str:
    return f"cannot be read: {text[:MAX_REASON]}{'...' if len(text) > MAX_REASON else ''}"


def _why_refused(error: Exception, text: str) -> str:
    """Return the reason with line, element and remedy; error: the parser's error for an ARXML text.

    The parser assumes that all elements required by the standard are present. If one is missing, it
    raises an error of Python that does not name the element. The traceback of this error contains
    the element that was being parsed.
    """
    inner = getattr(error, "e_arxml", None) or error
    found = _last_element(inner)
    words = " ".join(str(inner).split()) or type(inner).__name__
    is_missing = isinstance(inner, (AttributeError, TypeError, KeyError, IndexError))
    if found is None:
        without = "the file has no packages (AR-PACKAGES) that describe a bus; export the system "
        return f"{without}description of the bus, or export the bus as DBC" if is_missing else words
    tag, name = found
    what = "an element that the standard requires is missing" if is_missing else words.rstrip(".")
    remedy = "correct the file, remove this element, or export the bus as DBC"
    return f"{_line(text, tag, name)}{tag} {name}: {what}; {remedy}"


def _last_element(error: BaseException) -> tuple[str, str] | None:
    found = None
    traceback = error.__traceback__
    while traceback is not None:
        for one in _named(traceback.tb_frame.f_locals.values()):
            found = one
        traceback = traceback.tb_next
    return found


def _named(values: Any) -> Iterator[tuple[str, str]]:
    for value in values:
        tag = getattr(value, "tag", None)
        if isinstance(tag, str) and hasattr(value, "findtext"):
            name = value.findtext("{*}SHORT-NAME")
            if name:
                yield tag.rpartition("}")[2], name


def _line(text: str, tag: str, name: str) -> str:
    begin = rf"<(?:\w+:)?{re.escape(tag)}\b[^>]*>\s*<(?:\w+:)?SHORT-NAME\b[^>]*>\s*"
    found = re.search(begin + re.escape(name) + r"\s*<", text)
    return "" if found is None else f"line {text.count(chr(10), 0, found.start()) + 1}, "


def _message(found: Any, source: str) -> Message:
    unsupported = ""
    if found.is_container:
        unsupported = "container frames are not supported"
    elif found.autosar is not None and getattr(found.autosar, "is_secured", False):
        unsupported = "secured frames (SecOC) are not supported"
    by_name = {s.name: s for s in found.signals}
    signals = {n: _signal(s, by_name) for n, s in by_name.items()}
    choices: dict[str, str] = {}
    if len(by_name) < len(found.signals):
        _join_doubles([_signal(s, by_name) for s in found.signals], signals, choices, found, source)
    cycle = _number_or_none(found.cycle_time)
    return Message(
        name=found.name,
        can_id=found.frame_id | (CAN_EFF_FLAG if found.is_extended_frame else 0),
        length=found.length,
        signals=signals,
        is_fd=bool(found.is_fd) or found.length > 8,
        is_j1939=found.protocol == "j1939",
        cycle_time=cycle / 1000.0 if cycle is not None and cycle > 0 else None,
        comment=found.comment or "",
        source=source,
        unsupported=unsupported,
        left_out=choices,
    )


def _join_doubles(
    every: Sequence[Signal],
    signals: dict[str, Signal],
    choices: dict[str, str],
    found: Any,
    source: str,
) -> None:
    """Join signals with the same name. Signals in several groups of one multiplexer are joined if
    only their multiplexer values differ. In all other cases the last signal is used, and `choices`
    states this."""
    by_name: dict[str, list[Signal]] = {}
    for one in every:
        by_name.setdefault(one.name, []).append(one)
    for name, alike in by_name.items():
        last = alike[-1]
        if len(alike) == 1 or all(one == last for one in alike):
            continue
        parents = {tuple(parent for parent, _ in one.selectors) for one in alike}
        is_one = all(replace(one, selectors=last.selectors) == last for one in alike)
        if is_one and len(parents) == 1 and len(last.selectors) == 1:
            ids = frozenset().union(*(one.selectors[0][1] for one in alike))
            signals[name] = replace(last, selectors=((last.selectors[0][0], ids),))
            continue
        choices[name] = (
            f"{source}: message {found.name} has {len(alike)} signals named {name}; the one "
            f"at bit {last.start} is used; rename the others"
        )


def _signal(found: Any, by_name: Mapping[str, Any]) -> Signal:
    low, high = _number_or_none(found.minimum), _number_or_none(found.maximum)
    if low is not None and high is not None and not low < high:
        low = high = None  # [0|0] and similar ranges have no meaning
    return Signal(
        name=found.name,
        start=found.start,
        length=found.length,
        byte_order=found.byte_order,
        is_signed=bool(found.is_signed),
        is_float=bool(found.conversion.is_float),
        scale=_plain_number(found.conversion.scale),
        offset=_plain_number(found.conversion.offset),
        minimum=None if low is None else float(low),
        maximum=None if high is None else float(high),
        unit=found.unit or "",
        choices={int(k): str(v) for k, v in (found.choices or {}).items()},
        is_multiplexer=bool(found.is_multiplexer),
        selectors=_selectors(found, by_name),
        initial_raw=_number_or_none(found.raw_initial),
        invalid_raw=_number_or_none(found.raw_invalid),
        comment=found.comment or "",
    )


def _plain_number(value: Any) -> int | float:
    return value if isinstance(value, (int, float)) else float(value)


def _number_or_none(value: Any) -> int | float | None:
    """Return a finite number (an integral one as int); None for any other attribute value."""
    if not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return int(value) if float(value).is_integer() else float(value)


def _selectors(found: Any, by_name: Mapping[str, Any]) -> tuple[tuple[str, frozenset[int]], ...]:
    chain: list[tuple[str, frozenset[int]]] = []
    seen = {found.name}
    while found is not None and found.multiplexer_signal is not None:
        parent = found.multiplexer_signal
        chain.append((parent, frozenset(found.multiplexer_ids or ())))
        if parent in seen or parent not in by_name:
            break  # a broken chain; compiling the signal reports it
        seen.add(parent)
        found = by_name[parent]
    return tuple(reversed(chain))
