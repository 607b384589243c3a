"""Convert data of a YAML file to a typed structure.

Each mistake is reported in one line: file, line, key, remedy. msgspec stops at the first mistake.
Therefore this module lets msgspec check the data field by field, so that all mistakes are reported
together.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Final,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import msgspec
import msgspec.structs
from msgspec import Struct

from imucald.core.errors import ConfigError

T = TypeVar("T")


def typed(
    data: Any,
    kind: type[T],
    document: Document,
    *,
    full: Any = None,
    at: Place = (),
) -> T:
    """Convert data to a value of the type `kind` (a msgspec structure, or any type of a field).

    full: the data with all short forms expanded; None if there are no short forms. at: the key of
    the data. Raises ConfigError with one line for each mistake.
    """
    infinite = [
        f"{document.located((*at, *place))}: must be a finite number, below {LARGEST:g}"
        for place in infinite_places(data)
    ]
    if infinite:
        raise ConfigError("\n".join(infinite))
    full = data if full is None else full
    try:
        return msgspec.convert(full, kind)
    except (ValueError, OverflowError) as error:  # msgspec.ValidationError is a ValueError
        lines = list(explain(data, full, kind, document, at))
        lines = lines or [f"{document.located(at)}: {error}"]
        raise ConfigError("\n".join(lines)) from None


LARGEST: Final = 1e30
"""Largest accepted number. Squares and products of such numbers are finite."""
Place = tuple[str | int, ...]
Marks = dict[Place, int]
"""The line number (from 1) of every key and item."""


def infinite_places(data: Any, place: Place = ()) -> Iterator[Place]:
    """Return the places of numbers that are infinite, NaN, or larger than `LARGEST`."""
    if isinstance(data, float) and not abs(data) < LARGEST:
        yield place
    elif isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from infinite_places(value, (*place, key))


def line_of(marks: Marks, place: Place) -> int:
    """Return the line of a key. If the key has no line, return the line of its nearest parent
    key."""
    while place and place not in marks:
        place = place[:-1]
    return marks.get(place, 1)


def dotted(place: Place) -> str:
    """Return the name of a key with all parent keys; empty for the whole file."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


class Document(NamedTuple):
    """Source of the data: the file's name, and the lines of its keys.

    marks: lines of the keys; empty if the data are not from a text. whole: text that names the
    whole file, for mistakes without a key.
    """

    name: str
    marks: Marks
    whole: str = "configuration"

    def located(self, place: Place) -> str:
        """Return a text with file, line and key. Every reported mistake in a YAML file begins with
        this text."""
        where = f"{self.name}:{line_of(self.marks, place)}" if self.marks else self.name
        return f"{where}: {dotted(place) or self.whole}"


_NAMES = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "bool": "true or false",
    "null": "nothing",
    "array": "a list",
    "object": "a mapping",
}
_BOUNDS = {">": "greater than", ">=": "at least", "<": "less than", "<=": "at most"}

SHOWN_KEYS = 4
"""Largest number of keys of a mapping that a message lists."""

Mistake = tuple[Place, str]


@cache
def _fields(model: type[Struct]) -> tuple[msgspec.structs.FieldInfo, ...]:
    """Return the fields of a struct.

    The result is cached because msgspec compiles each annotation again.
    """
    return msgspec.structs.fields(model)


def explain(data: Any, full: Any, kind: Any, document: Document, at: Place = ()) -> Iterator[str]:
    """Yield one line for each mistake: file, line, key, reason, remedy.

    full: the checked data, with all short forms expanded. data: the data as written by the user.
    kind: the required type. at: the key of the data.
    """
    reported: set[Mistake] = set()
    for long_place, reason in _mistakes(full, kind, (), kind):
        place = (*at, *_real_place(long_place, data))
        if (place, reason) not in reported:
            reported.add((place, reason))
            yield f"{document.located(place)}: {reason}"


def _real_place(long_place: Place, data: Any) -> Place:
    """Return the place in the data as written. Parts of the place that only the expansion of short
    forms added are removed (the index of a single source, its key)."""
    place: list[str | int] = []
    here = data
    last = len(long_place) - 1
    for i, part in enumerate(long_place):
        if isinstance(here, dict) and (part in here or (i == last and isinstance(part, str))):
            place.append(part)
            here = here.get(part)
        elif isinstance(here, list) and isinstance(part, int) and part < len(here):
            place.append(part)
            here = here[part]
    return tuple(place)


def _mistakes(value: Any, kind: Any, place: Place, whole: Any) -> Iterator[Mistake]:
    """Yield the mistakes of a value that must have the type `kind` (with constraints).

    whole: type of all the data, in which an unknown key may have another place.
    """
    bare = _bare(kind)
    if value is None and NoneType in get_args(bare):
        return
    inner = list(_inner_mistakes(value, bare, place, whole))
    if inner:
        yield from inner
        return
    try:
        msgspec.convert(value, kind)
    except (ValueError, OverflowError) as error:  # msgspec.ValidationError is a ValueError
        yield place, _reason(value, bare, str(error))


def _inner_mistakes(value: Any, kind: Any, place: Place, whole: Any) -> Iterator[Mistake]:
    for part in map(_bare, get_args(kind) if _is_union(kind) else (kind,)):
        arguments = get_args(part)
        if isinstance(part, type) and issubclass(part, Struct) and isinstance(value, dict):
            yield from _of_fields(value, part, place, whole)
        elif get_origin(part) is tuple and isinstance(value, list):
            every = arguments[1:] == (...,)
            if every or len(arguments) == len(value):
                for index, one in enumerate(value):
                    kind_of_one = arguments[0] if every else arguments[index]
                    yield from _mistakes(one, kind_of_one, (*place, index), whole)
        elif get_origin(part) is dict and isinstance(value, dict):
            for key, one in value.items():
                yield from _mistakes(one, arguments[1], (*place, key), whole)


def _of_fields(
    value: dict[Any, Any], model: type[Struct], place: Place, whole: Any
) -> Iterator[Mistake]:
    hints = _hints(model)
    for key, one in value.items():
        if key in hints:
            yield from _mistakes(one, hints[key], (*place, key), whole)
        else:
            yield (*place, key), _unknown(str(key), sorted(hints), whole)
    for field in _fields(model):
        if field.required and field.name not in value:
            yield (*place, field.name), "is missing; it is required, add it"


def _unknown(key: str, allowed: list[str], whole: Any) -> str:
    """Return what an unknown key may mean: a similar key of the same mapping, or the only key of
    this name elsewhere.

    allowed: the keys of the mapping, sorted. whole: type of all the data.
    """
    import difflib  # noqa: PLC0415 - for a mistake only

    meant = [repr(near) for near in difflib.get_close_matches(key, allowed, n=1)]
    elsewhere = [place for place in places(whole) if place[-1] == key]
    if len(elsewhere) == 1:
        meant.append(dotted(elsewhere[0]))
    hint = f"did you mean {' or '.join(meant)}?" if meant else "allowed: " + ", ".join(allowed)
    return f"unknown key; {hint}"


def places(kind: Any, above: Place = ()) -> Iterator[Place]:
    """Yield the place of every key that data of a type may have; `*` stands for any name. The items
    of a list count once, without an index."""
    kind = _bare(kind)
    if isinstance(kind, type) and issubclass(kind, Struct):
        for name, inner in _hints(kind).items():
            yield (*above, name)
            yield from places(inner, (*above, name))
    elif get_origin(kind) is dict:
        yield from places(get_args(kind)[1], (*above, "*"))
    elif get_origin(kind) is tuple or _is_union(kind):
        for inner in {part: None for part in get_args(kind) if part is not ...}:
            yield from places(inner, above)


def _reason(value: Any, kind: Any, text: str) -> str:
    choices = _choices(kind)
    count = _numbers(kind)
    if count > 2 and isinstance(value, int | float) and not isinstance(value, bool):
        such = ",".join([str(value)] * count)
        return f"must be a list of {count} numbers, such as [{such}]; got {value}"
    if choices and not isinstance(value, list | dict):
        reason = "must be one of " + ", ".join(map(repr, choices))
    else:
        reason = _plain(text.partition(" - at `")[0]) + _keys(value, kind)
    is_plain = isinstance(value, str | int | float | bool) or value is None
    remedy = "; remove the quotes" if isinstance(value, str) and _is_number(value, text) else ""
    return f"{reason} (here: {value!r}){remedy}" if is_plain else reason


def _numbers(kind: Any) -> int:
    """Return the number of items that a list of numbers must have; 0 if `kind` is not a list of
    numbers with a fixed length."""
    parts = get_args(kind)
    is_list = get_origin(kind) is tuple and all(_bare(part) is float for part in parts)
    return len(parts) if is_list else 0


def _is_number(value: str, text: str) -> bool:
    """Return whether the value is a number in quotes although a number without quotes is required.
    text: message of msgspec."""
    if "`float`" not in text and "`int" not in text:
        return False
    try:
        float(value)
    except ValueError:
        return False
    return True


def _keys(value: Any, kind: Any) -> str:
    if isinstance(value, dict) or not (isinstance(kind, type) and issubclass(kind, Struct)):
        return ""
    names = [field.name for field in _fields(kind)]
    more = ", ..." if len(names) > SHOWN_KEYS else ""
    return f"; its keys: {', '.join(names[:SHOWN_KEYS])}{more}"


def _plain(text: str) -> str:
    """Convert a message of msgspec, such as "Expected `float` > 0.0", to the terms of YAML."""

    def named(match: re.Match[str]) -> str:
        return " or ".join(_NAMES.get(name, name) for name in match[1].split(" | "))

    text = re.sub(r"`([^`]*)`", named, text.replace("Expected ", "must be ", 1))
    text = re.sub(r" ([<>]=?) ", lambda match: f" {_BOUNDS[match[1]]} ", text)
    return f"{text[:1].lower()}{text[1:]}"


def _bare(kind: Any) -> Any:
    return get_args(kind)[0] if get_origin(kind) is Annotated else kind


def _is_union(kind: Any) -> bool:
    return get_origin(kind) in {Union, UnionType}


def _choices(kind: Any) -> tuple[Any, ...]:
    """Return the values that a type allows, if it is a Literal or a union with a Literal."""
    if get_origin(kind) is Literal:
        return get_args(kind)
    parts = get_args(kind) if _is_union(kind) else ()
    return tuple(one for part in parts for one in _choices(_bare(part)))


@cache
def _hints(model: type[Struct]) -> dict[str, Any]:
    """Return the type of each key of a structure, including constraints."""
    return get_type_hints(model, include_extras=True)
