"""CAN databases (DBC, ARXML, KCD, SYM): the messages of one bus by name."""

from __future__ import annotations

import codecs
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from pathlib import Path

from msgspec.structs import replace

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK
from imucald.can.dbc.decode import J1939_ADDRESS_MASK, J1939_NO_ADDRESS, pgn_of
from imucald.can.dbc.message import Message, Signal, nearest
from imucald.core import file_cache as database_cache
from imucald.core.errors import DatabaseError
from imucald.core.files import read_regular
from imucald.core.memory import allowed_memory

FORMATS = ("dbc", "sym", "kcd", "arxml")
"""Suffixes of the files that can be read."""
_MARKS: Mapping[bytes, str] = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
"""Encodings by the byte order mark at the start of a file."""
MAX_FILE_BYTES = 256 * 2**20
"""Largest file [bytes]. ARXML files of a whole vehicle reach 100 MB."""
REMEMBERED = 4
"""Number of databases that a process caches, because the next log often needs the same database."""
REMEMBERED_TEXT = 2 * 2**20
"""Largest text of a cached database [characters]. With this limit, the cache needs some tens of
MiB."""


class Database:
    """The messages of one bus. Message names are unique."""

    def __init__(self, messages: Sequence[Message], ambiguous: Mapping[str, str]) -> None:
        self.messages: Mapping[str, Message] = {m.name: m for m in _told_apart(messages)}
        self._ambiguous = dict(ambiguous)

    def message(self, name: str) -> Message:
        """Return a message by name. Raises DatabaseError if the message is absent, ambiguous or not
        decodable."""
        if name in self._ambiguous:
            raise DatabaseError(self._ambiguous[name])
        found = self.messages.get(name)
        if found is None:
            hint = nearest(name, list(self.messages))
            raise DatabaseError(f"no message {name!r} in {self._files()}{hint}")
        if found.unsupported:
            raise DatabaseError(f"{found.source}: message {name}: {found.unsupported}")
        return found

    def signal(self, path: str) -> tuple[Message, Signal]:
        """Return message and signal of ``MESSAGE.SIGNAL``. Raises DatabaseError if either is
        absent."""
        message_name, dot, signal_name = path.partition(".")
        if not dot or not message_name or not signal_name:
            hint = self._holders(path) or ", such as IMU.AccX"
            raise DatabaseError(f"{path!r} is not of the form MESSAGE.SIGNAL{hint}")
        message = self.message(message_name)
        try:
            return message, message.signal(signal_name)
        except DatabaseError as error:
            raise DatabaseError(f"{error}{self._holders(signal_name)}") from None

    @property
    def left_out(self) -> list[str]:
        """One line for each message and signal that could not be read: place, reason, remedy."""
        found = [
            f"{m.source}: message {m.name}: {m.unsupported}"
            for m in self.messages.values()
            if m.unsupported
        ]
        return found + [why for m in self.messages.values() for why in m.left_out.values()]

    def _files(self) -> str:
        files = (re.sub(r":\d+$", "", m.source) for m in self.messages.values())  # without the line
        return ", ".join(dict.fromkeys(files)) or "the database"

    def _holders(self, signal_name: str) -> str:
        """Return a hint that names the other messages with this signal; empty if there are none."""
        found = [
            f"{m.name}.{signal_name}" for m in self.messages.values() if signal_name in m.signals
        ]
        return f"; write {' or '.join(found[:3])}" if found else ""


def load_database(path: Path) -> Database:
    """Read a database file. Raises DatabaseError with file and reason for a file that cannot be
    read."""
    in_file: dict[str, Message] = {}
    found, names = _named_apart(_load_file(Path(path)))
    for message in found:
        if in_file.setdefault(message.name, message) != message:
            names[message.name] = ()
        in_file[message.name] = message
    ambiguous = {}
    for name, instead in names.items():
        remedy = f"; write {' or '.join(instead)}" if instead else ""
        ambiguous[name] = f"{path}: two different messages are named {name}{remedy}"
    return Database(list(in_file.values()), ambiguous)


def _named_apart(
    messages: Sequence[Message],
) -> tuple[list[Message], dict[str, Sequence[str]]]:
    """Return the messages with unique names, and a map from each shared name to the new names.

    A file may describe two senders of one type with the same message names. The new names contain
    the identifiers.
    """
    ids: dict[str, list[int]] = {}
    for one in messages:
        known = ids.setdefault(one.name, [])
        if one.can_id not in known:
            known.append(one.can_id)
    shared = {name: {i: f"{name}_0x{i & CAN_EFF_MASK:X}" for i in known}
              for name, known in ids.items() if len(known) > 1}  # fmt: skip
    apart = [
        replace(one, name=shared[one.name][one.can_id]) if one.name in shared else one
        for one in messages
    ]
    return apart, {name: list(instead.values()) for name, instead in shared.items()}


def _told_apart(messages: Sequence[Message]) -> list[Message]:
    """Return all messages. A message is marked if it shares its PGN with another message and has
    its own address."""
    addresses: dict[int, set[int]] = {}
    for one in messages:
        if one.can_id & CAN_EFF_FLAG:
            addresses.setdefault(pgn_of(one.can_id), set()).add(one.can_id & J1939_ADDRESS_MASK)
    return [
        replace(one, has_own_address=True)
        if one.can_id & CAN_EFF_FLAG
        and one.can_id & J1939_ADDRESS_MASK < J1939_NO_ADDRESS
        and len(addresses[pgn_of(one.can_id)]) > 1
        else one
        for one in messages
    ]


def load_database_text(text: str, database_format: str, name: str = "<text>") -> Database:
    """Read a database from text in the format ``dbc``, ``kcd``, ``sym`` or ``arxml``."""
    return Database(_parse(text, database_format, name), {})


def max_file_bytes() -> int:
    """Return the size of the largest accepted file [bytes]. A file may take a part of the allowed
    memory, because it is stored twice: as bytes, and as text of two bytes per character."""
    return min(MAX_FILE_BYTES, allowed_memory() // 16)


def _load_file(path: Path) -> list[Message]:
    database_format = path.suffix.lower().removeprefix(".")
    if database_format not in FORMATS:
        known = ", ".join(f".{f}" for f in FORMATS)
        raise DatabaseError(f"{path}: not a known database format (one of {known})")
    limit = max_file_bytes()
    try:
        data = read_regular(path, limit)
    except OSError as error:
        raise DatabaseError(f"{path}: {error.strerror or error}") from error
    if len(data) > limit:
        raise DatabaseError(f"{path}: larger than {limit // 2**20} MiB")
    return _parse(decoded(data), database_format, str(path))


def decoded(data: bytes) -> str:
    """Decode a file. A byte order mark determines the encoding.

    Without a mark, each line is decoded as UTF-8 if it is valid UTF-8, else as cp1252. Tools on
    Windows write cp1252; editors and scripts write UTF-8; some files contain both. A line with
    cp1252 characters is hardly ever valid UTF-8.
    """
    for mark, encoding in _MARKS.items():
        if data.startswith(mark):
            return data.decode(encoding, errors="replace")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return "".join(map(_decoded_line, data.splitlines(keepends=True)))


def _decoded_line(line: bytes) -> str:
    try:
        return line.decode("utf-8")
    except UnicodeDecodeError:
        return line.decode("cp1252", errors="replace")


def _parse(text: str, database_format: str, source: str) -> list[Message]:
    read = _remembered if len(text) <= REMEMBERED_TEXT else _parsed
    return list(read(text, database_format, source))


@lru_cache(maxsize=REMEMBERED)
def _remembered(text: str, database_format: str, source: str) -> Sequence[Message]:
    return _parsed(text, database_format, source)


def _parsed(text: str, database_format: str, source: str) -> Sequence[Message]:
    name = f"{database_format} {source}"
    messages = database_cache.find(text, name, Message)
    if messages is None:
        from imucald.can.dbc.bounded_parser import parse_bounded  # noqa: PLC0415 - seldom needed

        messages = parse_bounded(text, database_format, source)
        database_cache.keep(text, name, messages, Message)
    return messages
