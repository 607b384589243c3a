"""CAN databases (DBC, ARXML, KCD, SYM) read by cantools into plain, frozen descriptions.

Nothing past this module knows cantools: a codec, a test or the `check` command sees `Message` and
`Signal`. A database is untrusted input: what would exhaust the parser is refused before it sees it
(`database_limits`), and whatever the parser raises becomes a `DatabaseError`.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
from msgspec import Struct

from imucald.can.columns import CAN_EFF_FLAG
from imucald.can.dbc.database_limits import MAX_FILE_BYTES, refuse_heavy
from imucald.core import file_cache as database_cache
from imucald.core.errors import DatabaseError
from imucald.core.lean_import import standing_in

ByteOrder = Literal["little_endian", "big_endian"]

ENCODINGS: Mapping[str, str] = {"dbc": "cp1252", "sym": "cp1252", "kcd": "utf-8", "arxml": "utf-8"}
"""Text encoding of each format, as the tools that write them have it."""


class Signal(Struct, frozen=True):
    """One signal: where its bits are and what they mean.

    `start` and `byte_order` as in a DBC: the least significant bit of an Intel signal, the most
    significant of a Motorola one, in the DBC's numbering (bit 0 = byte 0's lowest).
    Physical = raw * scale + offset, in `unit`. `minimum`, `maximum`: physical, None where not
    stated. `selectors`: the multiplexers that must hold, outermost first, each with the raw
    values under which this signal is there. `initial_raw`, `invalid_raw`: as the database states.
    """

    name: str
    start: int
    length: int
    byte_order: ByteOrder = "little_endian"
    is_signed: bool = False
    is_float: bool = False
    scale: int | float = 1
    offset: int | float = 0
    minimum: float | None = None
    maximum: float | None = None
    unit: str = ""
    choices: Mapping[int, str] = msgspec.field(default_factory=dict)
    is_multiplexer: bool = False
    selectors: tuple[tuple[str, frozenset[int]], ...] = ()
    initial_raw: int | float | None = None
    invalid_raw: int | float | None = None
    comment: str = ""


class Message(Struct, frozen=True):
    """One message. `can_id` carries `CAN_EFF_FLAG` for 29 bits; `cycle_time` in seconds."""

    name: str
    can_id: int
    length: int
    signals: Mapping[str, Signal]
    is_fd: bool = False
    is_j1939: bool = False
    cycle_time: float | None = None
    comment: str = ""
    source: str = ""
    unsupported: str = ""

    def signal(self, name: str) -> Signal:
        """Return the signal; DatabaseError with the nearest names where there is none."""
        try:
            return self.signals[name]
        except KeyError:
            hint = _nearest(name, list(self.signals))
            text = f"{self.source}: message {self.name} has no signal {name!r}{hint}"
            raise DatabaseError(text) from None


class Database:
    """The messages of one bus, from one or several files; names are unique."""

    def __init__(self, messages: Sequence[Message], ambiguous: Mapping[str, str]) -> None:
        self.messages: Mapping[str, Message] = {m.name: m for m in messages}
        self._ambiguous = dict(ambiguous)

    def message(self, name: str) -> Message:
        """Return the message; DatabaseError where absent, ambiguous or not decodable."""
        if name in self._ambiguous:
            raise DatabaseError(self._ambiguous[name])
        found = self.messages.get(name)
        if found is None:
            hint = _nearest(name, list(self.messages))
            raise DatabaseError(f"no message {name!r} in the database{hint}")
        if found.unsupported:
            raise DatabaseError(f"{found.source}: message {name}: {found.unsupported}")
        return found

    def signal(self, path: str) -> tuple[Message, Signal]:
        """Return message and signal of ``MESSAGE.SIGNAL``; DatabaseError where absent."""
        message_name, dot, signal_name = path.partition(".")
        if not dot or not message_name or not signal_name:
            raise DatabaseError(f"{path!r} is not of the form MESSAGE.SIGNAL")
        message = self.message(message_name)
        return message, message.signal(signal_name)


def load_database(paths: Sequence[Path], shared_ids: bool = False) -> Database:
    """Read one or several database files of one bus.

    Two files that describe one name or (unless `shared_ids`) one identifier differently, and
    whatever cannot be read, give a DatabaseError that names file and reason.
    """
    messages: list[Message] = []
    ambiguous: dict[str, str] = {}
    for path in paths:
        in_file: dict[str, Message] = {}
        for message in _load_file(Path(path)):
            earlier = in_file.get(message.name)
            if earlier is not None and earlier != message:
                ambiguous[message.name] = f"{path}: two different messages are named {message.name}"
            in_file[message.name] = message
        _refuse_conflicts(messages, list(in_file.values()), shared_ids)
        known = {m.name for m in messages}
        messages += [m for m in in_file.values() if m.name not in known]
    return Database(messages, ambiguous)


def load_database_text(text: str, database_format: str, name: str = "<text>") -> Database:
    """Read a database from text in the format ``dbc``, ``kcd``, ``sym`` or ``arxml``."""
    return Database(_parse(text, database_format, name), {})


def _load_file(path: Path) -> list[Message]:
    database_format = path.suffix.lower().removeprefix(".")
    if database_format not in ENCODINGS:
        known = ", ".join(f".{f}" for f in ENCODINGS)
        raise DatabaseError(f"{path}: not a known database format (one of {known})")
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise DatabaseError(f"{path}: larger than {MAX_FILE_BYTES // 2**20} MiB")
        text = path.read_text(encoding=ENCODINGS[database_format], errors="replace")
    except OSError as error:
        raise DatabaseError(f"{path}: {error.strerror or error}") from error
    return _parse(text, database_format, str(path))


def _parse(text: str, database_format: str, source: str) -> list[Message]:
    name = f"{database_format} {source}"
    messages = database_cache.find(text, name, Message)
    if messages is None:
        messages = _parse_anew(text, database_format, source)
        database_cache.keep(text, name, messages, Message)
    return messages


def _parse_anew(text: str, database_format: str, source: str) -> list[Message]:
    refuse_heavy(text, database_format, source)
    try:
        loaded: Any = _cantools().load_string(text, database_format, strict=False)
        return [_message(message, source) for message in loaded.messages]
    # The parser meets text of any kind, and answers with almost any exception.
    except Exception as error:
        raise DatabaseError(f"{source}: {_reason(error)}") from error


def _cantools() -> Any:
    """`cantools.database`, without the rest of cantools, which would load python-can.

    That is 12 MiB (of the 50 that a daemon may take) and 45 ms. Whoever imports cantools later
    gets it whole.
    """
    spec = importlib.util.find_spec("cantools")
    with standing_in("cantools", None if spec is None else importlib.util.module_from_spec(spec)):
        return importlib.import_module("cantools.database")


def _reason(error: Exception) -> str:
    """One line of a parser's error, without the other formats' complaints."""
    if isinstance(error, RecursionError):
        return "nested too deeply"
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    text = lines[0] if lines else type(error).__name__
    return f"cannot be read: {text}"


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


def _refuse_conflicts(known: list[Message], new: list[Message], shared_ids: bool) -> None:
    names = {m.name: m for m in known}
    ids = {m.can_id: m for m in known if m.signals}
    for message in new:
        other = names.get(message.name)
        if other is not None and not _same(other, message):
            raise DatabaseError(
                f"message {message.name} is described differently in {other.source} and in "
                f"{message.source}; load one of them, or rename one"
            )
        other = ids.get(message.can_id)
        if other is not None and not shared_ids and message.signals and not _same(other, message):
            raise DatabaseError(
                f"identifier 0x{message.can_id & 0x1FFF_FFFF:X} is {other.name} in {other.source} "
                f"but {message.name} in {message.source}"
            )


def _same(a: Message, b: Message) -> bool:
    return a == msgspec.structs.replace(b, source=a.source)


def _nearest(name: str, names: list[str]) -> str:
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    return f" (nearest: {', '.join(near)})" if near else ""
