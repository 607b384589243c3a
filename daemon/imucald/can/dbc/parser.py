"""The text of a CAN database -> its messages, by cantools. Nothing past this module knows cantools.

A database is untrusted input: what would exhaust the parser is refused before it sees it
(`database_limits`), and whatever the parser raises becomes a `DatabaseError`.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Mapping
from typing import Any

from imucald.can.columns import CAN_EFF_FLAG
from imucald.can.dbc.database_limits import refuse_heavy
from imucald.can.dbc.message import Message, Signal
from imucald.core.errors import DatabaseError
from imucald.core.partial_import import standing_in

MAX_REASON = 300
"""Characters of a reason that are shown."""


def parse(text: str, database_format: str, source: str) -> list[Message]:
    """Return the messages of a database's text.

    source: what errors call it. Raises DatabaseError with the reason where it is wrong,
    MemoryError where it needs more than there is.
    """
    refuse_heavy(text, database_format, source)
    try:
        loaded: Any = _cantools().load_string(text, database_format, strict=False)
        return [_message(message, source) for message in loaded.messages]
    # The parser meets text of any kind, and answers with almost any exception.
    except Exception as error:
        if _is_out_of_memory(error):
            raise MemoryError from error
        raise DatabaseError(f"{source}: {_reason(error)}") from error


def _cantools() -> Any:
    """`cantools.database`, without the rest of cantools, which would load python-can.

    That is 12 MiB (of the 50 that a daemon may take) and 45 ms. Whoever imports cantools later
    gets it whole.
    """
    spec = importlib.util.find_spec("cantools")
    with standing_in("cantools", None if spec is None else importlib.util.module_from_spec(spec)):
        return importlib.import_module("cantools.database")


def _is_out_of_memory(error: Exception) -> bool:
    """Whether this is, or cantools made it of, a lack of memory."""
    behind = (error, error.__cause__, error.__context__, *vars(error).values())
    return any(isinstance(one, MemoryError) for one in behind) or "MemoryError" in str(error)


def _reason(error: Exception) -> str:
    """One line of a parser's error, without the other formats' complaints; no longer than a person
    reads, for the parser quotes the whole line of the file."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    text = lines[0] if lines else type(error).__name__
    return f"cannot be read: {text[:MAX_REASON]}{'...' if len(text) > MAX_REASON else ''}"


def _message(found: Any, source: str) -> Message:
    unsupported = ""
    if found.is_container:
        unsupported = "container frames are not supported"
    elif found.autosar is not None and getattr(found.autosar, "is_secured", False):
        unsupported = "secured frames (SecOC) are not supported"
    by_name = {s.name: s for s in found.signals}
    cycle = _number_or_none(found.cycle_time)
    return Message(
        name=found.name,
        can_id=found.frame_id | (CAN_EFF_FLAG if found.is_extended_frame else 0),
        length=found.length,
        signals={n: _signal(s, by_name) for n, s in by_name.items()},
        is_fd=bool(found.is_fd) or found.length > 8,
        is_j1939=found.protocol == "j1939",
        cycle_time=cycle / 1000.0 if cycle is not None and cycle > 0 else None,
        comment=found.comment or "",
        source=source,
        unsupported=unsupported,
    )


def _signal(found: Any, by_name: Mapping[str, Any]) -> Signal:
    low, high = _number_or_none(found.minimum), _number_or_none(found.maximum)
    if low is not None and high is not None and not low < high:
        low = high = None  # [0|0] and the like say nothing
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
    """A finite number, whole ones as int; None for anything else that an attribute may hold."""
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
            break  # a broken chain; compiling the signal says so
        seen.add(parent)
        found = by_name[parent]
    return tuple(reversed(chain))
