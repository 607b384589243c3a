"""Refuse databases that would make the parser use all memory or run for a very long time.

The parser's memory grows with the lengths that a database states; one line of text can state a
message of four gigabytes. The parser's time grows with the product of nested multiplexers. Real
databases are far below these limits.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Mapping, Sequence

from imucald.core.errors import DatabaseError

MAX_MESSAGE_BYTES = 4096
"""Longest accepted message (J1939 transport: 1785 bytes)."""

MAX_BITS = 8 * MAX_MESSAGE_BYTES

MAX_MULTIPLEXED_SETS = 65_536
"""Largest number of signal sets that the multiplexers of one message may select. The numbers of
nested multiplexers are multiplied."""

_NUMBERS: Mapping[str, Sequence[tuple[str, int]]] = {
    "dbc": (
        (r"\bSG_\s+\w+(?:\s+\w+)?\s*:\s*(\d+)\s*\|", MAX_BITS),
        (r"\bSG_\s+\w+(?:\s+\w+)?\s*:\s*\d+\s*\|\s*(\d+)", MAX_BITS),
    ),
    "kcd": (
        (r"\b(?:length|offset)\s*=\s*[\"'](\d+)", MAX_BITS),
        (r"<Message\b[^<>]*\blength\s*=\s*[\"'](\d+)", MAX_MESSAGE_BYTES),
    ),
    "sym": (
        (r"\bLen\s*=\s*(\d+)", MAX_MESSAGE_BYTES),
        (r"\b(?:unsigned|signed|bit|char|string|raw)\s+(\d+)", MAX_BITS),
    ),
    "arxml": (
        (r"<(?:\w+:)?FRAME-LENGTH>\s*(\d+)", MAX_BITS),
        (r"<(?:\w+:)?(?:LENGTH|START-POSITION)>\s*(\d+)", 2**24),
    ),
}
"""Numbers that determine the parser's memory, by format: a pattern whose group contains the digits,
and the largest accepted number."""

_MESSAGE = re.compile(r"\bBO_(?!\w)")
_MULTIPLEXED = re.compile(r"\s+(\d{1,20})\s+(\w+)\s+(\w+)\s+(.*)", re.DOTALL)


def refuse_heavy(text: str, database_format: str, source: str) -> None:
    """Raise DatabaseError with file and line if a number in the text exceeds its limit."""
    for pattern, limit in _NUMBERS.get(database_format, ()):
        for match in re.finditer(pattern, text):
            _refuse_number(match.group(1), limit, text, match.start(), source)
    if database_format == "dbc":
        _refuse_long_messages(text, source)
        _refuse_multiplexers(text, source)
    elif database_format == "sym":
        _refuse_sym_positions(text, source)


def _refuse_long_messages(text: str, source: str) -> None:
    """Refuse a message of a DBC that is too long.

    The parser accepts a message without a space between identifier and name. Therefore the text
    before the colon is not analysed, and each part of the text is read only once.
    """
    starts = [match.start() for match in _MESSAGE.finditer(text)]
    for at, end in itertools.pairwise([*starts, len(text)]):
        head, _, rest = text[at:end].partition(":")
        number = re.match(r"\s*(\d+)", rest)
        if number and '"' not in head and ";" not in head:
            _refuse_number(number.group(1), MAX_MESSAGE_BYTES, text, at, source)


def _refuse_sym_positions(text: str, source: str) -> None:
    """Refuse a position or length of a SYM signal that is too large. Each line is read once."""
    at = 0
    for line in text.split("\n"):
        text = line.partition("/")[0]
        signal = re.search(r"\b(?:Sig|Var|Mux)\s*=", text)
        if signal:
            for number in re.finditer(r"\s(\d{5,})(?![\dA-Fa-fh])", text[signal.end() :]):
                _refuse_number(number.group(1), MAX_BITS, text, at, source)
        at += len(line) + 1


def _refuse_number(digits: str, limit: int, text: str, at: int, source: str) -> None:
    if len(digits) > 12 or int(digits) > limit:
        place = _place(text, at, source)
        raise DatabaseError(f"{place}: the number {digits[:20]} is larger than {limit}")


def _refuse_multiplexers(text: str, source: str) -> None:
    children: dict[tuple[str, str], list[tuple[str, int]]] = {}
    at = 0
    for piece in text.split("SG_MUL_VAL_")[1:]:
        match = _MULTIPLEXED.match(piece.partition(";")[0])
        at = text.find("SG_MUL_VAL_", at) + 1
        if match:
            message, signal, parent, ranges = match.groups()
            values = sum(
                max(0, int(b) - int(a) + 1)
                for a, b in re.findall(r"(\d{1,20})\s*-\s*(\d{1,20})", ranges)
            )
            children.setdefault((message, parent), []).append((signal, values))
            if values > MAX_MULTIPLEXED_SETS:
                _refuse_sets(text, at, source)
    sets: dict[tuple[str, str], int] = {}
    for key in children:
        if _count_sets(key, children, sets, ()) > MAX_MULTIPLEXED_SETS:
            _refuse_sets(text, text.find("SG_MUL_VAL_ " + key[0]), source)


def _count_sets(
    key: tuple[str, str],
    children: Mapping[tuple[str, str], list[tuple[str, int]]],
    sets: dict[tuple[str, str], int],
    above: tuple[tuple[str, str], ...],
) -> int:
    """Return the number of signal sets under one multiplexer. The number is above the limit if the
    multiplexer is its own parent."""
    if key in sets:
        return sets[key]
    if key in above or len(above) > 100:
        return MAX_MULTIPLEXED_SETS + 1
    total = 0
    for signal, values in children.get(key, ()):
        below = _count_sets((key[0], signal), children, sets, (*above, key))
        total = min(total + values * (1 + below), 2 * MAX_MULTIPLEXED_SETS)
    sets[key] = total
    return total


def _refuse_sets(text: str, at: int, source: str) -> None:
    raise DatabaseError(
        f"{_place(text, max(at, 0), source)}: multiplexers select more than "
        f"{MAX_MULTIPLEXED_SETS} sets of signals, or select one another"
    )


def _place(text: str, at: int, source: str) -> str:
    return f"{source}:{text.count(chr(10), 0, at) + 1}"
